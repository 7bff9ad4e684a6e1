"""`sonarjax convert`: a fan picture as a polar frame, and back; recordings as ROS bags."""

from __future__ import annotations

import argparse
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP, count, number
from sonarjax.io import FAN_OPTIONS, FanOptions, SonarjaxError, check_outputs, complain, convert, one_frame, say, to_bag


def add(commands: Any) -> None:
    """Add the command's arguments to the parser's `commands`."""
    command = commands.add_parser(
        "convert", help="a fan picture as a polar frame, and back; a recording as a ROS bag", epilog=EXITS
    )
    command.set_defaults(run=run)
    command.add_argument("file", metavar="FILE", help="a fan picture, or a polar frame: " + FRAME_HELP)
    command.add_argument(
        "--out",
        metavar="OUT",
        required=True,
        help="POLAR.npz, FAN.png, LOG.bag or LOG.mcap: its ending says what is made",
    )
    for option, (metavar, text) in FAN_OPTIONS.items():
        value = {"metavar": metavar, "type": count if metavar == "N" else number}
        command.add_argument(option, help=text, **(value if metavar else {"action": "store_true"}))


def run(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code. Raises SonarjaxError for input that cannot be used."""
    check_outputs({"--out": args.out}, (args.file,))
    options = FanOptions(**{name: getattr(args, name) for name in FanOptions.__dataclass_fields__})
    if args.out.lower().endswith((".bag", ".mcap")):
        say(to_bag(args.file, args.out, options))
        return 0
    try:
        frame = one_frame(args.file)
    except SonarjaxError as error:
        complain(str(error))
        return 1
    say(convert(frame, args.out, options))
    return 0
