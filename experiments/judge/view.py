"""What the ray caster must know of a sonar: plain NumPy, in the *true* geometry (a recognizer gets the nominal one).

Each beam is cut into sub-beams, each range bin into range samples; a few beams more are kept on either side, as the
pattern of the outer beams reaches there. A ray is named by its sub-beam and by u, the sine of its depression below the
horizontal: where it meets the floor, its range is height / u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonarjax.sonar import Sonar

SUB_BEAMS = 4
"""Sub-beams in a beam: sin(u)/u varies with under half a cycle a beam, so four samples hold all of it."""
MARGIN_BEAMS = 3
"""Beams kept outside the field of view on either side: beyond lies at most 3 % of the outermost beam's power."""
SAMPLES = 3
"""Range samples, and floor rays, in a range bin: spacing on the floor is a third of a bin."""


@dataclass(frozen=True)
class View:
    """A sonar at (0, 0, height) [m] above the floor z = 0, x forward, y to port, tilted down."""

    edges: np.ndarray
    """Beam edges (beam + 1,), ascending to port [rad]."""
    range_min: float
    """Near edge of the first range bin [m]."""
    range_bin: float
    """Length of one range bin [m]."""
    n_ranges: int
    """Number of range bins."""
    aperture: float
    """Full vertical width of the beam, where it is flat [rad]."""
    tilt: float
    """Beam axis below the horizontal [rad]."""
    height: float
    """Sonar above the floor [m]."""
    frequency: float
    """Acoustic frequency [Hz]."""
    conical: bool = False
    """True: a sub-beam is a cone about the array (what a line array measures); False: a half-plane of one azimuth."""

    @classmethod
    def of(
        cls, sonar: Sonar, tilt: float, height: float, sound_speed_ratio: float = 1.0, conical: bool = False
    ) -> View:
        """The view of `sonar` as it truly hangs: `tilt` [rad], `height` [m].

        `sound_speed_ratio` is the true speed of sound over the assumed one: the device divides time by the wrong speed,
        so the window that it calls 1.5–4 m truly lies at that times the ratio.
        """
        centers = np.asarray(sonar.azimuth, np.float64)
        middle = (centers[1:] + centers[:-1]) / 2
        edges = np.concatenate([[2 * centers[0] - middle[0]], middle, [2 * centers[-1] - middle[-1]]])
        near, far = (float(r) * sound_speed_ratio for r in (sonar.range_min, sonar.range_max))
        return cls(
            edges=edges,
            range_min=near,
            range_bin=(far - near) / sonar.n_ranges,
            n_ranges=sonar.n_ranges,
            aperture=float(sonar.elevation_aperture),
            tilt=tilt,
            height=height,
            frequency=float(sonar.frequency),
            conical=conical,
        )

    @property
    def n_beams(self) -> int:
        """Number of beams."""
        return len(self.edges) - 1

    @property
    def centers(self) -> np.ndarray:
        """Beam centres (beam,) [rad]."""
        return (self.edges[1:] + self.edges[:-1]) / 2

    @property
    def sub_azimuth(self) -> np.ndarray:
        """Azimuth of each sub-beam's middle, margins included (sub,) [rad]."""
        edges = self._sub_edges()
        return (edges[1:] + edges[:-1]) / 2

    @property
    def sub_width(self) -> np.ndarray:
        """Width of each sub-beam (sub,) [rad]."""
        return np.diff(self._sub_edges())

    @property
    def inner(self) -> slice:
        """The sub-beams that lie inside the field of view."""
        return slice(MARGIN_BEAMS * SUB_BEAMS, (MARGIN_BEAMS + self.n_beams) * SUB_BEAMS)

    @property
    def sample_ranges(self) -> np.ndarray:
        """Slant ranges of the range samples (sample,), `SAMPLES` in each bin, near to far [m]."""
        return self.range_min + (np.arange(self.n_ranges * SAMPLES) + 0.5) * (self.range_bin / SAMPLES)

    @property
    def ranges(self) -> np.ndarray:
        """Slant ranges of the bins' middles (range,) [m]."""
        return self.range_min + (np.arange(self.n_ranges) + 0.5) * self.range_bin

    def elevation(self, sine: np.ndarray) -> np.ndarray:
        """Elevation of the rays above the beam axis (u, sub) [rad], for sines of depression `sine` (u,).

        A ray's downward part is sin(tilt) cos(azimuth) cos(elevation) − cos(tilt) sin(elevation); solved for elevation.
        """
        offset, reach = (values.astype(np.float32) for values in self._solution())
        return offset - np.arcsin(np.clip(sine.astype(np.float32)[:, None] / reach, -1, 1))

    def directions(self, elevation: np.ndarray, columns: slice) -> np.ndarray:
        """Unit vectors (u, sub, 3) in the ground frame of rays at `elevation` (u, sub) [rad] in sub-beams `columns`."""
        azimuth = self.sub_azimuth[columns]
        c, s = np.cos(elevation), np.sin(elevation)
        if self.conical:
            x, y, z = c * np.cos(azimuth), np.broadcast_to(np.sin(azimuth), c.shape), s * np.cos(azimuth)
        else:
            x, y, z = c * np.cos(azimuth), c * np.sin(azimuth), s
        down, level = np.sin(self.tilt), np.cos(self.tilt)
        return np.stack([x * level + z * down, y, z * level - x * down], axis=-1)

    def solid_angle(self, sine: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Solid angle of each ray (u, sub) [sr], for rays evenly filling what lies between neighbouring `sine`s."""
        reach = self._solution()[1].astype(np.float32)
        step = np.abs(np.gradient(sine)).astype(np.float32)[:, None]
        turn = np.sqrt(np.maximum(reach**2 - sine.astype(np.float32)[:, None] ** 2, 1e-6))  # d sine / d elevation
        shrink = np.cos(self.sub_azimuth.astype(np.float32)) if self.conical else np.cos(elevation)
        return step / turn * self.sub_width.astype(np.float32) * shrink

    def _solution(self) -> tuple[np.ndarray, np.ndarray]:
        """Offset [rad] and reach [1] (sub,) each: u = reach · sin(offset − elevation)."""
        cosine = np.cos(self.sub_azimuth)
        if self.conical:
            return np.full_like(cosine, self.tilt), cosine
        down, level = cosine * np.sin(self.tilt), np.cos(self.tilt)
        return np.arctan2(down, level), np.hypot(down, level)

    def _sub_edges(self) -> np.ndarray:
        first, last = self.edges[1] - self.edges[0], self.edges[-1] - self.edges[-2]
        more = np.arange(1, MARGIN_BEAMS + 1)
        wide = np.concatenate([self.edges[0] - first * more[::-1], self.edges, self.edges[-1] + last * more])
        at = np.arange((len(wide) - 1) * SUB_BEAMS + 1) / SUB_BEAMS
        return np.interp(at, np.arange(len(wide)), wide)
