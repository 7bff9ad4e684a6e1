"""What a search makes of distances at which its target cannot be rendered."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.io.errors import OutOfViewError
from sonarjax.match import first_look, search
from sonarjax.match.compact import CompactBank
from sonarjax.match.first_look import FirstLook
from sonarjax.match.lean import LeanSearch, LeanSearchConfig
from sonarjax.match.ncc import match_positions
from sonarjax.match.search import SearchConfig, TargetSearch, coarse_bank, coarse_frame, rounded_up
from sonarjax.refine import Candidate, curve_evidence
from sonarjax.segment.rule import FULL_RISE

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))


def failing(error: Exception) -> Any:
    def template_bank(*_: Any, **__: Any) -> Any:
        raise error

    return template_bank


def brick() -> TargetSearch:
    return TargetSearch(sj.objects.brick(), SONAR, compact=True)


@pytest.mark.parametrize(
    ("module", "look"),
    [
        (search, lambda: brick()._prepared(0, False, False, "map")),
        (first_look, lambda: FirstLook([brick()])._view(brick(), 2.5)),
    ],
)
def test_only_a_target_that_is_out_of_view_is_passed_over(
    module: ModuleType, look: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any other complaint, such as of a slice without room, is not mistaken for it."""
    monkeypatch.setattr(module, "template_bank", failing(OutOfViewError("far away")))
    assert look() is None
    monkeypatch.setattr(module, "template_bank", failing(sj.SonarjaxError("no room")))
    with pytest.raises(sj.SonarjaxError, match="no room"):
        look()


def test_a_copy_finds_the_same() -> None:
    """With the banks that were rendered so far; a search holds a lock, which cannot be copied."""
    azimuth = np.radians(np.linspace(-6, 6, 24)).astype(np.float32)
    sonar = sj.Sonar.preset("didson-hf", tilt=0.35, n_ranges=64, range_min=2.0, range_max=3.0, azimuth=azimuth)
    made = sj.Recognizer(sj.objects.brick(), sonar, search=SearchConfig(yaw_bins=8), segmenter="none", refine=None)
    image = np.asarray(sj.render(sj.objects.brick(), sj.Pose(x=2.3), sonar).semantic())
    found = made(image)
    again = copy.deepcopy(made)(image)
    assert (again.score, again.yaw, again.x) == (found.score, found.yaw, found.x)
    assert again in [found, again] and again != found


@pytest.mark.slow
def test_a_fan_to_one_side_is_searched_in_its_middle() -> None:
    """The target is seen though the sonar has no beam straight ahead."""
    azimuth = np.radians(np.linspace(8.0, 34.0, 64)).astype(np.float32)
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), azimuth=azimuth)
    truth, mesh = sj.Pose(x=2.1, y=1.0, yaw=0.7), sj.objects.target()
    image = np.asarray(sj.render(mesh, truth, sonar).semantic())
    search = TargetSearch(mesh, sonar, SearchConfig(yaw_bins=12))
    match = search.find(image)
    assert math.dist(search.place(match), (2.1, 1.0)) < 0.05
    bearing = math.atan2(1.0, 2.1) - float(match.bank.bearing)
    yaw = float(match.bank.yaws[match.scores.argmax()]) + bearing
    assert abs(math.remainder(yaw - 0.7, 2 * math.pi)) < math.radians(15.5)
    lean = LeanSearch(search, ("yaw", "x", "y"), LeanSearchConfig(yaw_bins=12)).find(image)
    assert abs(math.remainder(float(lean.poses.yaw[0]) - yaw, 2 * math.pi)) < math.radians(2.0)


@pytest.mark.parametrize(("frame", "shape"), [((128, 96), (64, 32)), ((60, 24), (60, 24))])
def test_coarse_templates_grow_behind_and_to_port_within_the_frame(
    frame: tuple[int, int], shape: tuple[int, int]
) -> None:
    drawn = np.random.default_rng(0).random((2, 50, 20)).astype(np.float32)
    padded = rounded_up(drawn, frame)
    assert padded.shape[1:] == shape
    np.testing.assert_array_equal(padded[:, :50, :20], drawn)
    assert (padded[:, 50:] == 0.5).all() and (padded[:, :, 20:] == 0.5).all()


@pytest.mark.parametrize("step", [4, 128])
def test_a_coarse_frame_is_matched_where_it_was_drawn(step: int) -> None:
    """Also where a template is smaller than one coarse row, and cannot be shifted in range."""
    bank = sj.template_bank(sj.objects.target(), SONAR, np.zeros(1), x=2.5)
    top, left = (int(v) for v in np.asarray(bank.offset))
    top = top - top % step if step == 4 else 0
    drawn = np.asarray(bank.templates)
    image = np.full(SONAR.shape, 0.5, np.float32)
    image[top : top + drawn.shape[1], left : left + drawn.shape[2]] = drawn[0]
    small, mask = coarse_frame(image, None, step)
    found = match_positions(small, coarse_bank(drawn, SONAR, step, False))
    assert mask is None and float(found.scores[0]) == pytest.approx(1.0, abs=1e-4)
    assert (int(found.row[0]), int(found.col[0])) == (top // step, left)


def test_a_coarse_frame_averages_what_was_measured() -> None:
    rng = np.random.default_rng(1)
    image, mask = rng.random((64, 8)).astype(np.float32), rng.random((64, 8)) > 0.4
    mask[:8] = False
    small, seen = coarse_frame(np.where(mask, image, np.nan), mask, 4)
    assert seen is not None and small.dtype == np.float32 and np.isfinite(small).all()
    groups, counted = image.reshape(16, 4, 8), mask.reshape(16, 4, 8)
    np.testing.assert_array_equal(seen, counted.sum(1) >= 2)
    means = (groups * counted).sum(1) / np.maximum(counted.sum(1), 1)
    np.testing.assert_allclose(small[seen], means[seen], rtol=1e-5)


@pytest.mark.parametrize("bearing_deg", [-11.0, pytest.param(11.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("compact", "masked"), [(False, False), (True, False), (False, True)])
def test_an_object_near_a_side_of_the_fan_is_found(compact: bool, masked: bool, bearing_deg: float) -> None:
    """The box of all yaws does not fit between it and the side."""
    bearing, yaw = math.radians(bearing_deg), math.radians(60.0)
    x, y = 2.4 * math.cos(bearing), 2.4 * math.sin(bearing)
    search = TargetSearch(sj.objects.target(), SONAR, SearchConfig(yaw_bins=12), compact=compact)
    image = np.asarray(sj.render(search.mesh, sj.Pose(x, y, yaw + bearing), SONAR).semantic())
    mask = np.ones(image.shape, bool)
    mask[:5] = False
    match = search.find(np.where(mask, image, np.nan) if masked else image, mask if masked else None)
    best = match.scores.argmax()
    assert match.scores[best] > 0.9 and math.degrees(np.asarray(match.bank.yaws)[best]) == pytest.approx(60.0)
    assert search.place(match) == pytest.approx((x, y), abs=0.03)


@pytest.mark.parametrize("compact", [False, True])
def test_own_scores_are_the_correlations_of_the_best_template(compact: bool) -> None:
    search = TargetSearch(sj.objects.target(), SONAR, SearchConfig(yaw_bins=12), compact=compact)
    image = np.asarray(sj.render(search.mesh, sj.Pose(x=2.5, yaw=0.9), SONAR).semantic())
    match = search.find_near(5, image)
    templates = np.asarray(match.matched.templates, np.float64).reshape(12, -1)
    known = np.corrcoef(templates)[match.scores.argmax()]
    np.testing.assert_allclose(match.own_scores(), known, atol=1e-5)
    flat = match._replace(matched=CompactBank.of(np.full((12, 97, 29), 60 / 255, np.float32)))
    assert (flat.own_scores() == 0).all()


def test_the_best_yaw_of_a_round_object_cannot_stand_out() -> None:
    """Even without noise the scores of a drum do not rise, and its own scores say so."""
    rises = {}
    for name, mesh in {"drum": sj.objects.concrete_cylinder(0.1, 0.1, sides=12), "pile": sj.objects.target()}.items():
        found = TargetSearch(mesh, SONAR, SearchConfig(yaw_bins=12))
        image = np.asarray(sj.render(mesh, sj.Pose(x=2.5, yaw=math.radians(90)), SONAR).semantic())
        match = found.find_near(5, image)
        evidence = curve_evidence(Candidate(found, match, *found.place(match)), None)
        rises[name] = evidence["map_rise"], evidence["own_rise"]
    assert rises["drum"] == pytest.approx((0.0, 0.0), abs=0.01)
    assert 0.1 < rises["pile"][0] < rises["pile"][1]  # shifted, other yaws match better: its own scores leave that out


@pytest.mark.slow
def test_finer_bins_leave_the_own_rise_as_it_is() -> None:
    """The rule decides by it: twice as many bins must not make a pile look like a drum."""
    found = {}
    for bins in (36, 72):
        search = TargetSearch(sj.objects.target(), SONAR, SearchConfig(yaw_bins=bins))
        image = np.asarray(sj.render(search.mesh, sj.Pose(x=2.5, yaw=0.9), SONAR).semantic())
        match = search.find_near(5, image)
        found[bins] = curve_evidence(Candidate(search, match, *search.place(match)), None)
    assert found[36]["own_rise"] > FULL_RISE
    for name in ("own_rise", "map_rise"):
        assert found[72][name] == pytest.approx(found[36][name], rel=0.25)


def test_a_bank_says_that_its_object_is_out_of_view() -> None:
    with pytest.raises(OutOfViewError, match="an object at x 50.00 m, y 0.00 m is outside the sonar's view"):
        sj.template_bank(sj.objects.brick(), SONAR, [0.0], x=50.0)


def test_a_target_whose_highlight_was_not_measured_is_not_found() -> None:
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), n_ranges=128)
    sonar = sonar.replace(azimuth=sonar.azimuth[40:56])
    mesh = sj.Mesh.from_arrays(*sj.objects.box((0.2, 0.1, 0.1), (0.0, 0.0, 0.05)))
    searched = TargetSearch(mesh, sonar, SearchConfig(yaw_bins=8))
    frame = sj.render(mesh, sj.Pose(x=float(searched.distances[4])), sonar)
    image, mask = np.asarray(frame.semantic()), np.asarray(frame.highlight) < 0.01
    assert searched.find_near(4, image, np.ones(mask.shape, bool)).scores.max() > 0.9
    assert searched.find_near(4, np.where(mask, image, np.nan), mask).scores.max() < 0.8
