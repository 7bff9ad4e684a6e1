"""`sonarjax info`: describe the content of a frame, sonar or weights file."""

from __future__ import annotations

import argparse
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP
from sonarjax.io import SonarjaxError, complain, describe, say


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("info", help="show what a frame, sonar or weights file holds", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument("file", metavar="FILE", help=f"{FRAME_HELP}, a sonar.toml, or a weights.safetensors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code: 1 for a file that cannot be read, 2 if it is a sonar.toml."""
    try:
        text = describe(args.file)
    except SonarjaxError as error:
        complain(str(error))
        return 2 if args.file.lower().endswith(".toml") else 1
    say(text)
    return 0
