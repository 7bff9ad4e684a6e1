"""Whole files as bytes, with a clear error for everything that is not a readable file with something in it."""

from __future__ import annotations

import os
import stat

from sonarjax.io.errors import SonarjaxError


def reason(error: Exception) -> str:
    """The operating system's words for an error, in one line and without the path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__


def read_bytes(path: str | os.PathLike[str], allow_empty: bool = False) -> bytes:
    """The content of a file. Raises SonarjaxError when it is missing, a folder, a device, unreadable or empty."""
    name = os.fspath(path)
    try:
        mode = os.stat(name).st_mode
        if stat.S_ISDIR(mode):
            raise SonarjaxError(f"{name}: expected a file, this is a folder")
        if not stat.S_ISREG(mode):  # a device or a pipe might never end
            raise SonarjaxError(f"{name}: expected a regular file")
        with open(name, "rb") as file:
            data = file.read()
    except FileNotFoundError as error:
        raise SonarjaxError(f"{name}: no such file") from error
    except SonarjaxError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character
        raise SonarjaxError(f"{name!r}: cannot be read: {reason(error)}") from error
    if not data and not allow_empty:
        raise SonarjaxError(f"{name}: the file is empty")
    return data
