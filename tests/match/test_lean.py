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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"yaw_bins": 0}, "yaw_bins: expected a whole number of 1 or more"),
        ({"lifts": ()}, "lifts: expected at least one finite number"),
        ({"lean": 0.0}, "positive angles"),
    ],
)
def test_searches_that_cannot_be_are_refused(change, message):
    with pytest.raises(sj.SonarjaxError, match=message):
        LeanSearchConfig(**change)
