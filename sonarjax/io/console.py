"""What the command line prints: results on stdout, one line for each problem on stderr."""

from __future__ import annotations

import contextlib
import os
import sys

from sonarjax.io.errors import SonarjaxError


def complain(message: str, kind: str = "error: ") -> None:
    """Print one line on stderr, whatever `message` contains."""
    line = f"sonarjax: {kind}{' '.join(message.split())}"
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        if sys.stderr.isatty() and "tqdm" in sys.modules:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)  # above the progress bar
        else:
            print(line, file=sys.stderr, flush=True)


def say(text: str) -> None:
    """Print to stdout at once.

    Raises:
        SonarjaxError: It cannot be written.
        BrokenPipeError: Nobody reads it any more.
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
    """Redirect stdout to nowhere; otherwise the interpreter complains again when it flushes at exit."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
