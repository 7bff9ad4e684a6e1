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
    """How well a sonar's geometry is known: standard deviations, as a calibration gives them; 0 where none is stated.

    `range_scale`, `azimuth_scale`, `beam_bend` and `beam_skew` are those of `sonarjax.calibrate.PARAMETERS`.
    """

    tilt: Scalar = 0.0
    """Of the tilt [rad]."""
    roll: Scalar = 0.0
    """Of the roll [rad]."""
    height: Scalar = 0.0
    """Of the height [m]."""
    elevation_aperture: Scalar = 0.0
    """Of the vertical aperture [rad]."""
    range_offset: Scalar = 0.0
    """Of an offset of all ranges [m]."""
    range_scale: Scalar = 0.0
    """Of a factor on all ranges [1]."""
    azimuth_scale: Scalar = 0.0
    """Of a factor on all beam angles [1]."""
    beam_bend: Scalar = 0.0
    """Of an unevenness of the beam angles, the same on both sides [1]."""
    beam_skew: Scalar = 0.0
    """Of one that is not [1]."""


@record
class Sonar:
    """An imaging sonar at (0, 0, height), tilted down by `tilt`; a pytree, differentiable in every float.

    Images have shape (range, beam): rows from near to far, columns in ascending azimuth (column 0 is starboard-most).
    """

    azimuth: Float[Array, "*batch beam"]
    """Beam centres in ascending order, growing to port [rad]; need not be evenly spaced."""
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
    """Length of a pulse in range, c·t/2 [m]; never counted shorter than one range bin."""
    beam_width: Scalar = 0.0
    """Azimuth width of one beam at -3 dB [rad]; 0 means its spacing."""
    spreading_exponent: Scalar = 2.0
    """n in intensity ∝ 1/rⁿ; 2 is eq. 2 of the paper."""
    absorption: Scalar = 0.0
    """One-way absorption [dB/m]; 0 as in eq. 2."""
    lambert: Scalar = 0.0
    """Exponent of cos(incidence) in the echo's strength; 0 as in eq. 2, 1 or 2 for Lambert's law."""
    floor: FloorPatch | None = None
    """A platform instead of an endless floor."""
    geometry_std: GeometryStd | None = None
    """How well the geometry is known, where that is stated; rendering does not look at it."""
    n_ranges: int = field(default=512, metadata={"static": True})
    """Number of range bins."""
    highlight_max_incidence: float = field(default=90.0, metadata={"static": True})
    """Facets struck at a larger angle from their normal give no highlight [deg]; 90 switches this off. Static."""

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Sonar:
        """A device by name (see `sonarjax.sonar.PRESETS`), fields replaced by `overrides` (metres and radians).

        Raises SonarjaxError for an unknown name or field.

        >>> Sonar.preset("didson-hf", n_ranges=256).shape
        (256, 96)
        """
        from sonarjax.sonar.presets import preset

        return preset(name, **overrides)

    @classmethod
    def from_toml(cls, path: str | Path) -> Sonar:
        """Read `sonar.toml` (angles in degrees where the key says `_deg`).

        Raises SonarjaxError naming the file and the key for unknown keys, missing keys and impossible values.
        """
        from sonarjax.sonar.toml import read_sonar

        return read_sonar(path)

    def to_toml(self, path: str | Path) -> None:
        """Write a `sonar.toml` that `from_toml` reads back to the same sonar."""
        from sonarjax.sonar.toml import write_sonar

        write_sonar(self, path)

    def replace(self, **changes: Any) -> Sonar:
        """A copy with some fields changed (metres and radians)."""
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
        """Range bin edges (edge,), one more than bins [m]."""
        return self.range_min + self.range_bin * jnp.arange(self.n_ranges + 1, dtype=jnp.float32)

    @property
    def azimuth_edges(self) -> Float[Array, "edge"]:
        """Beam edges (edge,), one more than beams [rad]: midway between centres, the outer two as far out as theirs."""
        centers = jnp.asarray(self.azimuth)
        if centers.shape[-1] == 1:
            half = jnp.maximum(jnp.asarray(self.beam_width, jnp.float32), 1e-4) / 2
            return jnp.concatenate([centers - half, centers + half])
        middle = (centers[1:] + centers[:-1]) / 2
        return jnp.concatenate([2 * centers[:1] - middle[:1], middle, 2 * centers[-1:] - middle[-1:]])
