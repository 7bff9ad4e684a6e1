"""`Header`: bounds-checked little-endian fields of a binary file, so that a short or hostile file gives one
clear error.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content

Fields = dict[str, tuple[int, str]]
"""Field name -> (offset [bytes], struct code)."""


@dataclass(frozen=True)
class Header:
    """A view of `data` that starts at byte `base`; `name` and `part` (such as "frame 3") begin every message."""

    data: Content
    """Content of the file."""
    name: str
    """The file's path, for messages."""
    base: int = 0
    """Where this header starts in the file [bytes]."""
    part: str = "file header"
    """The part of the file to which the header belongs, for messages."""

    def error(self, field: str, problem: str) -> SonarjaxError:
        """The error to raise about one field."""
        return SonarjaxError(f"{self.name}: {self.part}: {field}: {problem}")

    def unpack(self, layout: str, offset: int, field: str) -> tuple:
        """Fields of the struct `layout` (little-endian) at `offset` [bytes]. Raises SonarjaxError if the file
        ends before.
        """
        start, size = self.base + offset, struct.calcsize("<" + layout)
        if start + size > len(self.data):
            raise self.error(field, f"truncated: expected {start + size} bytes or more, the file has {len(self.data)}")
        return struct.unpack("<" + layout, self.data[start : start + size])

    def fields(self, table: Fields, size: int) -> dict[str, Any]:
        """Every field of `table` in a header of `size` bytes. Raises SonarjaxError if the file ends inside it."""
        if self.base + size > len(self.data):
            raise self.error("header", f"truncated: expected {self.base + size} bytes, the file has {len(self.data)}")
        held = self.data[self.base : self.base + size]
        return {name: struct.unpack_from("<" + code, held, offset)[0] for name, (offset, code) in table.items()}

    def count(self, value: int, field: str, largest: int) -> int:
        """Return `value` if it is between 1 and `largest`, else raise SonarjaxError."""
        if not 1 <= value <= largest:
            raise self.error(field, f"expected 1 to {largest}, got {value}")
        return value

    def quantity(self, value: float, field: str, low: float, high: float, unit: str) -> float:
        """Return `value` if it is finite and between `low` and `high`, else raise SonarjaxError."""
        if not (math.isfinite(value) and low <= value <= high):
            raise self.error(field, f"expected {low:g} to {high:g} {unit}, got {value:g}")
        return value

    def pixels(self, offset: int, n_ranges: int, n_beams: int, dtype: str = "<u1") -> Float32[np.ndarray, "range beam"]:
        """Samples stored range by range (range, beam), as float32 in [0, 1], divided by the integer type's maximum.

        Raises:
            SonarjaxError: The file ends before the last sample. Nothing is allocated before this check.
        """
        stored, start = np.dtype(dtype), self.base + offset
        end = start + n_ranges * n_beams * stored.itemsize
        if end > len(self.data):
            raise self.error(
                "samples",
                f"truncated: expected {end} bytes for {n_ranges} x {n_beams} samples, the file has {len(self.data)}",
            )
        samples = np.frombuffer(self.data[start:end], stored).reshape(n_ranges, n_beams)
        return samples.astype(np.float32) / np.float32(np.iinfo(stored).max)


RANGE_LIMIT_M = 1000.0
"""No imaging sonar reaches farther [m]; a header that says so is corrupt."""
TIME_LIMIT_NS = 2**31 * 10**9
"""Times since 1970 stay below this [ns], in the year 2038: ROS messages hold no more seconds."""


def time_stamp(time_ns: int) -> dict[str, int]:
    """`time_ns` [ns since 1970] of a header; empty if the device wrote none or an impossible one."""
    return {"time_ns": time_ns} if 0 < time_ns < TIME_LIMIT_NS else {}


def angles(tilt: float, roll: float) -> dict[str, float]:
    """`tilt_deg` and `roll_deg` [deg] of a header; a key is left out if the device wrote NaN or an impossible angle."""
    found = {"tilt_deg": tilt, "roll_deg": roll}
    return {key: value + 0.0 for key, value in found.items() if math.isfinite(value) and abs(value) <= 360.0}
