"""What the command line prints: results on stdout, one line for each problem on stderr."""

from __future__ import annotations

import contextlib
import os
import sys

from sonarjax.io.errors import SonarjaxError


def open_closed_streams() -> None:
    """Connect stdin, stdout and stderr to the null device where they were closed, as in some daemons.

    Python has None for such a stream, and its number goes to the next file that is opened, into which a library's own
    messages would then be written.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is most often the stream's own
            os.set_inheritable(nowhere, nowhere == number)  # else programs that this one starts have the same trouble
            setattr(sys, name, open(nowhere, "r" if number == 0 else "w", encoding="utf-8", closefd=False))  # noqa: SIM115


def complain(message: str, kind: str = "error: ") -> None:
    """Print a message on stderr as one line, even if it contains line breaks.

    If a progress bar is shown, the line appears above it. A closed stderr is ignored.

    Args:
        message: Text of the message.
        kind: What stands before it in the line.
    """
    line = f"sonarjax: {kind}{' '.join(message.split())}"
    if sys.stderr is None:
        return
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        if sys.stderr.isatty() and "tqdm" in sys.modules:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)  # above the progress bar
        else:
            print(line, file=sys.stderr, flush=True)


def say(text: str) -> None:
    """Print a text to stdout at once; a closed stdout is ignored.

    Args:
        text: Text to print. Characters that stdout cannot encode are printed as backslash escapes.

    Raises:
        SonarjaxError: The text cannot be written.
        BrokenPipeError: Nobody reads stdout any more.
    """
    if sys.stdout is None:
        return
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
