"""Presets against the numbers of the project's physics notes, and the check that every sonar passes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sonarjax.io.errors import SonarjaxError
from sonarjax.sonar import PRESETS, FloorPatch, Sonar
from sonarjax.sonar.check import check_sonar

DEVICES = {  # beams, frequency [Hz], vertical aperture [deg]
    "didson-hf": (96, 1.8e6, 14.0),
    "didson-lf": (48, 1.1e6, 14.0),
    "aris-1200": (48, 1.2e6, 14.0),
    "aris-1800": (96, 1.8e6, 14.0),
    "aris-3000": (128, 3.0e6, 14.0),
    "oculus": (256, 2.1e6, 12.0),
}


def degrees(sonar):
    return np.degrees(np.asarray(sonar.azimuth, np.float64))


def test_every_preset_is_tested_here():
    assert set(PRESETS) == set(DEVICES)


@pytest.mark.parametrize("name", DEVICES)
def test_device(name):
    sonar = Sonar.preset(name)
    n_beams, frequency, aperture = DEVICES[name]
    assert sonar.shape == (512, n_beams)
    assert sonar.frequency == frequency
    assert math.degrees(sonar.elevation_aperture) == pytest.approx(aperture)
    assert sonar.azimuth.dtype == jnp.float32
    assert np.all(np.diff(sonar.azimuth) > 0)
    np.testing.assert_allclose(sonar.azimuth, -sonar.azimuth[::-1], atol=1e-6)  # float32
    assert (sonar.range_min, sonar.range_max) == (1.5, 4.0)
    assert math.degrees(sonar.tilt) == pytest.approx(15.0)
    assert sonar.height == 0.9


@pytest.mark.parametrize("name", DEVICES)
def test_some_floor_is_lit_inside_the_window(name):
    sonar = Sonar.preset(name)
    lowest = sonar.height / math.sin(sonar.tilt + sonar.elevation_aperture / 2)
    assert sonar.range_min < lowest < sonar.range_max


@pytest.mark.parametrize(("name", "spacing"), [("didson-hf", 0.3), ("didson-lf", 0.6)])
def test_didson_spans_29_degrees_to_the_outer_edges(name, spacing):
    sonar = Sonar.preset(name)
    edges = np.degrees(sonar.azimuth_edges)
    assert edges[-1] - edges[0] == pytest.approx(29.0, abs=1e-4)
    np.testing.assert_allclose(np.diff(degrees(sonar)), spacing, atol=0.005)  # 29/96 and 29/48, rounded in Table 2


@pytest.mark.parametrize(
    ("name", "center", "edge", "first"),
    [("aris-1800", 0.342, 0.21, -13.749), ("aris-3000", 0.246, 0.217, -15.007), ("aris-1200", 0.684, 0.43, -13.5735)],
)
def test_aris_beams_narrow_from_the_centre_to_the_edge(name, center, edge, first):
    angles = degrees(Sonar.preset(name))
    spacing = np.diff(angles)
    middle = len(spacing) // 2
    assert angles[0] == pytest.approx(first, abs=1e-5)
    assert spacing[middle] == pytest.approx(center, rel=0.005)
    assert spacing[-1] == pytest.approx(edge, rel=0.025)  # half a beam inside the table's end
    assert np.all(np.diff(spacing[middle:]) < 1e-5)  # smooth and falling, up to float32


def test_oculus_is_even_in_the_sine():
    sonar = Sonar.preset("oculus")
    steps = np.diff(np.sin(np.asarray(sonar.azimuth, np.float64)))
    np.testing.assert_allclose(steps, 1 / 256, rtol=1e-4)
    np.testing.assert_allclose(np.degrees(sonar.azimuth_edges[jnp.array([0, -1])]), [-30, 30], atol=0.01)
    assert np.diff(degrees(sonar))[0] > 1.1 * np.diff(degrees(sonar))[128]


def test_overrides_are_fields_of_sonar():
    sonar = Sonar.preset(
        "didson-hf", tilt=0.35, n_ranges=100, azimuth=[-0.1, 0.0, 0.2], floor=FloorPatch(2.0, 0.0, 1.0, 1.0)
    )
    assert sonar.shape == (100, 3)
    assert sonar.tilt == 0.35
    assert sonar.azimuth.dtype == jnp.float32
    assert sonar.floor.x == 2.0
    assert Sonar.preset("didson-hf").tilt != 0.35  # nothing is shared


def test_traced_and_batched_overrides():
    assert jax.grad(lambda tilt: Sonar.preset("didson-hf", tilt=tilt, height=2 * tilt).height)(0.3) == 2.0
    azimuth = jnp.array([-0.1, 0.1])
    assert jax.jit(lambda a: Sonar.preset("didson-hf", azimuth=a).azimuth_edges)(azimuth).shape == (3,)
    assert Sonar.preset("didson-hf", tilt=jnp.array([0.2, 0.3])).tilt.shape == (2,)


def test_unknown_name_lists_the_known():
    for name in ("didson", "", "DIDSON-HF"):
        with pytest.raises(SonarjaxError, match="unknown sonar preset.*didson-hf, didson-lf.*oculus"):
            Sonar.preset(name)


def test_unknown_field_lists_the_known():
    with pytest.raises(SonarjaxError, match="unknown field tilt_deg, expected one of: azimuth, range_min"):
        Sonar.preset("didson-hf", tilt_deg=15)


NAN, INF = float("nan"), float("inf")
IMPOSSIBLE = [
    ({"tilt": NAN}, "tilt"),
    ({"tilt": 15.0}, "tilt must be between -90° and 90°, got 859"),  # degrees given for radians
    ({"tilt": "15"}, "tilt must be a number"),
    ({"tilt": None}, "tilt must be a number"),
    ({"tilt": True}, "tilt must be a number"),
    ({"tilt": [0.2, [0.3]]}, "tilt must be a number"),
    ({"tilt": []}, "tilt must be a number"),
    ({"tilt": jnp.array([0.2, NAN])}, "tilt"),
    ({"height": 0.0}, "height must be more than 0 m, got 0"),
    ({"height": -INF}, "height"),
    ({"range_min": -0.1}, "range_min must be 0 m or more"),
    ({"range_max": INF}, "range_max"),
    ({"range_min": 4.0}, "range_min must be less than range_max"),
    ({"range_min": 3.0, "range_max": 2.0}, "range_min must be less than range_max"),
    ({"elevation_aperture": 0.0}, "elevation_aperture"),
    ({"elevation_aperture": math.pi}, "elevation_aperture"),
    ({"sound_speed": 0.0}, "sound_speed"),
    ({"frequency": -1.0}, "frequency"),
    ({"pulse_length": -1e-3}, "pulse_length"),
    ({"absorption": NAN}, "absorption"),
    ({"highlight_max_incidence": 91.0}, "highlight_max_incidence"),
    ({"n_ranges": 0}, "n_ranges must be between 1 and 100000"),
    ({"n_ranges": 100_001}, "n_ranges"),
    ({"n_ranges": 512.0}, "n_ranges must be a whole number"),
    ({"n_ranges": True}, "n_ranges must be a whole number"),
    ({"azimuth": []}, "azimuth must be a list"),
    ({"azimuth": 0.1}, "azimuth must be a list"),
    ({"azimuth": [[0.1, 0.2]]}, "azimuth must be a list"),
    ({"azimuth": ["a"]}, "azimuth must be a list"),
    ({"azimuth": [0.1, NAN]}, "azimuth holds NaN"),
    ({"azimuth": [0.1, 0.1]}, "azimuth must be strictly ascending, but beam 1 is not"),
    ({"azimuth": [0.2, 0.1]}, "azimuth must be strictly ascending"),
    ({"azimuth": [-13.7, 13.7]}, "azimuth must stay within ±90°"),  # degrees given for radians
    ({"floor": FloorPatch(2.0, 0.0, 0.0, 1.0)}, "floor.length"),
    ({"floor": FloorPatch(NAN, 0.0, 1.0, 1.0)}, "floor.x"),
]


@pytest.mark.parametrize(("overrides", "message"), IMPOSSIBLE)
def test_impossible_values(overrides, message):
    with pytest.raises(SonarjaxError) as caught:
        Sonar.preset("didson-hf", **overrides)
    text = str(caught.value)
    assert message in text
    assert text.startswith("preset didson-hf: ")
    assert "\n" not in text


def test_check_uses_the_names_it_is_given():
    with pytest.raises(SonarjaxError, match="here: height_m must"):
        check_sonar(Sonar.preset("didson-hf").replace(height=-1.0), "here", {"height": "height_m"})


@pytest.mark.parametrize("seed", range(40))
def test_with_roll_the_floor_must_grow_farther_from_the_lowest_elevation_up(seed):
    """Rays of every beam from its lower to its upper end, turned by SciPy, against what is accepted."""
    rng = np.random.default_rng(seed)
    tilt, roll, aperture = rng.uniform([0, -90, 2], [90, 90, 40])
    sonar = Sonar.preset("didson-hf").replace(
        tilt=math.radians(tilt), roll=math.radians(roll), elevation_aperture=math.radians(aperture)
    )
    azimuth, elevation = np.asarray(sonar.azimuth, np.float64), np.radians(np.linspace(-aperture, aperture, 400)) / 2
    tau = np.tan(elevation)[:, None]
    rays = np.stack(np.broadcast_arrays(np.cos(azimuth), np.sin(azimuth), tau), -1) / np.sqrt(1 + tau**2)[..., None]
    down = -Rotation.from_euler("YX", [tilt, roll], degrees=True).apply(rays.reshape(-1, 3))[:, 2].reshape(400, -1)
    nearer = (np.diff(down, axis=0) > 1e-7) & (down[1:] > 0)  # a ray higher up that points more steeply down
    if nearer.any():
        with pytest.raises(SonarjaxError, match="must be at most"):
            check_sonar(sonar, "sonar")
    else:
        check_sonar(sonar, "sonar")


def test_a_right_angle_in_float32_is_one():
    check_sonar(Sonar.preset("didson-hf", tilt=jnp.radians(-90.0)), "sonar")
