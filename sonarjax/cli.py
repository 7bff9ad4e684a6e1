"""The command `sonarjax`: render, segment, recognize, calibrate, train, info, convert; returns an exit code.

Exit codes: 0 done, identified or not; 1 a frame could not be read (the batch goes on); 2 arguments, mesh, TOML or
output that cannot be used; 130 interrupted. A wrong input gives one line on stderr. What only one command needs, such
as drawing and training, is imported after its arguments are known to be good. Angles are in degrees here, inside in
radians.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NoReturn

from sonarjax.io import FAN_OPTIONS, complain, say, silence_stdout
from sonarjax.results import SCHEMA, record_of
from sonarjax.segment import DEFAULT_SEGMENTER, SEGMENTERS

MAX_SUB_BEAMS = 64

Lazy = Any  # a type of a module that is imported inside the function: the docstring names it


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command with the arguments `argv` (default: those of the process); returns the exit code.

    Raises nothing for input that cannot be used, nor for an interrupt: one line on stderr says what happened.
    """
    try:
        args = _parser().parse_args(argv)
    except SystemExit as stop:  # --help, or arguments that cannot be used
        return int(stop.code or 0)
    from sonarjax.io import SonarjaxError

    try:
        return args.run(args)
    except SonarjaxError as error:
        complain(str(error))
    except KeyboardInterrupt:
        complain("interrupted", "")
        return 130
    except BrokenPipeError:  # whoever read our output has gone
        silence_stdout()
        return 141
    except (MemoryError, OSError, RuntimeError) as error:  # JAX reports a full memory or a missing device so
        complain(f"{args.command}: {type(error).__name__}: {error}")
    return 2


class _Parser(argparse.ArgumentParser):
    """argparse with one line for an error, and numbers such as -1e-3 taken as numbers."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        complain(f"{self.prog.removeprefix('sonarjax').strip()}: {message} (see {self.prog} --help)".lstrip(": "))
        raise SystemExit(2)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="sonarjax", description="Imaging-sonar simulation and recognition of objects with their yaw.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (_add_render, _add_segment, _add_recognize, _add_calibrate, _add_train, _add_info, _add_convert):
        add(commands)
    return parser


_FRAME_HELP = ".npz (image, mask), .npy, .png, or a sonar file .aris/.ddf/.raw (all its frames; FILE:N for one, from 0)"
_EXITS = "exit codes: 0 done; 1 a frame could not be read; 2 arguments, mesh, TOML or output that cannot be used"


def _add_render(commands: Any) -> None:
    command = commands.add_parser("render", help="simulate the frame of a mesh", epilog=_EXITS)
    command.set_defaults(run=_render)
    command.add_argument("mesh", metavar="MESH", help="surface in any format that trimesh reads (STL, OBJ, PLY, ...)")
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the sonar and its geometry")
    command.add_argument("--x", metavar="M", required=True, type=_number, help="forward position of the mesh [m]")
    command.add_argument("--y", metavar="M", required=True, type=_number, help="its position to port [m]")
    command.add_argument(
        "--yaw-deg", metavar="D", required=True, type=_number, help="its yaw, counter-clockwise from above [deg]"
    )
    command.add_argument(
        "--out", metavar="FRAME.npz", required=True,
        help="written: image (semantic), intensity, highlight, shadow, labels, azimuth_deg, range_edges_m",
    )  # fmt: skip
    command.add_argument(
        "--png", metavar="P",
        help="a picture for people: polar and fan views with axes (for a frame that is data, use FRAME.npz)",
    )  # fmt: skip
    _add_unit(command)
    command.add_argument(
        "--sub-beams", metavar="N", type=partial(_count, high=MAX_SUB_BEAMS),
        help=f"azimuth parts of a beam, 1 to {MAX_SUB_BEAMS} (default: 2)",
    )  # fmt: skip


def _add_segment(commands: Any) -> None:
    command = commands.add_parser("segment", help="background, highlight and shadow of frames", epilog=_EXITS)
    command.set_defaults(run=_segment)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=_FRAME_HELP)
    command.add_argument(
        "--out-dir", metavar="DIR", required=True,
        help="folder, made if missing; labels_<stem>.npz with `labels`: 0 background, 1 highlight, 2 shadow",
    )  # fmt: skip


def _add_recognize(commands: Any) -> None:
    command = commands.add_parser("recognize", help="is the target in these frames, and at which yaw?", epilog=_EXITS)
    command.set_defaults(run=_recognize)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=_FRAME_HELP)
    command.add_argument("--target", metavar="MESH", required=True, help="the object to look for")
    command.add_argument(
        "--sonar", metavar="S.toml", required=True, help="the sonar and its geometry (overrides a file's header)"
    )
    command.add_argument("--out", metavar="R.jsonl", required=True, help="one JSON object a frame is appended")
    command.add_argument(
        "--segmenter", metavar="NAME", default=DEFAULT_SEGMENTER,
        help=f"{', '.join(SEGMENTERS)}; none matches the grey frame itself (default: %(default)s)",
    )  # fmt: skip
    command.add_argument("--no-refine", action="store_true", help="stop at the yaw bin of the template bank")
    command.add_argument(
        "--threshold", metavar="T", type=_correlation, help="score from which on it is the target (default: shipped)"
    )
    command.add_argument(
        "--track", action="store_true", help="the frames are one sequence: yaw and place are what all so far say"
    )
    command.add_argument(
        "--motion", choices=("turning", "standing"), default="turning",
        help="with --track, how the target may move from frame to frame (default: %(default)s)",
    )  # fmt: skip
    _add_unit(command)


def _add_calibrate(commands: Any) -> None:
    command = commands.add_parser("calibrate", help="the sonar's geometry from frames of a known object", epilog=_EXITS)
    command.set_defaults(run=_calibrate)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=_FRAME_HELP)
    command.add_argument("--target", metavar="MESH", required=True, help="the object in the frames, at unknown poses")
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the sonar as it is known so far")
    command.add_argument("--out", metavar="FITTED.toml", required=True, help="written: the fitted sonar")
    command.add_argument(
        "--free", metavar="NAMES", default="tilt,height", type=lambda text: tuple(text.split(",")),
        help="what is unknown, of tilt, roll, height, elevation_aperture, range_offset, range_scale, azimuth_scale, "
        "beam_bend (default: %(default)s)",
    )  # fmt: skip
    command.add_argument("--png", metavar="P", help="a picture for people: frames, and what the fit makes of them")
    _add_unit(command)


def _add_train(commands: Any) -> None:
    command = commands.add_parser("train", help="train the pix2pix segmenter on simulated pairs")
    command.set_defaults(run=_train)
    command.add_argument(
        "--preset", choices=("smoke", "cpu", "paper"), required=True,
        help="smoke: does it run; cpu: the recipe of the shipped weights; paper: full width and 30 epochs, for a GPU",
    )  # fmt: skip
    command.add_argument(
        "--run-dir", metavar="RUN", required=True,
        help="folder, made if missing: checkpoints, TensorBoard events, metrics.jsonl, samples, weights.safetensors",
    )  # fmt: skip
    command.add_argument("--resume", action="store_true", help="go on from the last checkpoint in RUN, if there is one")


def _add_info(commands: Any) -> None:
    command = commands.add_parser("info", help="what a frame, sonar or weights file holds", epilog=_EXITS)
    command.set_defaults(run=_info)
    command.add_argument("file", metavar="FILE", help=f"{_FRAME_HELP}, a sonar.toml, or a weights.safetensors")


def _add_convert(commands: Any) -> None:
    command = commands.add_parser("convert", help="a fan picture as a polar frame, and back", epilog=_EXITS)
    command.set_defaults(run=_convert)
    command.add_argument("file", metavar="FILE", help="a fan picture, or a polar frame: " + _FRAME_HELP)
    command.add_argument("--out", metavar="OUT", required=True, help="POLAR.npz or FAN.png: its ending says which way")
    for option, (metavar, text) in FAN_OPTIONS.items():
        value = {"metavar": metavar, "type": _count if metavar == "N" else _number}
        command.add_argument(option, help=text, **(value if metavar else {"action": "store_true"}))


def _add_unit(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--unit-m", metavar="M", type=_number, help="length of the mesh file's unit [m], such as 0.001 for millimetres"
    )


def _number(text: str) -> float:
    return _limited(text, -1e6, 1e6)


def _correlation(text: str) -> float:
    return _limited(text, -1.0, 1.0)


def _count(text: str, high: int = 65536) -> int:
    number = _limited(text, 1.0, float(high))
    if number != int(number):
        raise argparse.ArgumentTypeError(f"expected a whole number, got {text!r}")
    return int(number)


def _limited(text: str, low: float, high: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        raise argparse.ArgumentTypeError(f"expected a number from {low:g} to {high:g}, got {text!r}")
    return number


def _render(args: argparse.Namespace) -> int:
    from sonarjax.io import check_outputs

    check_outputs({"--out": args.out, "--png": args.png}, (args.mesh, args.sonar))
    _start_jax()
    from sonarjax.render import RenderQuality, check_fits, render, write_frame
    from sonarjax.scene import Mesh, Pose
    from sonarjax.sonar import Sonar

    sonar, mesh = Sonar.from_toml(args.sonar), Mesh.load(args.mesh, args.unit_m)
    check_fits(mesh, sonar, args.mesh)
    quality = RenderQuality() if args.sub_beams is None else RenderQuality(sub_beams=args.sub_beams)
    frame = render(mesh, Pose(x=args.x, y=args.y, yaw=math.radians(args.yaw_deg)), sonar, quality=quality)
    write_frame(args.out, frame, sonar)
    if args.png is not None:
        from sonarjax.plot import plot_frame, save_figure

        save_figure(plot_frame(frame, sonar), args.png)
    if not frame.labels().any():
        complain(f"{args.mesh}: nothing of it is in the sonar's view at x {args.x:g} m, y {args.y:g} m", "note: ")
    return 0


def _segment(args: argparse.Namespace) -> int:
    from sonarjax.io import SonarjaxError, check_label_files, make_folder, naming, write_npz

    check_label_files(args.out_dir, args.frames)
    _start_jax()

    from sonarjax.cpu import CpuEngine
    from sonarjax.segment import load_segmenter

    segmenter, engine = load_segmenter(), CpuEngine()
    make_folder(args.out_dir)
    code, written = 0, dict[str, str]()
    for name, frame in _each_frame(args.frames):
        try:
            if isinstance(frame, Exception):
                raise frame
            labels = segmenter.labels(frame.image, frame.mask, engine)
        except BrokenPipeError:
            raise
        except Exception as error:  # whatever one frame does to us, the others are still to be segmented
            complain(naming(name, error))
            code = 1
            continue
        if written.setdefault(frame.stem, name) != name:
            raise SonarjaxError(f"{name}: its labels would overwrite those of {written[frame.stem]}: same stem")
        path = os.path.join(args.out_dir, f"labels_{frame.stem}.npz")
        write_npz(path, labels=labels)
    return code


def _recognize(args: argparse.Namespace) -> int:
    from sonarjax.io import JsonLines, SonarjaxError, check_outputs, naming

    check_outputs({"--out": args.out}, (*args.frames, args.target, args.sonar))
    _start_jax()
    from sonarjax.cpu import CpuEngine
    from sonarjax.recognize import Recognizer
    from sonarjax.refine import MAP_REFINEMENT
    from sonarjax.render import check_fits
    from sonarjax.scene import Mesh
    from sonarjax.segment import check_segmenter
    from sonarjax.sonar import Sonar
    from sonarjax.track import Standing, Tracker, Turning

    check_segmenter(args.segmenter)
    sonar, mesh = Sonar.from_toml(args.sonar), Mesh.load(args.target, args.unit_m)
    check_fits(mesh, sonar, args.target)
    refine = None if args.no_refine else MAP_REFINEMENT
    try:  # a sonar that sees no floor, or too much, is refused before any frame is read
        recognizer = Recognizer(mesh, sonar, segmenter=args.segmenter, refine=refine, engine=CpuEngine())
    except SonarjaxError as error:
        raise SonarjaxError(naming(args.sonar, error)) from error
    motion = Turning() if args.motion == "turning" else Standing()
    tracker = Tracker(recognizer, motion, threshold=args.threshold) if args.track else None
    code = 0
    with JsonLines(args.out) as lines:
        for name, frame in _each_frame(args.frames):
            try:
                if isinstance(frame, Exception):
                    raise frame
                started = time.perf_counter()
                if tracker is None:
                    found, tracked = recognizer(frame.image, frame.mask, threshold=args.threshold), None
                else:
                    found = tracker.recognize(frame.image, frame.mask)
                    tracked = tracker.take(found)
                record = record_of(found, frame.source, time.perf_counter() - started, tracked)
            except BrokenPipeError:
                raise
            except Exception as error:  # whatever one frame does to us, the others are still to be recognized
                if tracker is not None:
                    tracker.take(None)
                record = {"frame": name, "error": naming(name, error), "schema": SCHEMA}
                complain(record["error"])
                code = 1
            lines.write(record)
    return code


def _calibrate(args: argparse.Namespace) -> int:
    from sonarjax.io import check_outputs, naming

    check_outputs({"--out": args.out, "--png": args.png}, (*args.frames, args.target, args.sonar))
    _start_jax()
    from sonarjax.calibrate import calibrate, check_free, compare_templates, describe_calibration
    from sonarjax.cpu import CpuEngine
    from sonarjax.scene import Mesh
    from sonarjax.sonar import Sonar

    check_free(args.free)
    sonar, mesh = Sonar.from_toml(args.sonar), Mesh.load(args.target, args.unit_m)
    frames = []
    for name, frame in _each_frame(args.frames):
        if isinstance(frame, Exception):
            complain(naming(name, frame))
            return 1
        frames.append(frame)
    images, masks = [frame.image for frame in frames], [frame.mask for frame in frames]
    found = calibrate(
        images, mesh, sonar, free=args.free, masks=masks, engine=CpuEngine(), progress=partial(complain, kind="")
    )
    found.sonar.to_toml(args.out)
    if args.png is not None:
        from sonarjax.plot import plot_calibration, save_figure

        save_figure(plot_calibration(*compare_templates(found, images, mesh, sonar), sonar), args.png)
    say(describe_calibration(found, sonar, [frame.source for frame in frames]))
    return 0


def _train(args: argparse.Namespace) -> int:
    _start_jax()
    from sonarjax.cpu import CpuEngine, keep_memory
    from sonarjax.segment.training import train

    keep_memory()  # a third of a step would go into asking for its memory again
    result = train(args.preset, args.run_dir, resume=args.resume, engine=CpuEngine())
    if not result.finished:
        complain(f"stopped after step {result.step}; --resume goes on from there", "")
        return 130
    say(f"{result.weights}: " + ", ".join(f"{name} {value:.3f}" for name, value in result.metrics.items()))
    return 0


def _info(args: argparse.Namespace) -> int:
    from sonarjax.io import SonarjaxError, describe

    try:
        text = describe(args.file)
    except SonarjaxError as error:
        complain(str(error))
        return 2 if args.file.lower().endswith(".toml") else 1
    say(text)
    return 0


def _convert(args: argparse.Namespace) -> int:
    from sonarjax.io import FanOptions, SonarjaxError, check_outputs, convert, one_frame

    check_outputs({"--out": args.out}, (args.file,))
    try:
        frame = one_frame(args.file)
    except SonarjaxError as error:
        complain(str(error))
        return 1
    options = FanOptions(**{name: getattr(args, name) for name in FanOptions.__dataclass_fields__})
    say(convert(frame, args.out, options))
    return 0


def _each_frame(specs: Sequence[str]) -> Iterator[tuple[str, Lazy]]:
    """Name and io.Frame of every frame in the order given; for one that cannot be read, the exception that says why.

    A bar on stderr shows progress where that is a terminal.
    """
    from tqdm import tqdm

    from sonarjax.io import iter_frames, split_spec

    with tqdm(total=len(specs), unit="frame", file=sys.stderr, disable=not sys.stderr.isatty()) as bar:
        for spec in specs:
            first = True
            try:
                for frame in iter_frames(spec):
                    if first and split_spec(spec)[1] is None:
                        bar.total += frame.meta["n_frames"] - 1  # known only now
                    first = False
                    yield frame.source, frame
                    bar.update()
            except BrokenPipeError:
                raise
            except Exception as error:
                yield spec, error
                bar.update()


def _start_jax() -> None:
    """Set the process up for a CPU, before anything is compiled."""
    from sonarjax import cpu

    cpu.tune()


if __name__ == "__main__":
    sys.exit(main())
