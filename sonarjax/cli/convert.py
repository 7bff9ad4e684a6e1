"""`sonarjax convert`: convert a fan picture to a polar frame or back, and frames and recordings to ROS bags."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from sonarjax.cli.arguments import EXITS, FRAME_HELP, count, number
from sonarjax.cli.frames import start_jax
from sonarjax.io import (
    FAN_OPTIONS,
    FanOptions,
    PolarAxes,
    SonarjaxError,
    UnreadableError,
    check_outputs,
    complain,
    convert,
    one_frame,
    say,
    to_bag,
)


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser(
        "convert", help="turn a fan picture into a polar frame or back, or frames into a ROS bag", epilog=EXITS
    )
    command.set_defaults(run=run)
    command.add_argument(
        "files", metavar="FILE", nargs="+",
        help="a fan picture, or a polar frame: " + FRAME_HELP + "; one FILE, or for a bag any number",
    )  # fmt: skip
    command.add_argument(
        "--out",
        metavar="OUT",
        required=True,
        help="POLAR.npz, FAN.png, LOG.bag or LOG.mcap: its ending chooses the format",
    )
    command.add_argument("--sonar", metavar="S.toml", help="put the polar frame on this sonar's beams and range bins")
    for option, (metavar, text) in FAN_OPTIONS.items():
        value = {"metavar": metavar, "type": count if metavar == "N" else number}
        command.add_argument(option, help=text, **(value if metavar else {"action": "store_true"}))


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    check_outputs({"--out": args.out}, [*args.files, *([args.sonar] if args.sonar else [])])
    options = FanOptions(**{name: getattr(args, name) for name in FanOptions.__dataclass_fields__})
    if args.out.lower().endswith((".bag", ".mcap")):
        if args.sonar is not None:
            raise SonarjaxError(f"--sonar: cannot be used with the bag {args.out!r} as --out")
        damaged: list[SonarjaxError] = []

        def report(error: SonarjaxError) -> None:
            damaged.append(error)
            complain(str(error))

        try:
            say(to_bag(args.files, args.out, options, report))
        except UnreadableError as error:
            complain(str(error))
            return 1
        return 1 if damaged else 0
    if len(args.files) > 1:
        raise SonarjaxError(f"--out: {args.out!r} holds one frame: expected one FILE, got {len(args.files)}")
    axes = None if args.sonar is None else _axes_of(args.sonar)
    try:
        frame = one_frame(args.files[0])
    except SonarjaxError as error:
        complain(str(error))
        return 1
    say(convert(frame, args.out, options, axes))
    return 0


def _axes_of(toml: str) -> PolarAxes:
    """Beams and range bins of the sonar in a file."""
    start_jax()
    from sonarjax.sonar import Sonar, range_edges_of

    sonar = Sonar.from_toml(toml)
    return PolarAxes(np.asarray(sonar.azimuth, np.float64), range_edges_of(sonar))
