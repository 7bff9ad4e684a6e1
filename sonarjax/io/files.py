"""Content of files, read at once or part by part, with a clear error if there is no readable file with content."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from sonarjax.io.errors import SonarjaxError


class FileContent:
    """Content of an open file, of which parts are read when they are used: a file may be larger than the memory.

    It is not memory-mapped: then a file that another program shortens would end this process without a word.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self._name = file, name
        self._size = os.fstat(file.fileno()).st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        """Bytes of the file. Raises SonarjaxError if the file has become shorter, or cannot be read any more."""
        start, stop, _ = part.indices(self._size)
        wanted = max(0, stop - start)
        with _explained(self._name):
            self._file.seek(start)
            found = self._file.read(wanted)
        if len(found) < wanted:
            raise SonarjaxError(f"{self._name}: became shorter while it was read: expected {stop} bytes or more")
        return found

    def find(self, wanted: bytes, start: int, end: int | None = None) -> int:
        """As `bytes.find`. The pieces that are searched double in size: what is near is found without much reading."""
        end, piece = self._size if end is None else min(end, self._size), 2**12
        while start < end:
            at = self[start : min(start + piece + len(wanted) - 1, end)].find(wanted)
            if at >= 0:
                return start + at
            start, piece = start + piece, min(2 * piece, 2**20)
        return -1


Content = bytes | FileContent
"""A file's content: read completely, or read where it is used."""


def reason(error: Exception) -> str:
    """The operating system's message for an error, in one line and without the path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__


FILE_LIMIT = 16 * 2**30
"""Largest file that is read completely, 16 GiB [bytes]; half of the machine's memory if that is less."""


def size_limit() -> int:
    """Largest file that this machine can hold in memory, at most `FILE_LIMIT` [bytes]."""
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not every system says
        return FILE_LIMIT
    return min(FILE_LIMIT, memory // 2) if memory > 0 else FILE_LIMIT


def readable_size(size: int) -> str:
    """A size [bytes] as text for messages, such as `1.5 GiB`."""
    power = min(max(size.bit_length() - 1, 0) // 10, 3)
    return f"{size / 1024**power:.4g} {('bytes', 'KiB', 'MiB', 'GiB')[power]}"


def check_size(name: str, size: int, limit: int) -> None:
    """Raise a SonarjaxError if a file of `size` bytes is larger than `limit` [bytes]."""
    if size > limit:
        raise SonarjaxError(
            f"{name}: the file is too large: expected at most {readable_size(limit)}, got {readable_size(size)}"
        )


@contextmanager
def open_content(path: str | os.PathLike[str]) -> Iterator[FileContent]:
    """Open a file of any size: its parts are read from the disk when they are used.

    Raises:
        SonarjaxError: The file is missing, a folder, a device, unreadable or empty.
    """
    name = os.fspath(path)
    with _explained(name):
        if _regular_size(name) == 0:
            raise SonarjaxError(f"{name}: the file is empty")
        file = open(name, "rb")  # noqa: SIM115
    with file:
        yield FileContent(file, name)


def read_bytes(path: str | os.PathLike[str], allow_empty: bool = False, limit: int | None = None) -> bytes:
    """Read a file completely.

    Args:
        path: File to read.
        allow_empty: If True, an empty file is no error.
        limit: Largest size that is read [bytes]; None means `size_limit()`, which also bounds a larger `limit`.

    Returns:
        Content of the file.

    Raises:
        SonarjaxError: The file is missing, a folder, a device, unreadable, empty or too large.
    """
    name = os.fspath(path)
    with _explained(name):
        check_size(name, _regular_size(name), size_limit() if limit is None else min(limit, size_limit()))
        with open(name, "rb") as file:
            data = file.read()
    if not data and not allow_empty:
        raise SonarjaxError(f"{name}: the file is empty")
    return data


def _regular_size(name: str) -> int:
    status = os.stat(name)
    if stat.S_ISDIR(status.st_mode):
        raise SonarjaxError(f"{name}: expected a file, this is a folder")
    if not stat.S_ISREG(status.st_mode):  # a device or a pipe might never end
        raise SonarjaxError(f"{name}: expected a regular file")
    return status.st_size


@contextmanager
def _explained(name: str) -> Iterator[None]:
    """Turn whatever goes wrong while a file is opened into a SonarjaxError that names it."""
    try:
        yield
    except FileNotFoundError as error:
        raise SonarjaxError(f"{name or repr(name)}: no such file") from error
    except MemoryError as error:
        raise SonarjaxError(f"{name}: the file is too large for the free memory") from error
    except SonarjaxError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character
        raise SonarjaxError(f"{name!r}: cannot be read: {reason(error)}") from error
