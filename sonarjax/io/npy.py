"""NumPy arrays from NPY bytes and NPZ members, without pickle and without trusting their headers.

An NPY header says how much to allocate, and a zip member may unpack to a thousand times its size. So the header is read
first, and nothing is unpacked that has more than `PIXEL_LIMIT` numbers, or more bytes than its header announces.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from dataclasses import dataclass

import numpy as np
from numpy.lib import format

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason

PIXEL_LIMIT = 64 * 2**20
"""Most pixels that a PNG, NPY or NPZ may have (64 Mi); a full Oculus ping has 0.2 Mi."""
HEADER_LIMIT = 4096
"""Longest NPY header that is read [bytes]; NumPy itself writes 128."""


@dataclass(frozen=True)
class NpyHeader:
    """What an NPY header says, after checks: a plain number type, and a size within the limit."""

    dtype: np.dtype
    """Type of the numbers: bool, integer or float."""
    shape: tuple[int, ...]
    """Shape of the array."""
    fortran: bool
    """True if the first axis runs fastest."""
    offset: int
    """Where the numbers start [bytes]."""

    @property
    def n_bytes(self) -> int:
        """Size of the numbers [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize


def npy_header(data: bytes, name: str, field: str = "array") -> NpyHeader:
    """Read and check the header at the start of `data`, with NumPy's own reader.

    Raises:
        SonarjaxError: The magic number is wrong; NumPy refuses the header, or it is longer than `HEADER_LIMIT`; the
            type is not bool, integer or float; or there are more than `PIXEL_LIMIT` numbers.
    """
    file = io.BytesIO(data[: HEADER_LIMIT + 12])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns if it has to guess
            # Version 3 is only for structured types, which are not pictures.
            read = {(1, 0): format.read_array_header_1_0, (2, 0): format.read_array_header_2_0}[format.read_magic(file)]
            shape, fortran, dtype = read(file, max_header_size=HEADER_LIMIT)
    except Exception as error:  # a hostile header can raise nearly anything, MemoryError and RecursionError included
        why = "version 1 or 2" if isinstance(error, KeyError) else _short_text(reason(error))
        raise SonarjaxError(f"{name}: {field}: expected NPY data with its header: {why}") from error
    if dtype.subdtype is not None or dtype.names is not None or dtype.kind not in "biuf":
        raise SonarjaxError(f"{name}: {field}: dtype: expected bool, integer or float, got {_short_text(str(dtype))}")
    if min(shape, default=0) < 0 or math.prod(shape) > PIXEL_LIMIT:
        got = _short_text(str(shape))
        raise SonarjaxError(f"{name}: {field}: shape {got}: expected at most {PIXEL_LIMIT} numbers, no length below 0")
    return NpyHeader(dtype, shape, fortran, file.tell())


def _short_text(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def parse_npy(data: bytes, name: str, field: str = "array") -> np.ndarray:
    """The array (any shape) in NPY bytes, read-only and without a copy.

    Raises:
        SonarjaxError: As `npy_header`, or the file ends before the last number, or goes on after it.
    """
    header = npy_header(data, name, field)
    there = len(data) - header.offset
    if there < header.n_bytes:
        raise SonarjaxError(f"{name}: {field}: truncated: expected {header.n_bytes} bytes of numbers, got {there}")
    if there > header.n_bytes:  # such as a second array, which would be lost without a word
        raise SonarjaxError(f"{name}: {field}: expected one array, {header.n_bytes} bytes of numbers, got {there}")
    flat = np.frombuffer(data, header.dtype, math.prod(header.shape), header.offset)
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


class NpzArchive:
    """The arrays of an NPZ, each read only on request and within the limits of this module."""

    def __init__(self, data: bytes, name: str) -> None:
        """Open the archive. Raises SonarjaxError if `data` is not a zip file."""
        self.name = name
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
            members = self._zip.infolist()
        except Exception as error:  # zipfile raises many types on corrupt directories
            raise SonarjaxError(f"{name}: expected a complete NPZ (zip) file: {reason(error)}") from error
        self._members = {info.filename.removesuffix(".npy"): info for info in members}

    @property
    def keys(self) -> list[str]:
        """Names of the arrays, in the order of the file."""
        return list(self._members)

    def header(self, key: str) -> NpyHeader:
        """Type and shape of one array. Raises SonarjaxError if it is absent, unreadable or over the limit."""
        return npy_header(self._read(key, 0)[0], self.name, key)

    def array(self, key: str) -> np.ndarray:
        """One array. Raises SonarjaxError as `header` does, and if some of its numbers are missing."""
        header = self.header(key)
        content, more = self._read(key, header.offset + header.n_bytes)
        if more:
            raise SonarjaxError(f"{self.name}: {key}: expected {header.n_bytes} bytes of numbers, got more")
        return parse_npy(content, self.name, key)

    def _read(self, key: str, size: int) -> tuple[bytes, bool]:
        """The first `size` bytes of a member (for 0, enough for a header), and whether more follow."""
        if key not in self._members:
            found = ", ".join(self.keys[:8]) or "nothing"
            raise SonarjaxError(f"{self.name}: {key}: expected an array of this name, found {_short_text(repr(found))}")
        info = self._members[key]
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise SonarjaxError(f"{self.name}: {key}: expected a stored or deflated member without a password")
        try:
            with self._zip.open(info) as member:
                if size == 0:
                    return member.read(HEADER_LIMIT + 12), False
                # Reading one byte past the end makes zipfile verify the checksum.
                return member.read(size), bool(member.read(1))
        except Exception as error:
            raise SonarjaxError(f"{self.name}: {key}: cannot be unpacked: {reason(error)}") from error
