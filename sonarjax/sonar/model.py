"""The `Sonar` pytree: what looks at the scene, and how its image is laid out (Table 2)."""

from __future__ import annotations

from dataclasses import field, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.records import record

Scalar = Any


@record
class FloorPatch:
    """A rectangular platform at z = 0 instead of an endless floor; lengths [m], angles [rad] in the ground frame."""

    x: Scalar
    """Forward position of its centre [m]."""
    y: Scalar
    """Position to port of its centre [m]."""
    length: Scalar
    """Side along its own x axis [m]."""
    width: Scalar
    """Side along its own y axis [m]."""
    yaw: Scalar = 0.0
    """Rotation about the vertical [rad]."""


@record
class GeometryStd:
    """How well a sonar's geometry is known: standard deviations, for example from a calibration; 0 where none is
    stated.
    `range_scale`, `azimuth_scale`, `beam_bend` and `beam_skew` are the parameters of that name in
    `sonarjax.calibrate.PARAMETERS`.
    """

    tilt: Scalar = 0.0
    """Standard deviation of the tilt [rad]."""
    roll: Scalar = 0.0
    """Standard deviation of the roll [rad]."""
    height: Scalar = 0.0
    """Standard deviation of the height [m]."""
    elevation_aperture: Scalar = 0.0
    """Standard deviation of the vertical aperture [rad]."""
    range_offset: Scalar = 0.0
    """Standard deviation of an offset of all ranges [m]."""
    range_scale: Scalar = 0.0
    """Standard deviation of a factor on all ranges [1]."""
    azimuth_scale: Scalar = 0.0
    """Standard deviation of a factor on all beam angles [1]."""
    beam_bend: Scalar = 0.0
    """Standard deviation of uneven beam spacing that is symmetric about the axis [1]."""
    beam_skew: Scalar = 0.0
    """Standard deviation of uneven beam spacing that differs from port to starboard [1]."""


@record
class Sonar:
    """An imaging sonar at (0, 0, height), tilted down by `tilt`; a pytree, differentiable in every float.

    Its images have shape (range, beam): rows from near to far, columns in ascending azimuth (column 0 is
    starboard-most).
    """

    azimuth: Float[Array, "*batch beam"]
    """Beam centres in ascending order, growing to port [rad]; they may be unevenly spaced."""
    range_min: Scalar
    """Near edge of the first range bin [m]."""
    range_max: Scalar
    """Far edge of the last range bin [m]."""
    elevation_aperture: Scalar
    """Full vertical width of the beam [rad]; nothing outside it is insonified."""
    tilt: Scalar
    """Angle of the beam axis below the horizontal [rad]."""
    height: Scalar
    """Height of the sonar above the floor [m]."""
    roll: Scalar = 0.0
    """Rotation about the beam axis, port side up [rad]."""
    frequency: Scalar = 1.8e6
    """Acoustic frequency [Hz]."""
    sound_speed: Scalar = 1480.0
    """Speed of sound in water [m/s]."""
    pulse_length: Scalar = 0.0
    """Length of a pulse in range, c·t/2 [m]; at least one range bin is used."""
    beam_width: Scalar = 0.0
    """Width in azimuth of one beam at −3 dB [rad]; 0 means the beam spacing."""
    spreading_exponent: Scalar = 2.0
    """n in intensity ∝ 1/rⁿ; 2 is eq. 2 of the paper."""
    absorption: Scalar = 0.0
    """One-way absorption [dB/m]; 0 as in eq. 2."""
    lambert: Scalar = 0.0
    """Exponent of cos(incidence) in the strength of an echo; 0 as in eq. 2, 1 or 2 for Lambert's law."""
    floor: FloorPatch | None = None
    """A platform instead of an endless floor; None for the endless floor."""
    geometry_std: GeometryStd | None = None
    """How well the geometry is known, if that is stated. Rendering does not use it."""
    n_ranges: int = field(default=512, metadata={"static": True})
    """Number of range bins."""
    highlight_max_incidence: float = field(default=90.0, metadata={"static": True})
    """Largest angle of incidence, from a facet's normal, that still gives highlight [deg]; 90 for any. Static."""

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Sonar:
        """Make a device by name, with some fields replaced.

        Args:
            name: A name in `sonarjax.sonar.PRESETS`.
            overrides: Values for fields of `Sonar`, in metres and radians.

        Raises:
            SonarjaxError: The name or a field is unknown, or a value is impossible.

        >>> Sonar.preset("didson-hf", n_ranges=256).shape
        (256, 96)
        """
        from sonarjax.sonar.presets import preset

        return preset(name, **overrides)

    @classmethod
    def from_toml(cls, path: str | Path) -> Sonar:
        """Read a `sonar.toml`, in which angles are in degrees where the key says `_deg`.

        Raises:
            SonarjaxError: A key is unknown or missing, or a value is impossible. The message names the file and the
                key.
        """
        from sonarjax.sonar.toml import read_sonar

        return read_sonar(path)

    def to_toml(self, path: str | Path) -> None:
        """Write a `sonar.toml` that `from_toml` reads back as the same sonar.

        Raises:
            SonarjaxError: A value is impossible, traced or batched, or the file cannot be written.
        """
        from sonarjax.sonar.toml import write_sonar

        write_sonar(self, path)

    def replace(self, **changes: Any) -> Sonar:
        """A copy with some fields replaced (metres and radians)."""
        return replace(self, **changes)

    @property
    def n_beams(self) -> int:
        """Number of beams."""
        return int(self.azimuth.shape[-1])

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (range, beam) of an image."""
        return self.n_ranges, self.n_beams

    @property
    def range_bin(self) -> Scalar:
        """Length of one range bin [m]."""
        return (self.range_max - self.range_min) / self.n_ranges

    @property
    def range_edges(self) -> Float[Array, "edge"]:
        """Edges (edge,) of the range bins [m]: one more than there are bins."""
        return self.range_min + self.range_bin * jnp.arange(self.n_ranges + 1, dtype=jnp.float32)

    @property
    def azimuth_edges(self) -> Float[Array, "edge"]:
        """Edges (edge,) of the beams [rad], one more than there are beams.

        Inner edges lie midway between beam centres. An outer edge is as far from its centre as that beam's inner edge.
        """
        centers = jnp.asarray(self.azimuth)
        if centers.shape[-1] == 1:
            half = jnp.maximum(jnp.asarray(self.beam_width, jnp.float32), 1e-4) / 2
            return jnp.concatenate([centers - half, centers + half])
        middle = (centers[1:] + centers[:-1]) / 2
        return jnp.concatenate([2 * centers[:1] - middle[:1], middle, 2 * centers[-1:] - middle[-1:]])
