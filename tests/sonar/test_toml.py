"""`sonar.toml`: round trips, every way to write the beams, and every bad input as one clear line."""

import math
import os
from dataclasses import fields
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.sonar import PRESETS, FloorPatch, GeometryStd, Sonar, sonar_from_dict

REAL = Path(os.environ.get("SONARJAX_REAL_DATA", "absent")) / "pipe" / "sonar.toml"
BASE = {
    "n_beams": 96,
    "field_of_view_deg": 29.0,
    "range_min_m": 1.5,
    "range_max_m": 4,
    "n_ranges": 512,
    "elevation_aperture_deg": 14.0,
    "tilt_deg": 15.0,
    "height_m": 0.9,
}


def assert_same(left, right):
    assert jax.tree.structure(left) == jax.tree.structure(right)
    for a, b in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip_of_every_preset(name, tmp_path):
    sonar = Sonar.preset(name)
    sonar.to_toml(tmp_path / "sonar.toml")
    back = Sonar.from_toml(tmp_path / "sonar.toml")
    assert_same(sonar, back)
    np.testing.assert_array_equal(sonar.azimuth, back.azimuth)


def test_angles_read_back_as_the_same_numbers(tmp_path):
    """0.35 rad has more digits in degrees than 20° has."""
    for tilt in (0.35, math.radians(20.0)):
        sonar = Sonar.preset("didson-hf", tilt=tilt)
        sonar.to_toml(tmp_path / "sonar.toml")
        assert Sonar.from_toml(tmp_path / "sonar.toml") == sonar
    assert "tilt_deg = 20.0\n" in (tmp_path / "sonar.toml").read_text(encoding="utf-8")


def test_round_trip_of_every_field(tmp_path):
    values = {f.name: 0.123456789 + 0.01 * i for i, f in enumerate(fields(Sonar))}
    values |= {
        "azimuth": jnp.array([-0.2, 0.01, 0.3]),
        "n_ranges": 77,
        "range_max": 3.3,
        "highlight_max_incidence": 80.0,
    }
    values |= {"frequency": 1.25e-7, "height": jnp.float32(0.7), "tilt": np.float64(0.3)}
    values["floor"] = FloorPatch(x=1.7844, y=0.0393, length=0.4, width=0.41, yaw=-0.2)
    values["geometry_std"] = GeometryStd(tilt=0.01, height=0.02, azimuth_scale=0.003, highlight_max_incidence=4.0)
    sonar = Sonar(**values)
    sonar.to_toml(tmp_path / "sonar.toml")
    back = Sonar.from_toml(str(tmp_path / "sonar.toml"))
    assert_same(sonar, back)
    assert all(isinstance(leaf, float) for leaf in jax.tree.leaves(back) if leaf is not back.azimuth)
    assert back.azimuth.dtype == jnp.float32
    back.to_toml(tmp_path / "sonar.toml")  # overwrites
    assert_same(back, Sonar.from_toml(tmp_path / "sonar.toml"))


def test_degrees_become_radians():
    extra = {"roll_deg": 2.0, "beam_width_deg": 0.4, "highlight_max_incidence_deg": 85, "absorption_db_m": 0.84}
    sonar = sonar_from_dict(BASE | extra | {"pulse_length_m": 0.01}, "s")
    assert sonar.tilt == pytest.approx(math.radians(15))
    assert sonar.roll == pytest.approx(math.radians(2))
    assert sonar.beam_width == pytest.approx(math.radians(0.4))
    assert sonar.elevation_aperture == pytest.approx(math.radians(14))
    assert sonar.highlight_max_incidence == 85.0  # stays in degrees
    assert (sonar.absorption, sonar.pulse_length) == (0.84, 0.01)
    assert (sonar.range_max, type(sonar.range_max)) == (4.0, float)


def test_number_of_beams_and_field_of_view_equal_the_preset():
    assert_same(sonar_from_dict(BASE, "s"), Sonar.preset("didson-hf"))


def test_preset_is_overridden_by_the_rest():
    sonar = sonar_from_dict({"preset": "aris-3000", "tilt_deg": 20, "n_ranges": 100}, "s")
    assert_same(sonar, Sonar.preset("aris-3000", tilt=math.radians(20), n_ranges=100))


def test_preset_keeps_its_uneven_beams_while_the_numbers_agree():
    uneven = Sonar.preset("aris-3000").azimuth
    same = sonar_from_dict({"preset": "aris-3000", "n_beams": 128}, "s").azimuth
    np.testing.assert_array_equal(same, uneven)
    fewer = sonar_from_dict({"preset": "aris-3000", "n_beams": 64}, "s")
    np.testing.assert_allclose(np.diff(fewer.azimuth), np.diff(fewer.azimuth)[0], rtol=1e-4)
    edges = Sonar.preset("aris-3000").azimuth_edges
    np.testing.assert_allclose(fewer.azimuth_edges[jnp.array([0, -1])], edges[jnp.array([0, -1])], rtol=1e-5)
    narrower = sonar_from_dict({"preset": "didson-hf", "field_of_view_deg": 28.8}, "s")
    np.testing.assert_allclose(np.degrees(np.diff(narrower.azimuth)), 0.3, rtol=1e-4)


def test_both_forms_of_the_beams_may_agree():
    azimuth = np.degrees(np.asarray(Sonar.preset("aris-1800").azimuth)).tolist()
    both = BASE | {"azimuth_deg": azimuth, "n_beams": 96, "field_of_view_deg": 27.7}
    assert sonar_from_dict(both, "s").n_beams == 96
    with pytest.raises(SonarjaxError, match="n_beams is 95, but azimuth_deg lists 96"):
        sonar_from_dict(both | {"n_beams": 95}, "s")
    with pytest.raises(SonarjaxError, match="field_of_view_deg is 29, but azimuth_deg spans 27.7"):
        sonar_from_dict(both | {"field_of_view_deg": 29.0}, "s")


def test_one_beam_is_as_wide_as_the_field_of_view():
    sonar = sonar_from_dict(BASE | {"n_beams": 1, "field_of_view_deg": 2.0}, "s")
    np.testing.assert_allclose(np.degrees(sonar.azimuth_edges), [-1, 1], rtol=1e-5)


@pytest.mark.parametrize("beams", [{"n_beams": 1}, {"azimuth_deg": [0.0]}])
def test_one_beam_is_as_wide_as_the_field_of_view_of_the_preset(beams):
    sonar = sonar_from_dict({"preset": "didson-hf"} | beams, "s")
    np.testing.assert_allclose(np.degrees(sonar.azimuth_edges), [-14.5, 14.5], rtol=1e-5)
    narrow = sonar_from_dict({"preset": "didson-hf", "beam_width_deg": 2} | beams, "s")
    np.testing.assert_allclose(np.degrees(narrow.azimuth_edges), [-1, 1], rtol=1e-5)


def test_numbers_of_numpy_are_numbers():
    given = {"preset": "didson-hf", "tilt_deg": np.float32(20), "height_m": np.int64(1), "n_ranges": np.int64(100)}
    plain = sonar_from_dict({"preset": "didson-hf", "tilt_deg": 20, "height_m": 1, "n_ranges": 100}, "s")
    assert_same(sonar_from_dict(given, "s"), plain)


def test_floor_table(tmp_path):
    text = 'preset = "aris-3000"\n[floor]\nx_m = 1.8\ny_m = 0\nlength_m = 0.4\nwidth_m = 0.4\nyaw_deg = 90\n'
    floor = Sonar.from_toml(write(tmp_path / "s.toml", text)).floor
    assert floor == FloorPatch(1.8, 0.0, 0.4, 0.4, math.radians(90))
    assert Sonar.from_toml(write(tmp_path / "s.toml", text.replace("yaw_deg = 90\n", ""))).floor.yaw == 0.0


@pytest.mark.skipif(not REAL.exists(), reason="the real frames are not here")
def test_real_file(tmp_path):
    sonar = Sonar.from_toml(REAL)
    assert sonar.shape == (210, 82)
    assert sonar.frequency == 3.0e6
    assert math.degrees(sonar.tilt) == pytest.approx(33.86)
    assert math.degrees(float(sonar.azimuth[0])) == pytest.approx(-8.5039, abs=1e-5)
    sonar.to_toml(tmp_path / "sonar.toml")
    assert_same(sonar, Sonar.from_toml(tmp_path / "sonar.toml"))


NAN, INF = float("nan"), float("inf")
BAD = [
    ({"tilt": 15}, "unknown key 'tilt', did you mean 'tilt_deg'?"),
    ({"heigth_m": 1}, "did you mean 'height_m'?"),
    ({"zzz": 1}, "unknown key 'zzz', expected one of: preset, azimuth_deg"),
    ({"two\nlines": 1}, r"unknown key 'two\nlines'"),
    ({"preset": "didson"}, "unknown preset 'didson', expected one of: didson-hf"),
    ({"preset": 3}, "unknown preset 3"),
    ({"tilt_deg": "15"}, "tilt_deg must be a number, got '15'"),
    ({"tilt_deg": True}, "tilt_deg must be a number, got True"),
    ({"tilt_deg": np.bool_(True)}, "tilt_deg must be a number, got "),
    ({"n_ranges": np.float64(100)}, "n_ranges must be a whole number, got "),
    ({"n_beams": 1, "beam_width_deg": 0}, "beam_width_deg must be more than 0° where there is a single beam"),
    ({"tilt_deg": [15.0]}, "tilt_deg must be a number, got [15.0]"),
    ({"tilt_deg": NAN}, "tilt_deg must be a finite number"),
    ({"height_m": INF}, "height_m must be a finite number"),
    ({"height_m": 10**400}, "height_m must be a finite number"),
    ({"height_m": 16**9000}, "height_m must be a finite number, got a huge number"),
    ({"height_m": 0}, "height_m must be more than 0 m, got 0"),
    ({"tilt_deg": 95}, "tilt_deg must be between -90° and 90°, got 95°"),
    ({"elevation_aperture_deg": 180}, "elevation_aperture_deg must be between 0° and 180°"),
    ({"elevation_aperture_deg": 0}, "elevation_aperture_deg"),
    ({"sound_speed_m_s": -1480}, "sound_speed_m_s must be more than 0 m/s"),
    ({"frequency_hz": 0}, "frequency_hz"),
    ({"pulse_length_m": -0.1}, "pulse_length_m"),
    ({"range_min_m": -1}, "range_min_m must be 0 m or more"),
    ({"range_min_m": 4.0}, "range_min_m must be less than range_max_m"),
    ({"range_max_m": 1e308}, "range_max_m must be at most 1000 m, got 1e+308"),
    ({"range_max_m": 1e300}, "range_max_m must be at most 1000 m, got 1e+300"),
    ({"range_min_m": 2.0, "range_max_m": 2.0000000001}, "range_min_m and range_max_m must lie farther apart"),
    ({"range_min_m": 2.0, "range_max_m": 2.0001}, "512 range bins of 2e-07 m, expected at least 1e-06 m"),
    ({"range_min_m": 0, "range_max_m": 1e-300}, "range_max_m must be more than 0 m, got 1e-300"),
    ({"range_min_m": 0, "range_max_m": 1e-30}, "range_min_m and range_max_m must lie farther apart"),
    ({"height_m": 1e39}, "height_m must be at most 1000 m, got 1e+39"),
    ({"height_m": 1e-300}, "height_m must be more than 0 m, got 1e-300"),
    ({"frequency_hz": 1e39}, "frequency_hz must be at most 1e+09 Hz"),
    ({"sound_speed_m_s": 1e39}, "sound_speed_m_s must be at most 100000 m/s"),
    ({"pulse_length_m": 1e39}, "pulse_length_m must be at most 1000 m"),
    ({"spreading_exponent": 1e9}, "spreading_exponent must be at most 10, got 1e+09"),
    ({"absorption_db_m": 1e39}, "absorption_db_m must be at most 1000 dB/m"),
    ({"lambert": 1e9}, "lambert must be at most 100"),
    (
        {"floor": {"x_m": -1e39, "y_m": 0, "length_m": 1, "width_m": 1}},
        "floor.x_m must be at most 100000 m, got -1e+39",
    ),
    (
        {"n_beams": 10_000, "n_ranges": 100_000},
        "n_ranges times n_beams must be at most 16777216, got 100000 x 10000 = 1000000000",
    ),
    ({"n_ranges": 512.0}, "n_ranges must be a whole number, got 512.0"),
    ({"n_ranges": True}, "n_ranges must be a whole number"),
    ({"n_ranges": "512"}, "n_ranges must be a whole number"),
    ({"n_ranges": 0}, "n_ranges must be between 1 and 100000"),
    ({"n_ranges": 100_001}, "n_ranges must be between 1 and 100000"),
    ({"n_ranges": 16**9000}, "n_ranges must be between 1 and 100000, got a huge number"),
    ({"n_beams": 96.0}, "n_beams must be a whole number"),
    ({"n_beams": 0}, "n_beams must be between 1 and 10000"),
    ({"n_beams": 10**9}, "n_beams must be between 1 and 10000"),
    ({"field_of_view_deg": 0}, "field_of_view_deg must be between 0 and 180"),
    ({"field_of_view_deg": 360}, "field_of_view_deg must be between 0 and 180"),
    ({"field_of_view_deg": "29"}, "field_of_view_deg must be a number"),
    ({"azimuth_deg": 3.0}, "azimuth_deg must be a list of numbers, got 3.0"),
    ({"azimuth_deg": []}, "azimuth_deg must be a list of numbers"),
    ({"azimuth_deg": [[1.0, 2.0]]}, "azimuth_deg[0] must be a number, got [1.0, 2.0]"),
    ({"azimuth_deg": [1.0, "2"]}, "azimuth_deg[1] must be a number"),
    ({"azimuth_deg": [1.0, True]}, "azimuth_deg[1] must be a number"),
    ({"azimuth_deg": [1.0, NAN]}, "azimuth_deg[1] must be a finite number"),
    ({"azimuth_deg": [2.0, 1.0]}, "azimuth_deg must be strictly ascending, but beam 1 is not"),
    ({"azimuth_deg": [0.0, 95.0]}, "azimuth_deg must stay within ±90°, got 95"),
    ({"highlight_max_incidence_deg": 120}, "highlight_max_incidence_deg"),
    ({"floor": 1}, "floor must be a table [floor], got 1"),
    ({"floor": {"x_m": 1}}, "[floor]: missing y_m, length_m, width_m"),
    ({"floor": {"x": 1}}, "[floor]: unknown key 'x', did you mean 'x_m'?"),
    ({"floor": {"x_m": 1, "y_m": "a", "length_m": 1, "width_m": 1}}, "floor.y_m must be a number"),
    ({"floor": {"x_m": 1, "y_m": 0, "length_m": -1, "width_m": 1}}, "floor.length_m must be more than 0 m"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_values(change, message):
    with pytest.raises(SonarjaxError) as caught:
        sonar_from_dict(BASE | change, "my/sonar.toml")
    text = str(caught.value)
    assert message in text
    assert text.startswith("my/sonar.toml: ")
    assert "\n" not in text


@pytest.mark.parametrize("key", [key for key in BASE if key not in ("n_beams", "field_of_view_deg")])
def test_missing_key(key):
    with pytest.raises(SonarjaxError, match=f"^s.toml: missing {key} "):
        sonar_from_dict({k: v for k, v in BASE.items() if k != key}, "s.toml")


@pytest.mark.parametrize("key", ["n_beams", "field_of_view_deg"])
def test_missing_beams(key):
    with pytest.raises(SonarjaxError, match=r"missing azimuth_deg \(or n_beams and field_of_view_deg\)"):
        sonar_from_dict({k: v for k, v in BASE.items() if k != key}, "s.toml")


def test_empty_file_names_every_missing_key(tmp_path):
    with pytest.raises(SonarjaxError, match="sonar.toml: missing azimuth_deg.*range_min_m.*height_m"):
        Sonar.from_toml(write(tmp_path / "sonar.toml", ""))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"tilt_deg = \n", "expected a TOML file"),
        (b"tilt_deg = 1\ntilt_deg = 2\n", "expected a TOML file"),
        (b"height_m = " + b"9" * 5000, "expected a TOML file"),
        (b"azimuth_deg = " + b"[" * 5000, "expected a TOML file"),
        (b"# caf\xe9\n", "expected a TOML file"),
        (b"\x00\xff\xfe", "expected a TOML file"),
        (b"preset = 2020-01-01\n", "unknown preset"),
    ],
)
def test_unreadable_content(content, message, tmp_path):
    path = tmp_path / "sonar.toml"
    path.write_bytes(content)
    with pytest.raises(SonarjaxError) as caught:
        Sonar.from_toml(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(SonarjaxError, match="none.toml"):
        Sonar.from_toml(tmp_path / "none.toml")
    with pytest.raises(SonarjaxError, match="folder"):
        Sonar.from_toml(tmp_path)


def test_what_cannot_be_written(tmp_path):
    path, sonar = tmp_path / "sonar.toml", Sonar.preset("didson-hf")
    with pytest.raises(SonarjaxError, match="height_m must be more than 0 m"):
        sonar.replace(height=-1.0).to_toml(path)
    with pytest.raises(SonarjaxError, match="tilt_deg must be one number"):
        sonar.replace(tilt=jnp.array([0.1, 0.2])).to_toml(path)
    with pytest.raises(SonarjaxError, match="tilt_deg must be one number"):
        jax.jit(lambda tilt: sonar.replace(tilt=tilt).to_toml(path))(0.1)
    with pytest.raises(SonarjaxError, match="azimuth_deg is traced"):
        jax.jit(lambda azimuth: sonar.replace(azimuth=azimuth).to_toml(path))(sonar.azimuth)
    with pytest.raises(SonarjaxError):
        sonar.to_toml(tmp_path)
    assert list(tmp_path.iterdir()) == []
