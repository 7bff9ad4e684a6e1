"""Sets of yaws: modes with weights and disjoint intervals, against scipy's and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, vonmises

from sonarjax.io import SonarjaxError
from sonarjax.recognition import Hypothesis, Recognition
from sonarjax.refine import YAW_WEIGHTS, YawMode, YawSet, YawWeights, make_yaw_set, merged, shares
from sonarjax.results import record_of
from tests.track.measurements import found

DEG = math.pi / 180
BINS = np.arange(36) * 10 * DEG
ONE_PEAK = -np.abs(np.arange(36) - 6.0)
PLAIN = YawWeights(softness=0.01, slope=0.5, unrefined=0.0, tail=0.0, tail_scale=1.0)


def widths(allowed, coverage):
    return [one.high - one.low for one in allowed.intervals(coverage)]


@pytest.mark.parametrize("coverage", [0.5, 0.68, 0.95, 0.99])
@pytest.mark.parametrize("yaw", [0.0, 0.001, 3.0, 6.28])
def test_one_mode_gives_the_interval_of_a_normal_distribution(coverage, yaw):
    (one,) = YawSet((YawMode(yaw, 0.01, 1.0),)).intervals(coverage)
    half = 0.01 * norm.ppf((1 + coverage) / 2)
    assert one.high - one.low == pytest.approx(2 * half, rel=0.04)
    assert math.remainder(one.low + half - yaw, 2 * math.pi) == pytest.approx(0.0, abs=0.001)
    assert one.weight == pytest.approx(coverage, abs=0.02)
    assert 0 <= one.low < 2 * math.pi


def test_two_equal_modes_give_two_disjoint_intervals():
    allowed = YawSet((YawMode(1.0, 0.02, 0.5), YawMode(1.0 + math.pi, 0.02, 0.5)))
    found = allowed.intervals(0.68)
    assert len(found) == 2
    assert widths(allowed, 0.68) == pytest.approx([2 * 0.02 * norm.ppf(0.84)] * 2, rel=0.05)
    assert [one.weight for one in found] == pytest.approx([0.34, 0.34], abs=0.02)
    assert allowed.holds(1.0, 0.68) and allowed.holds(1.0 + math.pi, 0.68) and not allowed.holds(1.0 + math.pi / 2)


def test_the_set_is_that_of_highest_density():
    """Two normal distributions of other widths and weights: the level is found by root finding with scipy."""
    parts = [(2.0, 0.01, 0.7), (5.0, 0.03, 0.3)]

    def reach(level):  # half-widths of the set above a density
        inside = [2 * math.log(w / (s * math.sqrt(2 * math.pi)) / level) for _, s, w in parts]
        return [s * math.sqrt(max(v, 0.0)) for (_, s, _), v in zip(parts, inside, strict=True)]

    def held(level):
        both = zip(parts, reach(level), strict=True)
        return sum(w * (2 * norm.cdf(half / s) - 1) for (_, s, w), half in both)

    level = brentq(lambda v: held(v) - 0.9, 1e-3, 20.0)
    found = YawSet(tuple(YawMode(*part) for part in parts)).intervals(0.9)
    assert [one.high - one.low for one in found] == pytest.approx([2 * half for half in reach(level)], rel=0.05)


def test_density_is_that_of_a_wrapped_normal_distribution_with_tails():
    at = np.linspace(0, 2 * math.pi, 2001)
    wide = YawSet((YawMode(6.2, 0.05, 1.0),), tail=0.2, tail_scale=3.0)
    assert np.trapezoid(wide.density(at), at) == pytest.approx(1.0, abs=1e-3)
    off = np.remainder(at - 6.2 + math.pi, 2 * math.pi) - math.pi
    expected = 0.8 * norm.pdf(off, scale=0.05) + 0.2 * norm.pdf(off, scale=0.15)
    np.testing.assert_allclose(wide.density(at), expected, atol=1e-6)
    narrow = YawSet((YawMode(1.0, 0.1, 1.0),)).density(at)
    np.testing.assert_allclose(narrow, vonmises.pdf(at, 100.0, loc=1.0), atol=0.04)


def test_truth_drawn_from_a_set_is_in_it_as_often_as_it_says():
    rng = np.random.default_rng(0)
    allowed = YawSet((YawMode(0.1, 0.02, 0.6), YawMode(3.2, 0.05, 0.4)))
    first = rng.random(2000) < 0.6
    truth = np.where(first, rng.normal(0.1, 0.02, 2000), rng.normal(3.2, 0.05, 2000))
    for coverage in (0.68, 0.95):
        inside = np.zeros(2000, bool)
        for one in allowed.intervals(coverage):
            inside |= (truth - one.low) % (2 * math.pi) <= one.high - one.low
        assert inside.mean() == pytest.approx(coverage, abs=0.03)


def test_nothing_known_is_the_whole_circle():
    allowed = make_yaw_set([1.0], [math.inf], [0.5], ONE_PEAK, BINS, PLAIN)
    assert sum(widths(allowed, 0.95)) > 0.85 * 2 * math.pi


@pytest.mark.parametrize("coverage", [0.0, 1.0, -1.0, math.nan])
def test_a_coverage_that_is_no_share_is_refused(coverage):
    with pytest.raises(SonarjaxError, match="coverage: expected a share between 0 and 1"):
        YawSet((YawMode(1.0, 0.1, 1.0),)).intervals(coverage)


def test_weights_follow_the_scores():
    allowed = make_yaw_set([1.0, 4.0], [0.01, 0.01], [0.9, 0.9 - 0.01], ONE_PEAK, BINS, PLAIN)
    assert [mode.weight for mode in allowed.modes] == pytest.approx([math.e / (1 + math.e), 1 / (1 + math.e)])
    assert shares(np.array([0.5, 0.5]), 0.01).tolist() == [0.5, 0.5]


def test_peaks_that_nobody_refined_are_modes_as_wide_as_a_bin():
    """A box whose bank has four peaks, of which two were refined."""
    curve = 0.5 + 0.2 * np.cos(4 * BINS)
    allowed = make_yaw_set([0.0, math.pi], [0.01, 0.01], [0.9, 0.9], curve, BINS, PLAIN)
    yaws = sorted(round(math.degrees(mode.yaw)) % 360 for mode in allowed.modes)
    assert yaws == [0, 90, 180, 270]
    assert [mode.weight for mode in allowed.modes] == pytest.approx([0.25] * 4)
    assert sorted(mode.yaw_std for mode in allowed.modes) == pytest.approx(
        [0.01, 0.01, *[10 * DEG / math.sqrt(12)] * 2]
    )


@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_round_object_leaves_all_yaws_open(noise):
    curve = 0.8 + noise * np.random.default_rng(0).normal(size=36)
    allowed = make_yaw_set([0.1], [0.1], [0.7], curve, BINS, YAW_WEIGHTS)
    assert sum(widths(allowed, 0.95)) > 0.85 * 2 * math.pi
    assert max(mode.weight for mode in allowed.modes) < 0.15


def test_a_flat_top_is_allowed_and_its_slopes_are_not():
    off = np.abs(np.arange(36) - 18)
    allowed = make_yaw_set([math.pi], [0.05], [0.7], 0.8 - 0.1 * np.maximum(off - 4, 0), BINS, PLAIN)
    inside = [np.rad2deg([one.low, one.high]) for one in allowed.intervals(0.95)]
    assert min(low for low, _ in inside) == pytest.approx(137, abs=5)
    assert max(high for _, high in inside) == pytest.approx(223, abs=5)
    assert sum(high - low for low, high in inside) > 60


def test_a_bump_on_a_slope_does_not_open_the_slope():
    curve = 0.8 - 0.01 * np.abs(np.arange(36) - 18.0)
    curve[15:17] = 0.7705, 0.77
    allowed = make_yaw_set([math.pi], [0.01], [0.7], curve, BINS, YAW_WEIGHTS)
    assert not any(math.radians(195) < mode.yaw < math.radians(215) for mode in allowed.modes)


def test_modes_that_overlap_are_one_with_the_mixture_s_moments():
    (one,) = merged([YawMode(6.25, 0.02, 0.3), YawMode(0.05, 0.03, 0.7)])
    gap = math.remainder(0.05 - 6.25, 2 * math.pi)
    assert one.weight == pytest.approx(1.0)
    assert one.yaw == pytest.approx((6.25 + 0.7 * gap) % (2 * math.pi))
    assert one.yaw_std**2 == pytest.approx(0.3 * 0.02**2 + 0.7 * 0.03**2 + 0.21 * gap**2)
    assert len(merged([YawMode(1.0, 0.02, 0.5), YawMode(1.3, 0.02, 0.5)])) == 2
    assert len(merged([YawMode(1.0, 0.02, 0.4), YawMode(1.3, 0.02, 0.2), YawMode(1.1, 0.4, 0.41)])) == 1


def test_shipped_weights_are_sound():
    assert YAW_WEIGHTS.softness > 0 and YAW_WEIGHTS.slope >= 0 and 0 <= YAW_WEIGHTS.tail < 1 < YAW_WEIGHTS.tail_scale


def test_a_frame_found_without_the_bank_has_no_set():
    """A stream's next frame is refined from the last one's pose: there is no curve over yaw."""
    one = Hypothesis(1.0, 0.8, 0.01, True)
    found = Recognition(
        identified=True, target="target", score=0.9, score_bank=math.nan, score_refined=0.8, threshold=0.5,
        runner_up=None, margin=None, yaw_bin=math.nan, yaw=1.0, yaw_std=0.01, x=2.0, y=0.0, converged=True,
        scores_by_yaw=ONE_PEAK, hypotheses=(one,), segmenter="none", semantic=np.zeros((2, 2)),
    )  # fmt: skip
    without = replace(found, scores_by_yaw=np.empty(0))
    assert without.yaw_set is None and record_of(without, "a.npy", 0.1)["yaw_set"] is None
    with_curve = replace(found, yaw_bin=1.0).yaw_set
    assert with_curve is not None and with_curve.modes[0].yaw == pytest.approx(1.0)


def test_the_set_of_a_frame_has_the_banks_other_peaks_where_they_are():
    curve = np.full(36, 0.2)
    curve[[3, 12]] = 0.8, 0.79  # the second peak lies 90 degrees to port of the best
    best = math.radians(50.0)  # of a bank turned by the bearing
    seen = replace(found([best]), yaw_bin=best, scores_by_yaw=curve)
    yaws = sorted(math.degrees(mode.yaw) for mode in seen.yaw_set.modes if mode.weight > 0.01)
    assert yaws == pytest.approx([50.0, 140.0], abs=0.5)
