"""JSON Lines: one object a line, appended and flushed, so that a killed batch keeps what it wrote."""

from __future__ import annotations

import contextlib
import json
import math
import os
import stat
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason
from sonarjax.io.given import shown

START = 4096
"""Bytes of a file that are searched for where its text begins."""


class JsonLines:
    """A JSON Lines file open for appending; a context manager.

    A line that a killed run left unfinished is ended with the first new one. A line that can be written only in part is
    removed again.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a file for appending, and make it if there is none.

        Args:
            path: The file.

        Raises:
            SonarjaxError: It cannot be opened for writing, or is a regular file of something other than JSON lines.
        """
        self.name = os.fspath(path)
        try:
            self._descriptor = os.open(self.name, _access(self.name) | os.O_APPEND | os.O_CREAT, 0o666)
        except (OSError, ValueError) as error:
            raise SonarjaxError(f"{self.name!r}: cannot be opened for writing: {reason(error)}") from error
        self._open = True
        other = self._other_start()
        if other:
            self.close()
            got = f"a file that begins with {shown(other[:12])}"
            raise SonarjaxError(f"{self.name}: expected JSON lines to append to, got {got}")
        self._before = b"\n" if self._unfinished() else b""

    def write(self, record: Mapping[str, Any]) -> None:
        """Append one object as a line.

        NumPy values are written as numbers and lists, non-finite floats as null. Bytes of a file's name that are not
        UTF-8 are written as escapes, from which `json.loads` and `os.fsencode` make the same bytes again.

        Args:
            record: The object.

        Raises:
            SonarjaxError: The line cannot be written.
            TypeError: JSON cannot hold a value of the object.
        """
        line = json.dumps(plain(record), allow_nan=False, ensure_ascii=False).encode("utf-8", "backslashreplace")
        self._append(self._before + line + b"\n")
        self._before = b""

    def close(self) -> None:
        """Close the file; closing it again does nothing.

        Raises:
            SonarjaxError: The system reports a late write error.
        """
        if not self._open:
            return
        self._open = False
        try:
            os.close(self._descriptor)
        except OSError as error:
            raise SonarjaxError(f"{self.name}: cannot be written: {reason(error)}") from error

    def __enter__(self) -> JsonLines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _other_start(self) -> bytes:
        """How a regular file begins that holds no JSON lines. Empty for others, and for what a shell has opened."""
        if not stat.S_ISREG(os.fstat(self._descriptor).st_mode) or self.name.startswith("/dev/"):
            return b""  # a log to which /dev/stdout leads may hold other text
        start = os.read(self._descriptor, START).lstrip()
        return b"" if _are_lines(start) else start

    def _unfinished(self) -> bool:
        with contextlib.suppress(OSError):  # a pipe cannot be searched for its end
            end = os.lseek(self._descriptor, 0, os.SEEK_END)
            os.lseek(self._descriptor, max(0, end - 1), os.SEEK_SET)
            return end > 0 and os.read(self._descriptor, 1) != b"\n"
        return False

    def _append(self, line: bytes) -> None:
        written = 0
        try:
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
        except OSError as error:
            if written:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._descriptor, os.fstat(self._descriptor).st_size - written)
            if isinstance(error, BrokenPipeError):  # the reader of a pipe has gone, which is no fault of ours
                raise
            raise SonarjaxError(f"{self.name}: cannot be written: {reason(error)}") from error


def _access(path: str) -> int:
    """How a file is opened. A pipe is not opened for reading too: its only reader would never be seen to go away."""
    return os.O_RDWR if os.path.isfile(path) or not os.path.exists(path) else os.O_WRONLY


def _are_lines(start: bytes) -> bool:
    """Whether a file that begins so may hold JSON lines: every line begins an object, and not all are cut off.

    A killed run may have left its first line cut off. Of an indented JSON file the second line begins otherwise.
    """
    lines = [line for line in start.splitlines(keepends=True) if line.strip()]
    ended = [line for line in lines if line.endswith(b"\n")]
    return all(line.startswith(b"{") for line in lines) and (not ended or any(map(_is_object, ended)))


def _is_object(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def plain(value: Any) -> Any:
    """Convert `value` to JSON types: arrays to lists, NumPy scalars to numbers, non-finite floats to None.

    Raises:
        TypeError: JSON cannot hold the value.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (str, int, bool)) or value is None:
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    array = np.asarray(value)
    if array.dtype.kind not in "biufU":
        raise TypeError(f"a record holds {type(value).__name__}, which is not JSON")
    return plain(array.tolist())
