"""`sonarjax convert`: a fan picture as a polar frame, and back."""

from __future__ import annotations

import argparse
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP, count, number
from sonarjax.io import FAN_OPTIONS, FanOptions, SonarjaxError, check_outputs, complain, convert, one_frame, say


def add(commands: Any) -> None:
    """Add the command's arguments to the parser's `commands`."""
    command = commands.add_parser("convert", help="a fan picture as a polar frame, and back", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument("file", metavar="FILE", help="a fan picture, or a polar frame: " + FRAME_HELP)
    command.add_argument("--out", metavar="OUT", required=True, help="POLAR.npz or FAN.png: its ending says which way")
    for option, (metavar, text) in FAN_OPTIONS.items():
        value = {"metavar": metavar, "type": count if metavar == "N" else number}
        command.add_argument(option, help=text, **(value if metavar else {"action": "store_true"}))


def run(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code. Raises SonarjaxError for input that cannot be used."""
    check_outputs({"--out": args.out}, (args.file,))
    try:
        frame = one_frame(args.file)
    except SonarjaxError as error:
        complain(str(error))
        return 1
    options = FanOptions(**{name: getattr(args, name) for name in FanOptions.__dataclass_fields__})
    say(convert(frame, args.out, options))
    return 0
