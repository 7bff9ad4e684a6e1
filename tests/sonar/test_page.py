"""docs/sonar.md: every key of `sonar.toml` with its unit and default, and every preset, as the code has them."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sonarjax.sonar import PRESETS, Sonar, sonar_from_dict, toml

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "sonar.md").read_text(encoding="utf-8")
UNITS = {"_db_m": "dB/m", "_m_s": "m/s", "_deg": "deg", "_hz": "Hz", "_m": "m", "": "1"}
"""Unit by how a key ends, longer endings first."""
WITHOUT_UNIT = ("preset", "floor", "geometry_std")
DEVICE = "the preset's"


def rows(head: str) -> dict[str, list[str]]:
    """The other cells of each row, by its key, of the table whose first column is called `head`."""
    table = re.search(rf"^\| {re.escape(head)} \|.*\n\|[-|]+\|\n((?:\|.+\|\n)+)", PAGE, re.MULTILINE)
    assert table is not None
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[1].splitlines()]
    return {first.strip("`"): rest for first, *rest in cells}


KEYS, FLOOR, STD = rows("key"), rows("key in `[floor]`"), rows("key in `[geometry_std]`")
DEVICES = rows("preset")


def value_of(sonar: Any, key: str) -> float:
    """What a sonar has under a key of the file, in the unit of the key."""
    if key == "n_ranges":
        return sonar.n_ranges
    number = getattr(sonar, toml._FIELDS[key])
    return math.degrees(number) if toml._is_angle(key) else number


def test_every_key_is_there_and_no_other() -> None:
    assert set(KEYS) == set(toml._KNOWN)
    assert set(FLOOR) == set(toml._FLOOR_FIELDS)
    assert set(STD) == set(toml._STD_FIELDS)


@pytest.mark.parametrize("key", [key for key in KEYS | FLOOR | STD if key not in WITHOUT_UNIT])
def test_unit(key: str) -> None:
    unit = next(unit for ending, unit in UNITS.items() if key.endswith(ending))
    assert {table[key][0] for table in (KEYS, FLOOR, STD) if key in table} == {unit}


@pytest.mark.parametrize("key", ["n_ranges", *toml._FIELDS])
def test_default(key: str) -> None:
    _, preset, without, _ = KEYS[key]
    values = [value_of(sonar_from_dict({"preset": name}, "s"), key) for name in PRESETS]
    assert preset == DEVICE or [float(preset)] * len(values) == pytest.approx(values)
    assert preset != DEVICE or len(set(values)) > 1  # a number that all share is better said
    least = {"n_beams": 9, "field_of_view_deg": 9.0, **{k: value_of(Sonar.preset("oculus"), k) for k in toml._REQUIRED}}
    assert (without == "required") == (key in toml._REQUIRED)
    assert without == "required" or float(without) == pytest.approx(value_of(sonar_from_dict(least, "s"), key))


def test_default_of_beams_and_tables() -> None:
    assert all(KEYS[key][1] == DEVICE and KEYS[key][2].startswith("required, or") for key in toml._BEAM_KEYS)
    assert [cells[1] for cells in FLOOR.values()] == ["required"] * 4 + ["0"]
    assert {cells[1] for cells in STD.values()} == {"0"}
    floor = {key: 1.0 for key, cells in FLOOR.items() if cells[1] == "required"}
    made = sonar_from_dict({"preset": "oculus", "floor": floor, "geometry_std": {}}, "s")
    assert made.floor.yaw == 0.0 and all(value == 0.0 for value in vars(made.geometry_std).values())


def test_every_preset_is_there_and_no_other() -> None:
    assert list(DEVICES) == list(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_preset(name: str) -> None:
    beams, view, width, aperture, frequency, _ = DEVICES[name]
    sonar = Sonar.preset(name)
    edges = np.degrees(np.asarray(sonar.azimuth_edges, np.float64))
    widths = np.diff(edges)
    assert int(beams) == sonar.n_beams
    assert float(view) == pytest.approx(edges[-1] - edges[0], abs=0.051)
    assert [float(width.split()[0]), float(width.split()[-1])] == pytest.approx([widths.min(), widths.max()], abs=6e-4)
    assert float(aperture) == pytest.approx(math.degrees(sonar.elevation_aperture))
    assert float(frequency) * 1e6 == pytest.approx(sonar.frequency)
