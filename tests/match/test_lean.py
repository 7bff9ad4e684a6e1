"""Banks over lean: the attitudes that are tried, and which of them a clean image is matched with."""

import math

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.match import LeanSearch, LeanSearchConfig, SearchConfig, TargetSearch

AZIMUTH = np.radians((np.arange(48) - 23.5) * 29 / 48).astype(np.float32)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), azimuth=AZIMUTH, n_ranges=192)
MESH = sj.objects.target()
CONFIG = LeanSearchConfig(yaw_bins=12, lean=math.radians(12), lifts=(0.02,), candidates=4)


@pytest.fixture(scope="module")
def search():
    return LeanSearch(
        TargetSearch(MESH, SONAR, SearchConfig(coarse_yaws=12)), ("yaw", "x", "y", "z", "roll", "pitch"), CONFIG
    )


def test_attitudes_stand_as_high_as_they_are_told(search):
    attitudes = search.attitudes
    assert len(attitudes) == 12 * 9
    for yaw, z, roll, pitch in attitudes[::7]:
        placed = np.asarray(sj.Pose(0.0, 0.0, yaw, z, roll, pitch).to_ground(MESH.vertices))
        assert placed[:, 2].min() == pytest.approx(0.02, abs=1e-5)
    upright = LeanSearch(search.search, ("yaw", "x", "y"), CONFIG).attitudes
    assert len(upright) == 12 and not upright[:, 1:].any()


def test_a_clean_image_is_matched_with_its_attitude(search):
    k = 12 * 5 + 7
    yaw, z, roll, pitch = search.attitudes[k]
    truth = sj.Pose(2.3, 0.1, yaw + math.atan2(0.1, 2.3), z, roll, pitch)
    found = search.find(np.asarray(sj.render(MESH, truth, SONAR).semantic()))
    assert found.poses.shape == (4,) and (np.diff(found.scores) <= 1e-6).all()
    for name, most in (("x", 0.04), ("y", 0.03), ("yaw", 0.03), ("z", 1e-4), ("roll", 1e-4), ("pitch", 1e-4)):
        assert abs(float(getattr(found.poses, name)[0]) - float(getattr(truth, name))) < most, name


@pytest.mark.parametrize("y", [-0.3, 0.3])
@pytest.mark.parametrize("measured", ["everywhere", "most pixels", "three range bins of four"])
def test_an_object_is_found_to_either_side(search, y, measured):
    """Also if a pixel here and there, or a range bin in four, was not measured."""
    k = 7
    truth = sj.Pose(2.3, y, search.attitudes[k, 0] + math.atan2(y, 2.3), *search.attitudes[k, 1:])
    image = np.asarray(sj.render(MESH, truth, SONAR).semantic())
    mask = {
        "everywhere": None,
        "most pixels": np.random.default_rng(0).random(image.shape) > 0.2,
        "three range bins of four": np.arange(len(image))[:, None] % 4 + np.zeros(image.shape) > 0,
    }[measured]
    found = search.find(image if mask is None else np.where(mask, image, np.nan), mask)
    assert found.scores[0] > 0.9
    for name, most in (("x", 0.05), ("y", 0.03), ("yaw", 0.05)):
        assert abs(float(getattr(found.poses, name)[0]) - float(getattr(truth, name))) < most, name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"yaw_bins": 0}, "yaw_bins: expected a whole number of 1 or more"),
        ({"lifts": ()}, "lifts: expected at least one finite number"),
        ({"lean": 0.0}, "lean: expected an angle above 0 and below π/2"),
        ({"lean": 2.0}, "lean: expected an angle above 0 and below π/2"),
        ({"apart": 4.0}, "apart: expected an angle above 0 and below π "),
    ],
)
def test_searches_that_cannot_be_are_refused(change, message):
    with pytest.raises(sj.SonarjaxError, match=message):
        LeanSearchConfig(**change)
