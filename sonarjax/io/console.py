"""What the command line prints: results on stdout, one line for each problem on stderr."""

from __future__ import annotations

import contextlib
import os
import sys

from sonarjax.io.errors import SonarjaxError


def complain(message: str, kind: str = "error: ") -> None:
    """Print a message on stderr as one line, even if it contains line breaks.

    If a progress bar is shown, the line appears above it. A closed stderr is ignored.

    Args:
        message: Text of the message.
        kind: What stands before it in the line.
    """
    line = f"sonarjax: {kind}{' '.join(message.split())}"
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        if sys.stderr.isatty() and "tqdm" in sys.modules:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)  # above the progress bar
        else:
            print(line, file=sys.stderr, flush=True)


def say(text: str) -> None:
    """Print a text to stdout at once.

    Args:
        text: Text to print. Characters that stdout cannot encode are printed as backslash escapes.

    Raises:
        SonarjaxError: The text cannot be written.
        BrokenPipeError: Nobody reads stdout any more.
    """
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(
            text.encode(encoding, "backslashreplace").decode(encoding), flush=True
        )  # for terminals that know only ASCII
    except BrokenPipeError:
        raise
    except OSError as error:
        silence_stdout()
        raise SonarjaxError(f"stdout: cannot be written: {error.strerror}") from error


def silence_stdout() -> None:
    """Redirect stdout to the null device.

    Call it after stdout has failed; otherwise the interpreter complains again when it flushes at exit.
    """
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
