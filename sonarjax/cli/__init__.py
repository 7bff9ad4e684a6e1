"""The command `sonarjax`: render, recognize, segment, calibrate, dataset, train and more; returns an exit code.

Exit codes: 0 done, identified or not; 1 a frame could not be read or used (the batch goes on); 2 arguments, mesh, TOML
or output that cannot be used; 130 interrupted; 141 the program that read the output has gone. A wrong input gives one
line on stderr. Only while Python still loads the libraries, in the first seconds, may an interrupt show a traceback or
go unnoticed. What only one command needs, such as drawing and training, is imported after its arguments are known to be
good. Angles are in degrees here, inside in radians. Each command has a file here: `add` says what its arguments are,
`run` does it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from sonarjax.cli import calibrate, convert, dataset, export, info, recognize, render, segment, train
from sonarjax.cli.arguments import Parser
from sonarjax.io import SonarjaxError, complain, silence_stdout
from sonarjax.io.console import open_closed_streams

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Input that cannot be used and an interrupt raise nothing: one line on stderr says what happened.

    Args:
        argv: Arguments, with the name of the command first; None means those of the process.

    Returns:
        Exit code: 0 done, 1 a frame could not be read or used, 2 the input could not be used, 130 interrupted, 141 the
        program that read the output has gone.
    """
    open_closed_streams()
    try:
        args = _parser().parse_args(argv)
    except SystemExit as stop:  # --help, or arguments that cannot be used
        return int(stop.code or 0)
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


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="sonarjax", description="Imaging-sonar simulation and recognition of objects with their yaw.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in (render, segment, recognize, calibrate, dataset, train, info, convert, export):
        command.add(commands)
    return parser
