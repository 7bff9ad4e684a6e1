"""`Frame`: one sonar image as arrays and a dict, whatever file it came from.

Every loader of this folder returns frames in the package's convention: axis 0 is the range bin, near to far, axis 1 the
beam in ascending azimuth (column 0 is the starboard-most beam), values float32 in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

Geometry = dict[str, Any]
UNEVEN = 0.02
"""Largest deviation of a range bin from even spacing [bins]; float32 rounding is smaller."""


def evenly_spaced(ranges: Any) -> bool:
    """True if ascending ranges (range,) [m], edges or centres of range bins, are equally far apart."""
    steps = len(ranges) - 1
    off = np.abs(ranges - np.linspace(ranges[0], ranges[-1], steps + 1)).max()
    return bool(off <= UNEVEN * (ranges[-1] - ranges[0]) / steps)


@dataclass(frozen=True, eq=False)
class Frame:
    """One sonar frame of shape (range, beam)."""

    image: Float32[np.ndarray, "range beam"]
    """Grey values in [0, 1], shape (range, beam)."""
    mask: Bool[np.ndarray, "range beam"] | None
    """True where the pixel was measured, shape (range, beam); None means everywhere."""
    source: str
    """The name that reads this frame again: `path`; `path:N` for a file of several frames; `path:TOPIC:N` for a bag."""
    stem: str
    """Stem for the names of output files: that of the file, with `_N` for a file of several frames, and with the topic
    and `_N` for a bag.
    """
    geometry: Geometry | None = None
    """What the file says of the sonar, under the keys of `sonar.toml` ([m], [m/s], [Hz], `_deg`: [deg]).

    A key is absent if the file does not give it; None means that there is no geometry at all. Possible keys:
    azimuth_deg (ascending list), range_min_m, range_max_m, n_ranges, tilt_deg (positive down), roll_deg,
    sound_speed_m_s, frequency_hz, elevation_aperture_deg.
    """
    meta: dict[str, Any] = field(default_factory=dict)
    """What else the header says: `format`, `frame_index`, `n_frames`, `stored_scale` and fields of the format.

    `time_ns` is when the frame was taken [ns since 1970], where an ARIS, a DIDSON or a bag says so.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (range, beam) of the image."""
        return int(self.image.shape[0]), int(self.image.shape[1])
