"""`sonarjax recognize`: decide whether frames show the target, or which of several targets, and at which yaw."""

from __future__ import annotations

import argparse
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP, add_mesh_options, add_segmenter_option, correlation
from sonarjax.cli.frames import CLUSTER_HELP, Lazy, engine_of, frames_for, start_jax
from sonarjax.cli.targets import load_mesh, mesh_files
from sonarjax.io import JsonLines, SonarjaxError, check_outputs, complain, naming
from sonarjax.results import SCHEMA, record_of


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("recognize", help="find a target, and its yaw, in frames", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=FRAME_HELP)
    command.add_argument(
        "--target", metavar="MESH", required=True, action="append",
        help="the object to look for; with several (repeat --target, or name a folder) the answer says which one it is",
    )  # fmt: skip
    command.add_argument(
        "--sonar", metavar="S.toml", required=True, help="the sonar and its geometry (overrides a file's header)"
    )
    command.add_argument(
        "--out", metavar="R.jsonl", required=True,
        help="output file, one line of JSON for each frame; appended to if it exists",
    )  # fmt: skip
    add_segmenter_option(command, "matches the grey frame itself")
    command.add_argument("--no-refine", action="store_true", help="stop at the yaw bin, do not refine it")
    command.add_argument(
        "--threshold", metavar="T", type=correlation,
        help="lowest score of an identified target (default: that of the segmenter's decision rule, or with "
        "--no-refine the segmenter's own)",
    )  # fmt: skip
    command.add_argument(
        "--track", action="store_true", help="the frames are one sequence: find yaw and place from all so far"
    )
    command.add_argument(
        "--motion", choices=("turning", "standing"), metavar="HOW",
        help="with --track: the target is `turning` (default) or `standing`",
    )  # fmt: skip
    command.add_argument("--cluster", metavar="WHERE", help=CLUSTER_HELP)
    add_mesh_options(command)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    if args.motion is not None and not args.track:
        raise SonarjaxError("--motion: can only be used with --track")
    files = mesh_files(args.target, "--target")
    inputs = (*args.frames, *files.values(), args.sonar, args.segmenter)
    check_outputs({"--out": args.out}, inputs, appended=("--out",))
    if args.track and len(files) > 1:
        raise SonarjaxError(f"--track: expected a single --target, got {len(files)} meshes")
    start_jax()
    from sonarjax.cpu import usual_engine
    from sonarjax.recognize import Recognizer
    from sonarjax.refine import MAP_REFINEMENT
    from sonarjax.segment import check_segmenter, load_segmenter
    from sonarjax.sonar import Sonar
    from sonarjax.track import Standing, Tracker, Turning

    if args.cluster is not None and args.track:
        raise SonarjaxError("--cluster: expected --cluster or --track, not both: a track takes its frames in order")
    check_segmenter(args.segmenter)
    sonar = Sonar.from_toml(args.sonar)
    meshes = {name: load_mesh(file, sonar, args) for name, file in files.items()}
    refine, engine = None if args.no_refine else MAP_REFINEMENT, usual_engine()
    segmenter = load_segmenter(args.segmenter)
    _check_threshold(args, segmenter)
    try:  # before any frame is read, refuse a sonar that sees no floor or too much of it
        recognizer = Recognizer(meshes, sonar, segmenter=segmenter, refine=refine, engine=engine)
    except SonarjaxError as error:
        raise SonarjaxError(naming(args.sonar, error)) from error
    motion = Standing() if args.motion == "standing" else Turning()
    tracker = Tracker(recognizer, motion, threshold=args.threshold) if args.track else None
    frames = frames_for(sonar, args.frames, args.sonar)
    if args.cluster is not None:
        work = Work(secrets.token_hex(8), meshes, sonar, segmenter, refine, args.threshold)
        with engine_of(args.cluster) as workers, JsonLines(args.out) as lines:
            return _write(lines, workers.stream(recognize_on_worker, work, frames))
    with JsonLines(args.out) as lines:  # opened first, because to prepare targets takes minutes
        if len(meshes) > 1:
            complain(f"preparing {len(meshes)} targets", kind="")
            recognizer.prepare()
        if tracker is not None:
            return _write(lines, _in_order(tracker, frames))
        return _write(lines, engine.stream(_recognize_alone, (recognizer, args.threshold), frames))


def _check_threshold(args: argparse.Namespace, segmenter: Lazy) -> None:
    """Raise a SonarjaxError if no threshold is given, and the segmenter, or its rule where yaw is refined, has none."""
    own = segmenter if args.no_refine or segmenter.rule is None else segmenter.rule
    if args.threshold is None and own.threshold is None:
        raise SonarjaxError(f"--threshold: expected a number, because {args.segmenter} has no threshold of its own")


def _in_order(tracker: Lazy, frames: Iterable[tuple[str, Lazy]]) -> Iterator[dict[str, Any]]:
    """The records of a track, one frame after the other: each is also searched where the frames before it led."""

    def recognized(image: Lazy, mask: Lazy) -> tuple[Lazy, Lazy]:
        found = tracker.recognize(image, mask)
        return found, tracker.take(found)

    for name, frame in frames:
        record = _record(name, frame, recognized)
        if "error" in record:
            tracker.take(None)
        yield record


def _recognize_alone(shared: tuple[Lazy, float | None], named: tuple[str, Lazy], _: Lazy) -> dict[str, Any]:
    """The record of a frame without a track, given `shared`: the recognizer, and the threshold or None."""
    recognizer, threshold = shared
    return _record(*named, lambda image, mask: (recognizer(image, mask, threshold=threshold), None))


def _write(lines: JsonLines, records: Iterator[dict[str, Any]]) -> int:
    """Append each record to the file at once, report errors, and return the exit code: 1 if any frame failed."""
    code = 0
    for record in records:
        if "error" in record:
            complain(record["error"])
            code = 1
        lines.write(record)
    return code


def _record(name: str, frame: Lazy, recognized: Callable[[Lazy, Lazy], tuple[Lazy, Lazy]]) -> dict[str, Any]:
    """Make the record of a frame: the result, or the error if it cannot be read or recognized.

    Args:
        name: Name of the frame, for an error's record.
        frame: An `io.Frame`, or the exception that reading it raised.
        recognized: Takes image and mask; returns the result, and the track's state or None.
    """
    try:
        if isinstance(frame, Exception):
            raise frame
        started = time.perf_counter()
        found, tracked = recognized(frame.image, frame.mask)
        return record_of(found, frame.source, time.perf_counter() - started, tracked)
    except BrokenPipeError:
        raise
    except Exception as error:  # any failure with one frame must not keep the others from being recognized
        return {"frame": name, "error": naming(name, error), "schema": SCHEMA}


@dataclass(frozen=True)
class Work:
    """What the workers of a cluster need to recognize frames. Two are equal if their `token` is."""

    token: str
    """Identifies one run of the command."""
    targets: Lazy = field(compare=False)
    """The targets by name."""
    sonar: Lazy = field(compare=False)
    """The sonar."""
    segmenter: Lazy = field(compare=False)
    """The segmenter with its weights: a worker need not see the file that they are from."""
    refine: Lazy = field(compare=False)
    """A RefineConfig, or None to stop at the yaw bin."""
    threshold: float | None = field(compare=False)
    """Score from which on the target counts as shown; None for the segmenter's own."""


def recognize_on_worker(work: Work, named: tuple[str, Lazy], engine: Lazy) -> dict[str, Any]:
    """Make the record of a frame on a worker of a cluster.

    Args:
        work: What to recognize, and how.
        named: Name and frame, as `frames_for` yields them.
        engine: The worker's engine.
    """
    return _recognize_alone((_own_recognizer(work, engine), work.threshold), named, engine)


@lru_cache(maxsize=1)
def _own_recognizer(work: Work, engine: Lazy) -> Lazy:
    from sonarjax.recognize import Recognizer

    return Recognizer(work.targets, work.sonar, segmenter=work.segmenter, refine=work.refine, engine=engine)
