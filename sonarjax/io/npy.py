"""NumPy arrays out of NPY bytes and NPZ members, without pickle and without trusting their headers.

An NPY header says how much to allocate, and a zip member may unpack to a thousand times its size. Here the header is
read first, and nothing is unpacked that has more than `PIXEL_LIMIT` numbers or more bytes than its header announces.
"""

from __future__ import annotations

import ast
import io
import math
import struct
import zipfile
from dataclasses import dataclass

import numpy as np

from sonarjax.io.errors import SonarjaxError

PIXEL_LIMIT = 64 * 2**20
"""Largest number of pixels that a PNG, NPY or NPZ may ask for (64 Mi); a full Oculus ping has 0.2 Mi."""
HEADER_LIMIT = 4096
"""Longest NPY header that is read [bytes]; NumPy itself writes 128."""


@dataclass(frozen=True)
class NpyHeader:
    """What an NPY header says, checked: a plain number type and a size within the limit."""

    dtype: np.dtype
    """Type of the numbers: bool, integer or float."""
    shape: tuple[int, ...]
    """Shape of the array."""
    fortran: bool
    """True where the first axis runs fastest."""
    offset: int
    """Where the numbers start [bytes]."""

    @property
    def n_bytes(self) -> int:
        """Size of the numbers [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize


def npy_header(data: bytes, name: str, field: str = "array") -> NpyHeader:
    """Read and check the header at the start of `data`.

    Raises SonarjaxError for a wrong magic, a header that is no dict of descr, fortran_order and shape, a type other
    than bool, integer or float, and more than `PIXEL_LIMIT` numbers.
    """
    text, offset = _header_text(data, name, field)
    try:
        if "\\" in text:  # NumPy writes none, and Python warns of the wrong ones
            raise ValueError("escape")
        said = ast.literal_eval(text)
        descr, fortran, shape = said["descr"], said["fortran_order"], said["shape"]
    except Exception as error:  # a hostile literal can raise nearly anything, MemoryError and RecursionError included
        raise SonarjaxError(f"{name}: {field}: NPY header: expected a dict of descr, fortran_order, shape") from error
    if not (isinstance(shape, tuple) and all(type(n) is int and n >= 0 for n in shape) and type(fortran) is bool):
        raise SonarjaxError(f"{name}: {field}: NPY header: expected a shape of whole numbers, got {_short(shape)}")
    dtype = _plain_dtype(descr, name, field)
    if math.prod(shape) > PIXEL_LIMIT:
        raise SonarjaxError(f"{name}: {field}: shape {_short(shape)}: expected at most {PIXEL_LIMIT} numbers")
    return NpyHeader(dtype, shape, fortran, offset)


def _header_text(data: bytes, name: str, field: str) -> tuple[str, int]:
    if len(data) < 10 or data[:6] != b"\x93NUMPY" or data[6] not in (1, 2, 3):
        raise SonarjaxError(f"{name}: {field}: expected NPY data (magic \\x93NUMPY, version 1 to 3)")
    layout = "<H" if data[6] == 1 else "<I"
    start = 8 + struct.calcsize(layout)
    if len(data) < start:
        raise SonarjaxError(f"{name}: {field}: NPY header: truncated")
    length = struct.unpack_from(layout, data, 8)[0]
    if length > HEADER_LIMIT or start + length > len(data):
        raise SonarjaxError(f"{name}: {field}: NPY header: expected at most {HEADER_LIMIT} bytes, all in the file")
    return data[start : start + length].decode("latin-1"), start + length


def _plain_dtype(descr: object, name: str, field: str) -> np.dtype:
    try:
        dtype = np.dtype(descr) if isinstance(descr, str) else None
    except Exception:  # np.dtype raises several types on a malformed string
        dtype = None
    if dtype is None or dtype.names is not None or dtype.subdtype is not None or dtype.kind not in "biuf":
        raise SonarjaxError(f"{name}: {field}: dtype: expected bool, integer or float, got {_short(descr)}")
    return dtype


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def parse_npy(data: bytes, name: str, field: str = "array") -> np.ndarray:
    """The array (any shape) of NPY bytes, read-only and without a copy.

    Raises SonarjaxError as `npy_header` does, and when the file ends before the last number.
    """
    header = npy_header(data, name, field)
    if header.offset + header.n_bytes > len(data):
        there = len(data) - header.offset
        raise SonarjaxError(f"{name}: {field}: truncated: expected {header.n_bytes} bytes of numbers, {there} follow")
    flat = np.frombuffer(data, header.dtype, math.prod(header.shape), header.offset)
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


class NpzArchive:
    """The arrays of an NPZ, each read only when asked for and within the limits of this module."""

    def __init__(self, data: bytes, name: str) -> None:
        """Open the archive. Raises SonarjaxError when `data` is no zip file."""
        self.name = name
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
            members = self._zip.infolist()
        except Exception as error:  # zipfile raises many types on corrupt directories
            raise SonarjaxError(f"{name}: expected an NPZ (zip) file that is complete: {_line(error)}") from error
        self._members = {info.filename.removesuffix(".npy"): info for info in members}

    @property
    def keys(self) -> list[str]:
        """Names of the arrays, in the order of the file."""
        return list(self._members)

    def header(self, key: str) -> NpyHeader:
        """Type and shape of one array. Raises SonarjaxError when it is absent, unreadable or over the limit."""
        return npy_header(self._read(key, 0)[0], self.name, key)

    def array(self, key: str) -> np.ndarray:
        """One array. Raises SonarjaxError as `header` does, and when its numbers are not all there."""
        header = self.header(key)
        content, more = self._read(key, header.offset + header.n_bytes)
        if more:
            raise SonarjaxError(f"{self.name}: {key}: expected {header.n_bytes} bytes of numbers, more follow")
        return parse_npy(content, self.name, key)

    def _read(self, key: str, size: int) -> tuple[bytes, bool]:
        """The first `size` bytes of a member (a header's worth for 0), and whether more follow."""
        if key not in self._members:
            found = ", ".join(self.keys[:8]) or "nothing"
            raise SonarjaxError(f"{self.name}: {key}: expected an array of this name, found {_short(found)}")
        info = self._members[key]
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise SonarjaxError(f"{self.name}: {key}: expected a stored or deflated member without a password")
        try:
            with self._zip.open(info) as member:
                if size == 0:
                    return member.read(HEADER_LIMIT + 12), False
                # The byte past the end makes zipfile check the sum.
                return member.read(size), bool(member.read(1))
        except Exception as error:
            raise SonarjaxError(f"{self.name}: {key}: cannot be unpacked: {_line(error)}") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
