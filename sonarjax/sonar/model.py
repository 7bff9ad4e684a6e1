"""The `Sonar` pytree: what looks at the scene, and how its image is laid out (Table 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.toml import read_toml
from sonarjax.records import record
from sonarjax.sonar.check import check_sonar
from sonarjax.sonar.parts import FloorPatch, GeometryStd, Scalar, beam_edges
from sonarjax.sonar.presets import preset_fields
from sonarjax.sonar.toml import KEYS, check_beams, table_fields, write_sonar


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
    """Speed of sound in water [m/s]. Rendering does not use it: ranges are in metres already."""
    pulse_length: Scalar = 0.0
    """Length of a pulse in range, c·t/2 [m]; at least one range bin is used."""
    beam_width: Scalar = 0.0
    """Width in azimuth of one beam at −3 dB [rad]; 0 means the beam spacing. A single beam needs a width."""
    spreading_exponent: Scalar = 2.0
    """n in intensity ∝ 1/rⁿ; 2 is eq. 2 of the paper."""
    absorption: Scalar = 0.0
    """One-way absorption [dB/m]; 0 as in eq. 2."""
    lambert: Scalar = 0.0
    """Exponent of cos(incidence) in the strength of an echo; 0 as in eq. 2, 1 for Lambert's law."""
    highlight_max_incidence: Scalar = 90.0
    """Largest angle of incidence, from a facet's normal, that still gives highlight [deg]; 90 for any.

    Echoes in templates fade out around it; `intensity` does not depend on it.
    """
    floor: FloorPatch | None = None
    """A platform instead of an endless floor; None for the endless floor."""
    geometry_std: GeometryStd | None = None
    """How well the geometry is known, if that is stated. Rendering does not use it."""
    n_ranges: int = field(default=512, metadata={"static": True})
    """Number of range bins."""

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> Sonar:
        """Make a device by name, with some fields replaced.

        Args:
            name: A name in `sonarjax.sonar.PRESETS`.
            **overrides: Values for fields of `Sonar`, in the units of the fields (lengths [m], angles [rad], but
                `highlight_max_incidence` [deg]). A single beam without a `beam_width` is as wide as the device's field
                of view.

        Returns:
            The sonar.

        Raises:
            SonarjaxError: The name or a field is unknown, or a value is impossible.

        >>> Sonar.preset("didson-hf", n_ranges=256).shape
        (256, 96)
        """
        values = preset_fields(name, overrides, [one.name for one in fields(cls)])
        return check_sonar(cls(**values), f"preset {name}")

    @classmethod
    def from_toml(cls, path: str | Path) -> Sonar:
        """Read a `sonar.toml`, in which angles are in degrees where the key says `_deg`.

        Args:
            path: The file.

        Returns:
            The sonar, as `sonar_from_dict` makes it.

        Raises:
            SonarjaxError: The file cannot be read, a key is unknown or missing, or a value is impossible. The message
                names the file and the key.
        """
        return sonar_from_dict(read_toml(path), str(path))

    def to_toml(self, path: str | Path) -> None:
        """Write a `sonar.toml` that `from_toml` reads back as the same sonar, but for the last digit of some angles.

        Args:
            path: The file to write.

        Raises:
            SonarjaxError: A value is impossible, traced or batched, or the file cannot be written.
        """
        write_sonar(self, path)

    def replace(self, **changes: Any) -> Sonar:
        """Return a copy with some fields replaced.

        Args:
            **changes: New values, in the units of the fields (lengths [m], angles [rad], but
                `highlight_max_incidence` [deg]); they are not checked.

        Returns:
            The copy.

        Raises:
            SonarjaxError: There is no such field.
        """
        known = [one.name for one in fields(self)]
        unknown = [name for name in changes if name not in known]
        if unknown:
            raise SonarjaxError(f"sonar: unknown field {', '.join(unknown)}, expected one of: {', '.join(known)}")
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
    def range_edges(self) -> Float[Array, "*batch edge"]:
        """Edges (edge,) of the range bins [m], after the batch axes: one more than there are bins."""
        near, step = (jnp.asarray(v)[..., None] if np.ndim(v) else v for v in (self.range_min, self.range_bin))
        return near + step * jnp.arange(self.n_ranges + 1, dtype=jnp.float32)

    @property
    def azimuth_edges(self) -> Float[Array, "*batch edge"]:
        """Edges (edge,) of the beams [rad], after the batch axes: one more than there are beams.

        Inner edges lie midway between beam centres. An outer edge is as far from its centre as that beam's inner edge.
        """
        return beam_edges(self.azimuth, self.beam_width)


def range_edges_of(sonar: Sonar) -> Float[np.ndarray, "range_edge"]:
    """Compute the edges of the range bins on the host, in float64: what files and pictures take.

    Args:
        sonar: The sonar, not traced.

    Returns:
        Edges (range_edge,) [m], near to far.
    """
    return np.linspace(float(sonar.range_min), float(sonar.range_max), sonar.n_ranges + 1)


def sonar_from_dict(table: Mapping[str, Any], source: str) -> Sonar:
    """Make a sonar from a parsed `sonar.toml`.

    If `n_beams` or `field_of_view_deg` differs from the preset's, the beams are evenly spaced; if only one of the two
    is given, the other is the preset's. A single beam without a `beam_width_deg` is as wide as the field of view.

    Args:
        table: Keys and values of the file.
        source: Name of the file in error messages.

    Returns:
        The sonar. Its azimuth is float32 (beam,) [rad]; other fields are Python floats [m, rad], but
        `highlight_max_incidence` [deg].

    Raises:
        SonarjaxError: A key is unknown or missing, a type is wrong, a value is impossible, or the beams do not agree.
    """
    sonar = check_sonar(Sonar(**table_fields(table, source)), source, KEYS)
    check_beams(table, sonar.azimuth, source)
    return sonar
