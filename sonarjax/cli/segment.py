"""`sonarjax segment`: background, highlight and shadow of frames."""

from __future__ import annotations

import argparse
import os
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP, add_segmenter_option
from sonarjax.cli.frames import each_frame, start_jax
from sonarjax.io import SonarjaxError, check_label_files, complain, make_folder, naming, write_npz
from sonarjax.io.outputs import same_file


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("segment", help="label background, highlight and shadow in frames", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=FRAME_HELP)
    command.add_argument(
        "--out-dir", metavar="DIR", required=True,
        help="output folder, created if missing: labels_<stem>.npz with `labels`, 0 background, 1 highlight, 2 shadow",
    )  # fmt: skip
    add_segmenter_option(command, "cuts the grey frame at 1/4 and 3/4")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    check_label_files(args.out_dir, args.frames)
    start_jax()

    from sonarjax.cpu import usual_engine
    from sonarjax.segment import load_segmenter

    segmenter, engine = load_segmenter(args.segmenter), usual_engine()
    make_folder(args.out_dir)
    code, written = 0, dict[str, str]()
    for name, frame in each_frame(args.frames):
        try:
            if isinstance(frame, Exception):
                raise frame
            labels = segmenter.labels(frame.image, frame.mask, engine)
        except BrokenPipeError:
            raise
        except Exception as error:  # whatever goes wrong with one frame, go on to the others
            complain(naming(name, error))
            code = 1
            continue
        other = written.setdefault(frame.stem, name)
        if other != name and not same_file(other, name):
            raise SonarjaxError(f"{name}: its labels would overwrite those of {other} (same stem)")
        path = os.path.join(args.out_dir, f"labels_{frame.stem}.npz")
        write_npz(path, labels=labels)
    return code
