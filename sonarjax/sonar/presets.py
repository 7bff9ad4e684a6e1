"""Imaging sonars by name: `Sonar.preset("didson-hf", tilt=0.35)` uses them, `PRESETS` lists the devices.

A name stands for a device: beams, aperture and frequency. All presets are mounted in the paper's tank (Table 1 and
§4.1): tilt 15°, 0.9 m above the floor, window 1.5–4.0 m in 512 bins. Where a recording's own header or a `sonar.toml`
gives beam angles, prefer them to the idealised ones here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from sonarjax.io.aris_beams import ARIS_1200, ARIS_1800, ARIS_3000, aris_azimuth_deg
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.fan_geometry import even_beams
from sonarjax.sonar.check import check_azimuth, check_count
from sonarjax.sonar.parts import field_of_view_deg

TILT = math.radians(15.0)
"""Tilt of every preset, the shallowest of Table 1 [rad]."""
HEIGHT_M = 0.9
"""Height of every preset above the floor (Table 1) [m]."""
WINDOW_M = (1.5, 4.0)
"""Near and far end of every preset's window (§4.1) [m]."""


def array_beams(n_beams: int, half_view: float) -> Float64[np.ndarray, "beam"]:
    """Centres (beam,) [deg] of beams of equal width in sin(azimuth), as of a flat array, out to ±`half_view` [deg]."""
    return np.degrees(np.arcsin(even_beams(n_beams, 2 * math.sin(math.radians(half_view)))))


@dataclass(frozen=True)
class Device:
    """What the name of a preset stands for."""

    azimuth_deg: Float64[np.ndarray, "beam"]
    """Beam centres (beam,) in ascending order [deg]."""
    frequency: float
    """Acoustic frequency [Hz]."""
    aperture_deg: float = 14.0
    """Full vertical width of the beam [deg]."""

    def fields(self) -> dict[str, Any]:
        """Fields of a `Sonar`: the device in the paper's tank."""
        return {
            "azimuth": azimuth_from_deg(self.azimuth_deg),
            "range_min": WINDOW_M[0],
            "range_max": WINDOW_M[1],
            "elevation_aperture": math.radians(self.aperture_deg),
            "tilt": TILT,
            "height": HEIGHT_M,
            "frequency": self.frequency,
        }


def _aris(system: int, n_beams: int, frequency: float) -> Device:
    azimuth_deg = aris_azimuth_deg(system, n_beams, large_lens=False)
    assert azimuth_deg is not None  # the three tables below exist
    return Device(azimuth_deg, frequency)


PRESETS: dict[str, Device] = {
    # Table 2: 0.3° and 0.6° are the beams of a 29° field of view, rounded (29/96 = 0.302, 29/48 = 0.604).
    "didson-hf": Device(even_beams(96, 29.0), 1.8e6),
    "didson-lf": Device(even_beams(48, 29.0), 1.1e6),
    # Uneven tables behind the standard lens: `sonarjax.io.aris_beams` documents the formula and its error.
    "aris-1200": _aris(ARIS_1200, 48, 1.2e6),
    "aris-1800": _aris(ARIS_1800, 96, 1.8e6),
    "aris-3000": _aris(ARIS_3000, 128, 3.0e6),
    # Assumption: the high-frequency mode of an Oculus M1200d taken as a flat array, 256 beams equal in sin(azimuth)
    # with outer edges at ±30°, and a vertical aperture of 12°. A recording's header gives its own beam angles.
    "oculus": Device(array_beams(256, 30.0), 2.1e6, aperture_deg=12.0),
}
"""The devices by name."""


def azimuth_from_deg(degrees: Any) -> Float[Array, "beam"]:
    """Beam centres (beam,) [rad] as float32 from degrees; converted in float64."""
    return jax.device_put(np.radians(np.asarray(degrees, np.float64)).astype(np.float32))


def preset_fields(name: str, overrides: Mapping[str, Any], known: Sequence[str]) -> dict[str, Any]:
    """Fields of a `Sonar` for the device `name` of `PRESETS`, with some replaced (metres and radians).

    Args:
        name: Name of the device.
        overrides: Values by field.
        known: Names of all fields of a `Sonar`.

    Raises:
        SonarjaxError: The name or a field is unknown (the message lists the known ones), or the number of ranges or the
            azimuths are impossible. Other values are left to `check_sonar`.
    """
    if not isinstance(name, str) or name not in PRESETS:
        raise SonarjaxError(f"unknown sonar preset {name!r}, expected one of: {', '.join(PRESETS)}")
    unknown = [field for field in overrides if field not in known]
    if unknown:
        raise SonarjaxError(f"preset {name}: unknown field {', '.join(unknown)}, expected one of: {', '.join(known)}")
    # Unlike the other fields these two are not plain floats, so they are checked before a `Sonar` is made of them.
    if "n_ranges" in overrides:
        check_count(overrides["n_ranges"], f"preset {name}")
    values = PRESETS[name].fields() | dict(overrides)
    if "azimuth" in overrides:
        values["azimuth"] = _as_azimuth(overrides["azimuth"], f"preset {name}")
        if values["azimuth"].size == 1:
            values.setdefault("beam_width", math.radians(field_of_view_deg(PRESETS[name].fields()["azimuth"])))
    return values


def _as_azimuth(value: Any, source: str) -> Float[Array, "beam"]:
    if isinstance(value, jax.core.Tracer):
        return jnp.asarray(value)
    check_azimuth(value, source)
    return jnp.asarray(np.asarray(value, np.float64), jnp.float32)
