"""The check that every sonar from a preset or a file must pass: finite numbers that a device can have.

Traced values (under jit, grad or vmap) are skipped, because their numbers are not known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind
from sonarjax.io.header import RANGE_LIMIT_M
from sonarjax.sonar.parts import FloorPatch, GeometryStd

MAX_RANGES = 100_000
"""More range bins than any device stores; a larger number is taken for a mistake."""
MAX_BEAMS = 10_000
"""More beams than any device forms; a larger number is taken for a mistake."""
MAX_PIXELS = 2**24
"""Most pixels of an image, beams times range bins: eight times the largest device. Rendering 10⁹ would exhaust
the memory.
"""
MIN_RANGE_BIN_M = 1e-6
"""Shortest range bin [m]; a wave of 3 MHz is 500 times as long."""
FLOOR_LIMIT_M = 1e5
"""Largest coordinate and side of a floor patch [m]; a patch beyond the farthest range is as good as endless."""
SMALLEST = float(np.finfo(np.float32).tiny)
"""Numbers smaller than this are 0 in the renderer's arithmetic."""

S = TypeVar("S")  # `Sonar`, which this file does not import: it would be a circle


class _Rule(NamedTuple):
    field: str
    holds: Callable[[np.ndarray], Any]
    expected: str
    most: float | None = None  # upper limit of the size, in the unit of `expected`; None where `holds` has one
    unit: str = ""
    degrees: bool = False  # the field is in radians; judged and reported in degrees


_RULES = (
    _Rule("range_min", lambda v: v >= 0, "0 m or more", RANGE_LIMIT_M, " m"),
    _Rule("range_max", lambda v: v > 0, "more than 0 m", RANGE_LIMIT_M, " m"),
    _Rule("elevation_aperture", lambda v: (v > 0) & (v < 180), "between 0° and 180°", degrees=True),
    _Rule("tilt", lambda v: abs(v) <= 90, "between -90° and 90°", degrees=True),
    _Rule("roll", lambda v: abs(v) <= 90, "between -90° and 90°", degrees=True),
    _Rule("height", lambda v: v > 0, "more than 0 m", RANGE_LIMIT_M, " m"),
    _Rule("frequency", lambda v: v > 0, "more than 0 Hz", 1e9, " Hz"),
    _Rule("sound_speed", lambda v: v > 0, "more than 0 m/s", 1e5, " m/s"),
    _Rule("pulse_length", lambda v: v >= 0, "0 m or more", RANGE_LIMIT_M, " m"),
    _Rule("beam_width", lambda v: (v >= 0) & (v < 180), "between 0° and 180°", degrees=True),
    _Rule("spreading_exponent", lambda v: v >= 0, "0 or more", 10.0),
    _Rule("absorption", lambda v: v >= 0, "0 dB/m or more", 1e3, " dB/m"),
    _Rule("lambert", lambda v: v >= 0, "0 or more", 100.0),
    _Rule("highlight_max_incidence", lambda v: (v > 0) & (v <= 90), "above 0°, up to 90°"),
)
_FLOOR_RULES = (
    _Rule("x", np.isfinite, "a finite number", FLOOR_LIMIT_M, " m"),
    _Rule("y", np.isfinite, "a finite number", FLOOR_LIMIT_M, " m"),
    _Rule("length", lambda v: v > 0, "more than 0 m", FLOOR_LIMIT_M, " m"),
    _Rule("width", lambda v: v > 0, "more than 0 m", FLOOR_LIMIT_M, " m"),
    _Rule("yaw", lambda v: abs(v) <= 360, "between -360° and 360°", degrees=True),
)
_STD_RULES = tuple(
    _Rule(name, lambda v: v >= 0, "0 or more", 1e3, degrees=name in ("tilt", "roll", "elevation_aperture"))
    for name in GeometryStd.__dataclass_fields__
)


def check_sonar(sonar: S, source: str, names: Mapping[str, str] | None = None) -> S:
    """Return `sonar` unchanged if every value is possible; `source` and `names` (field -> key) appear in messages.

    Traced values are not checked.

    Raises:
        SonarjaxError: A field has the wrong type, is NaN or infinite, or lies outside its limits; azimuths do not
            ascend; a single beam has no width; there are too many pixels; the range window ends before it starts, or
            has range bins too short for float32; or the aperture reaches past the nearest point of the floor, which is
            straight down without roll. The message names the first such field.
    """
    checked: Any = sonar
    names = names or {}
    for rule in _RULES:
        _check_number(getattr(checked, rule.field), rule, source, names.get(rule.field, rule.field))
    if checked.floor is not None:
        check_kind(checked.floor, FloorPatch, f"{source}: floor")
        for rule in _FLOOR_RULES:
            field = f"floor.{rule.field}"
            _check_number(getattr(checked.floor, rule.field), rule, source, names.get(field, field))
    if checked.geometry_std is not None:
        check_kind(checked.geometry_std, GeometryStd, f"{source}: geometry_std")
        for rule in _STD_RULES:
            field = f"geometry_std.{rule.field}"
            _check_number(getattr(checked.geometry_std, rule.field), rule, source, names.get(field, field))
    check_count(checked.n_ranges, source, names.get("n_ranges", "n_ranges"))
    check_azimuth(checked.azimuth, source, names.get("azimuth", "azimuth"))
    if checked.n_beams == 1 and not _traced(checked.beam_width) and not np.all(np.asarray(checked.beam_width) > 0):
        name = names.get("beam_width", "beam_width")
        raise SonarjaxError(f"{source}: {name} must be more than 0° where there is a single beam, got 0°")
    _check_pixels(checked, source)
    _check_window(checked, source, names)
    _check_nadir(checked, source, names)
    return sonar


def _traced(*values: Any) -> bool:
    return any(isinstance(value, jax.core.Tracer) for value in values)


def _check_number(value: Any, rule: _Rule, source: str, name: str) -> None:
    if _traced(value):
        return
    numbers = as_numbers(value)
    if numbers is None or numbers.size == 0:
        raise SonarjaxError(f"{source}: {name} must be a number, got {value!r}")
    shown = np.round(np.degrees(numbers), 4) if rule.degrees else numbers  # π/2 in float32 is 90.0000025°
    judged = np.where(np.abs(shown) < SMALLEST, 0.0, shown)
    values = f"{shown.tolist() if shown.ndim else f'{shown.item():g}'}{'°' if rule.degrees else ''}"
    if not (np.isfinite(numbers).all() and np.all(rule.holds(judged))):
        raise SonarjaxError(f"{source}: {name} must be {rule.expected}, got {values}")
    if rule.most is not None and (np.abs(shown) > rule.most).any():
        raise SonarjaxError(f"{source}: {name} must be at most {rule.most:g}{rule.unit}, got {values}")


def as_numbers(value: Any) -> np.ndarray | None:
    """The value as float64 of any shape, or None if it is not numeric (text, bool, ragged list, complex)."""
    try:
        array = np.asarray(value)
        return array.astype(np.float64) if array.dtype.kind in "iuf" else None
    except (TypeError, ValueError):
        return None


def check_count(count: Any, source: str, name: str = "n_ranges") -> None:
    """Raise a SonarjaxError unless `count` is a whole number of range bins that a device can have."""
    if isinstance(count, bool) or not isinstance(count, int | np.integer):
        raise SonarjaxError(f"{source}: {name} must be a whole number, got {count!r}")
    if not 1 <= count <= MAX_RANGES:
        raise SonarjaxError(f"{source}: {name} must be between 1 and {MAX_RANGES}, got {count}")


def check_azimuth(azimuth: Any, source: str, name: str = "azimuth") -> None:
    """Raise a SonarjaxError unless `azimuth` (beam,) [rad] is finite, within ±90° and strictly ascending, or traced."""
    if _traced(azimuth):
        return
    angles = as_numbers(azimuth)
    if angles is None or angles.ndim != 1 or not 1 <= angles.size <= MAX_BEAMS:
        raise SonarjaxError(f"{source}: {name} must be a list of 1 to {MAX_BEAMS} beam angles")
    if not np.isfinite(angles).all():
        raise SonarjaxError(f"{source}: {name} holds NaN or infinite values")
    if not (np.abs(angles) < np.pi / 2).all():
        worst = np.degrees(angles[np.argmax(np.abs(angles))])
        raise SonarjaxError(f"{source}: {name} must stay within ±90°, got {worst:g}°")
    wrong = np.flatnonzero(np.diff(angles) <= 0)
    if wrong.size:
        raise SonarjaxError(f"{source}: {name} must be strictly ascending, but beam {wrong[0] + 1} is not")


def _check_pixels(sonar: Any, source: str) -> None:
    beams, ranges = sonar.n_beams, int(sonar.n_ranges)
    if beams * ranges > MAX_PIXELS:
        raise SonarjaxError(
            f"{source}: n_ranges times n_beams must be at most {MAX_PIXELS}, got {ranges} x {beams} = {ranges * beams}"
        )


def _check_window(sonar: Any, source: str, names: Mapping[str, str]) -> None:
    if _traced(sonar.range_min, sonar.range_max):
        return
    near, far = np.asarray(sonar.range_min, np.float64), np.asarray(sonar.range_max, np.float64)
    first, last = (names.get(field, field) for field in ("range_min", "range_max"))
    if not np.all(near < far):
        raise SonarjaxError(f"{source}: {first} must be less than {last}, got {near} and {far}")
    # At least two steps of float32 keep the edges of a bin apart, whichever way they are rounded.
    shortest = np.maximum(MIN_RANGE_BIN_M, 2 * np.spacing(far.astype(np.float32)).astype(np.float64))
    bins = (far - near) / sonar.n_ranges
    if np.any(bins < shortest):
        raise SonarjaxError(
            f"{source}: {first} and {last} must lie farther apart, got {near} and {far}: "
            f"{sonar.n_ranges} range bins of {bins.min():.2g} m, expected at least {shortest.max():.2g} m each"
        )


def _check_nadir(sonar: Any, source: str, names: Mapping[str, str]) -> None:
    """The renderer takes the floor's range to grow with elevation, which ends straight down."""
    if _traced(sonar.tilt, sonar.elevation_aperture):
        return
    lowest = np.degrees(np.asarray(sonar.tilt, np.float64) + np.asarray(sonar.elevation_aperture, np.float64) / 2)
    if np.any(lowest > 90 + 1e-3):
        tilt, aperture = (names.get(field, field) for field in ("tilt", "elevation_aperture"))
        raise SonarjaxError(
            f"{source}: {tilt} plus half of {aperture} must be at most 90° (straight down), got {lowest.max():g}°"
        )
    if not _traced(sonar.roll, sonar.azimuth):
        _check_roll(sonar, source, names)


def _check_roll(sonar: Any, source: str, names: Mapping[str, str]) -> None:
    """With roll a beam's slice meets the floor at right angles above straight down: the same limit in that slice."""
    tilt, roll, aperture = (
        np.asarray(getattr(sonar, name), np.float64)[..., None] for name in ("tilt", "roll", "elevation_aperture")
    )
    azimuth = np.asarray(sonar.azimuth, np.float64)
    along = np.sin(tilt) * np.cos(azimuth) - np.cos(tilt) * np.sin(roll) * np.sin(azimuth)
    most = np.degrees(np.arctan2(np.maximum(np.cos(tilt) * np.cos(roll), 0.0), along))
    half = np.degrees(aperture) / 2
    if np.any(half > most + 1e-3):
        name, limited = (names.get(field, field) for field in ("roll", "elevation_aperture"))
        raise SonarjaxError(
            f"{source}: {name}: with it and this tilt, half of {limited} must be at most {np.round(most.min(), 3):g}°, "
            f"beyond which a beam passes the nearest point of the floor, got {half.max():g}°"
        )
