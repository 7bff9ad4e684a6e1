"""`sonar.toml`: a `Sonar` as a text file, in metres, and in degrees where the key says `_deg`.

Reading checks every key, type and value, and raises one clear `SonarjaxError`. A written file reads back as the same
sonar, angles to the last digit but one, because degrees round. For a missing key the preset's value is used, or the
default of `Sonar`.
"""

from __future__ import annotations

import difflib
import math
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from sonarjax.io.atomic import write_text
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.fan_geometry import even_beams
from sonarjax.sonar.check import MAX_BEAMS, MAX_RANGES, as_numbers, check_sonar
from sonarjax.sonar.parts import FloorPatch, GeometryStd, field_of_view_deg
from sonarjax.sonar.presets import PRESETS, azimuth_from_deg

_FIELDS = {
    "range_min_m": "range_min",
    "range_max_m": "range_max",
    "elevation_aperture_deg": "elevation_aperture",
    "tilt_deg": "tilt",
    "height_m": "height",
    "roll_deg": "roll",
    "frequency_hz": "frequency",
    "sound_speed_m_s": "sound_speed",
    "pulse_length_m": "pulse_length",
    "beam_width_deg": "beam_width",
    "spreading_exponent": "spreading_exponent",
    "absorption_db_m": "absorption",
    "lambert": "lambert",
    "highlight_max_incidence_deg": "highlight_max_incidence",
}
_FLOOR_FIELDS = {"x_m": "x", "y_m": "y", "length_m": "length", "width_m": "width", "yaw_deg": "yaw"}
_STD_FIELDS = {
    "tilt_deg": "tilt",
    "roll_deg": "roll",
    "height_m": "height",
    "elevation_aperture_deg": "elevation_aperture",
    "range_offset_m": "range_offset",
    "range_scale": "range_scale",
    "azimuth_scale": "azimuth_scale",
    "beam_bend": "beam_bend",
    "beam_skew": "beam_skew",
    "highlight_max_incidence_deg": "highlight_max_incidence",
}
_KEPT_IN_DEGREES = {"highlight_max_incidence_deg"}
_REQUIRED = ("range_min_m", "range_max_m", "n_ranges", "elevation_aperture_deg", "tilt_deg", "height_m")
_BEAM_KEYS = ("azimuth_deg", "n_beams", "field_of_view_deg")
_KNOWN = ("preset", *_BEAM_KEYS, "n_ranges", *_FIELDS, "floor", "geometry_std")
KEYS = (
    {field: key for key, field in _FIELDS.items()}
    | {f"floor.{field}": f"floor.{key}" for key, field in _FLOOR_FIELDS.items()}
    | {f"geometry_std.{field}": f"geometry_std.{key}" for key, field in _STD_FIELDS.items()}
    | {"azimuth": "azimuth_deg"}
)
"""Field of a `Sonar` -> its key in the file, for messages."""


def table_fields(table: Mapping[str, Any], source: str) -> dict[str, Any]:
    """The fields of a `Sonar` in the units of `Sonar`, from a parsed `sonar.toml`; see `sonar_from_dict`.

    Values are not checked against what a device can have, only their types; see `check_sonar` and `check_beams`.
    """
    _refuse_unknown(table, _KNOWN, source)
    base = _preset(table, source)
    if base is None:
        _require(table, source)
    values = _numbers(table, _FIELDS, source)
    if "n_ranges" in table:
        values["n_ranges"] = _count_of(table, "n_ranges", MAX_RANGES, source)
    if "floor" in table:
        values["floor"] = _floor(table["floor"], source)
    if "geometry_std" in table:
        values["geometry_std"] = _geometry_std(table["geometry_std"], source)
    values["azimuth"] = _azimuth(table, base, source)
    if values["azimuth"].size == 1:
        view = table.get("field_of_view_deg", 0.0 if base is None else field_of_view_deg(base["azimuth"]))
        values.setdefault("beam_width", math.radians(view))
    return (base or {}) | values


def write_sonar(sonar: Any, path: str | Path) -> None:
    """Write the fields of a `Sonar` to a `sonar.toml` in one step.

    It reads back as the same sonar, but for the last digit of some angles: about one in ten has no number of degrees
    that is exactly it.

    Raises:
        SonarjaxError: A value is impossible, traced or batched, or the file cannot be written.
    """
    check_sonar(sonar, f"{path}: cannot write this sonar", KEYS)
    lines = ["# Metres; degrees where the key says _deg."]
    lines.append(f"azimuth_deg = [{', '.join(map(repr, _azimuth_deg(sonar, path)))}]")
    lines.append(f"n_ranges = {int(sonar.n_ranges)}")
    lines += [f"{key} = {_written(getattr(sonar, field), key, path)}" for key, field in _FIELDS.items()]
    if sonar.floor is not None:
        lines += ["", "[floor]"]
        lines += [f"{key} = {_written(getattr(sonar.floor, name), key, path)}" for key, name in _FLOOR_FIELDS.items()]
    if sonar.geometry_std is not None:
        known = {key: getattr(sonar.geometry_std, name) for key, name in _STD_FIELDS.items()}
        stated = [f"{key} = {_written(value, key, path)}" for key, value in known.items() if np.any(value)]
        lines += ["", "# Standard deviations of how well the above is known.", "[geometry_std]", *stated]
    write_text(path, "\n".join(lines) + "\n")


def _azimuth_deg(sonar: Any, path: str | Path) -> list[float]:
    angles = as_numbers(sonar.azimuth)
    if angles is None:
        raise SonarjaxError(f"{path}: azimuth_deg is traced and cannot be written to a file")
    return [round(angle, 12) for angle in np.degrees(angles).tolist()]


def _written(value: Any, key: str, path: str | Path) -> str:
    number = as_numbers(value)
    if number is None or number.ndim:
        raise SonarjaxError(f"{path}: {key} must be one number to be written to a file, got {_shown(value)}")
    plain = number.item()
    return repr(_degrees(plain) if _is_angle(key) else plain)


def _degrees(angle: float) -> float:
    """An angle [rad] in degrees, without the digits that come of rounding where it reads back the same without."""
    short = round(math.degrees(angle), 12)
    return short if math.radians(short) == angle else math.degrees(angle)


def _is_angle(key: str) -> bool:
    return key.endswith("_deg") and key not in _KEPT_IN_DEGREES


def _refuse_unknown(table: Mapping[str, Any], known: Iterable[str], source: str) -> None:
    for key in table:
        if key not in known:
            nearest = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f"did you mean {nearest[0]!r}?" if nearest else f"expected one of: {', '.join(known)}"
            raise SonarjaxError(f"{source}: unknown key {key!r}, {hint}")


def _preset(table: Mapping[str, Any], source: str) -> dict[str, Any] | None:
    if "preset" not in table:
        return None
    name = table["preset"]
    if not isinstance(name, str) or name not in PRESETS:
        raise SonarjaxError(f"{source}: unknown preset {_shown(name)}, expected one of: {', '.join(PRESETS)}")
    return PRESETS[name].fields()


def _require(table: Mapping[str, Any], source: str) -> None:
    missing = [key for key in _REQUIRED if key not in table]
    if "azimuth_deg" not in table and not ("n_beams" in table and "field_of_view_deg" in table):
        missing.insert(0, "azimuth_deg (or n_beams and field_of_view_deg)")
    if missing:
        raise SonarjaxError(f"{source}: missing {', '.join(missing)} (required without a preset)")


def _numbers(table: Mapping[str, Any], fields: Mapping[str, str], source: str, prefix: str = "") -> dict[str, Any]:
    """Values by field, in the units of `Sonar`, for the keys that are present."""
    values = {}
    for key, field in fields.items():
        if key in table:
            number = _number(table[key], prefix + key, source)
            values[field] = math.radians(number) if _is_angle(key) else number
    return values


def _number(value: Any, key: str, source: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise SonarjaxError(f"{source}: {key} must be a number, got {_shown(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise SonarjaxError(f"{source}: {key} must be a finite number, got {_shown(value)}")
    return number


def _count_of(table: Mapping[str, Any], key: str, largest: int, source: str) -> int:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise SonarjaxError(f"{source}: {key} must be a whole number, got {_shown(value)}")
    if not 1 <= value <= largest:
        raise SonarjaxError(f"{source}: {key} must be between 1 and {largest}, got {_shown(value)}")
    return int(value)


def _shown(value: Any) -> str:
    try:
        return reprlib.repr(value)
    except ValueError:  # Python refuses to print an integer of thousands of digits
        return "a huge number"


def _floor(table: Any, source: str) -> FloorPatch:
    if not isinstance(table, Mapping):
        raise SonarjaxError(f"{source}: floor must be a table [floor], got {_shown(table)}")
    _refuse_unknown(table, _FLOOR_FIELDS, f"{source}: [floor]")
    missing = [key for key in _FLOOR_FIELDS if key not in table and key != "yaw_deg"]
    if missing:
        raise SonarjaxError(f"{source}: [floor]: missing {', '.join(missing)}")
    return FloorPatch(**_numbers(table, _FLOOR_FIELDS, source, "floor."))


def _geometry_std(table: Any, source: str) -> GeometryStd:
    if not isinstance(table, Mapping):
        raise SonarjaxError(f"{source}: geometry_std must be a table [geometry_std], got {_shown(table)}")
    _refuse_unknown(table, _STD_FIELDS, f"{source}: [geometry_std]")
    return GeometryStd(**_numbers(table, _STD_FIELDS, source, "geometry_std."))


def _azimuth(table: Mapping[str, Any], base: dict[str, Any] | None, source: str) -> Float[Array, "beam"]:
    """Beam centres (beam,) [rad] from the list, or else from the number of beams and the field of view."""
    n_beams = _count_of(table, "n_beams", MAX_BEAMS, source) if "n_beams" in table else None
    view = None
    if "field_of_view_deg" in table:
        view = _number(table["field_of_view_deg"], "field_of_view_deg", source)
        if not 0 < view < 180:
            raise SonarjaxError(f"{source}: field_of_view_deg must be between 0 and 180, got {view:g}")
    if "azimuth_deg" in table:
        return _listed_azimuth(table["azimuth_deg"], source)
    if base is not None:
        own, count = field_of_view_deg(base["azimuth"]), base["azimuth"].size
        n_beams, view = n_beams or count, view or own
        if n_beams == count and math.isclose(view, own, rel_tol=1e-3):
            return base["azimuth"]  # the preset's own beams, even or not
    assert n_beams is not None  # `_require` has checked that both are given
    assert view is not None
    return azimuth_from_deg(even_beams(n_beams, view))


def _listed_azimuth(value: Any, source: str) -> Float[Array, "beam"]:
    if not isinstance(value, list | tuple | np.ndarray) or len(value) == 0:
        raise SonarjaxError(f"{source}: azimuth_deg must be a list of numbers, got {_shown(value)}")
    return azimuth_from_deg([_number(v, f"azimuth_deg[{i}]", source) for i, v in enumerate(value)])


def check_beams(table: Mapping[str, Any], azimuth: Any, source: str) -> None:
    """Raise a SonarjaxError unless `n_beams` and `field_of_view_deg` agree with the listed `azimuth` (beam,) [rad].

    The field of view need only agree to within one beam.
    """
    if "azimuth_deg" not in table:
        return
    count = len(azimuth)
    if "n_beams" in table and table["n_beams"] != count:
        raise SonarjaxError(f"{source}: n_beams is {table['n_beams']}, but azimuth_deg lists {count} beams")
    if "field_of_view_deg" in table and count > 1:
        listed, view = field_of_view_deg(azimuth), float(table["field_of_view_deg"])
        if abs(listed - view) > listed / count:
            raise SonarjaxError(f"{source}: field_of_view_deg is {view:g}, but azimuth_deg spans {listed:.2f}")
