"""`recognize` with banks of other than 36 yaws."""

from __future__ import annotations

import math

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.match import SearchConfig, TargetSearch
from sonarjax.recognize import Recognizer
from sonarjax.refine import MAP_REFINEMENT

# A short window, so that few banks are rendered.
SONAR = """
n_beams = 32
field_of_view_deg = 29.0
range_min_m = 2.25
range_max_m = 2.75
n_ranges = 48
elevation_aperture_deg = 14.0
tilt_deg = 20.0
height_m = 0.9
"""
FINE, COARSE = 72, 18  # multiples of the views that one compiled call renders
TRUE_DEG = 35.0


@pytest.fixture(scope="module")
def mesh() -> sj.Mesh:
    return sj.objects.target()


@pytest.fixture(scope="module")
def sonar(tmp_path_factory) -> sj.Sonar:
    path = tmp_path_factory.mktemp("sonar") / "sonar.toml"
    path.write_text(SONAR)
    return sj.Sonar.from_toml(path)


@pytest.fixture(scope="module")
def image(mesh, sonar) -> np.ndarray:
    """A true map: one view of a bank where the bank has it."""
    search = TargetSearch(mesh, sonar, SearchConfig(yaw_bins=FINE))
    bank = search.find(np.asarray(sj.render(mesh, sj.Pose(2.3, yaw=math.radians(TRUE_DEG)), sonar).semantic())).bank
    view = np.asarray(bank.templates[round(TRUE_DEG * FINE / 360)])
    seen = np.full(sonar.shape, 0.5, np.float32)
    (top, left), (rows, columns) = np.asarray(bank.offset), view.shape
    seen[top : top + rows, left : left + columns] = view
    return seen


@pytest.mark.slow
def test_the_nearest_of_the_bins_is_found(image, mesh, sonar):
    found = {}
    for bins, nearest_deg in ((FINE, 35.0), (COARSE, 40.0), (FINE, 35.0)):  # again: no bank is taken for another's
        found[bins] = sj.recognize(
            image, mesh, sonar, segmenter="none", refine=None, search=SearchConfig(yaw_bins=bins)
        )
        assert found[bins].scores_by_yaw.shape == (bins,)
        assert math.degrees(found[bins].yaw_bin) == pytest.approx(nearest_deg, abs=0.1)
    assert found[FINE].score == pytest.approx(1.0, abs=1e-3) and found[COARSE].score < 0.99
    assert sj.recognize(image, mesh, sonar, segmenter="none", refine=None).scores_by_yaw.shape == (36,)


def test_refinement_may_go_as_far_as_a_wide_bin(mesh, sonar):
    def bounds(bins):
        refine = Recognizer(mesh, sonar, segmenter="none", search=SearchConfig(yaw_bins=bins)).refine
        assert refine is not None
        return refine.bounds

    yaw, *place = bounds(8)
    assert yaw == pytest.approx(math.radians(45.0)) and tuple(place) == MAP_REFINEMENT.bounds[1:]
    assert bounds(36) == pytest.approx(MAP_REFINEMENT.bounds)
    assert bounds(180) == MAP_REFINEMENT.bounds  # places and maps err no less when bins are narrow


def test_too_few_bins_are_refused():
    with pytest.raises(sj.SonarjaxError, match="yaw_bins: expected a whole number of 4 or more, got 3"):
        SearchConfig(yaw_bins=3)
