"""The belief's step against the textbook's Kalman filter, circular yaw, hypotheses kept apart, known sonar poses."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.track import (
    Standing,
    TrackConfig,
    Turning,
    measurement_of,
    modes_of,
    next_belief,
    nothing_known,
    numbers_of,
)
from sonarjax.track.belief import predicted, run_filter
from sonarjax.track.measurement import each_of, probability
from sonarjax.track.smooth import run_smoother
from tests.track.measurements import STD, Reader, found

# One Gaussian for each hypothesis, with the whole of its error bar; hardly any misses.
PLAIN = TrackConfig(yaw_scale=1.0, tail=1e-6, misses=1e-6, floor=1e-4, place_floor=1e-5)


def after(recognitions, motion=Standing(), config=PLAIN, poses=None) -> sj.Tracker:  # noqa: B008
    tracker = sj.Tracker(Reader(), motion, config=config)
    for k, one in enumerate(recognitions):
        tracker.take(one, sonar_pose=None if poses is None else poses[k])
    return tracker


def best(tracker: sj.Tracker):
    return modes_of(tracker.belief)[0]


def off(yaw: float, true: float) -> float:
    return (yaw - true + math.pi) % (2 * math.pi) - math.pi


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_views_of_a_standing_object_average_out_down_to_the_floor(count, rng):
    """The mean of n measurements, of variance scale² std² / n + floor²."""
    config = TrackConfig(yaw_scale=0.7, tail=1e-6, misses=1e-6, floor=math.radians(0.5))
    yaws = 1.0 + STD * rng.standard_normal(count)
    mode = best(after([found([yaw]) for yaw in yaws], config=config))
    assert off(mode.yaw, yaws.mean()) == pytest.approx(0.0, abs=1e-4)
    assert mode.yaw_std == pytest.approx(math.hypot(0.7 * STD / math.sqrt(count), math.radians(0.5)), rel=2e-3)
    assert mode.probability == pytest.approx(
        0.95 if count == 1 else 1.0, abs=0.01
    )  # what the first frame says of itself


def textbook(yaws, motion: Turning, std: float):
    """Mean and covariance of (yaw, rate) by the Kalman filter of any book, from a yaw of which nothing is known."""
    mean = np.array([yaws[0], 0.0])
    spread = np.diag([std**2, motion.rate_std**2])
    goes = np.array([[1.0, 1.0], [0.0, 1.0]])
    drift = np.diag([motion.yaw_drift**2, motion.rate_drift**2])
    for yaw in yaws[1:]:
        mean, spread = goes @ mean, goes @ spread @ goes.T + drift
        gain = spread[:, 0] / (spread[0, 0] + std**2)
        mean = mean + gain * (yaw - mean[0])
        spread = spread - np.outer(gain, spread[0])
    return mean, spread


def test_one_hypothesis_is_the_textbooks_kalman_filter(rng):
    motion = Turning(rate_std=math.radians(6.0), rate_drift=math.radians(0.4), yaw_drift=math.radians(0.7))
    yaws = 0.4 + math.radians(3.0) * np.arange(12) + STD * rng.standard_normal(12)
    mode = best(after([found([yaw]) for yaw in yaws], motion))
    mean, spread = textbook(yaws, motion, STD)
    assert [mode.yaw, mode.rate] == pytest.approx(mean, abs=3e-4)
    assert mode.covariance[np.ix_([0, 3], [0, 3])] == pytest.approx(spread, rel=2e-2, abs=1e-7)


@pytest.mark.parametrize("yaw_drift", [0.0, math.radians(0.7)])
@pytest.mark.parametrize("gap", [1, 2, 7])
def test_a_gap_is_as_many_missed_frames(gap, yaw_drift):
    """The rate's random walk turns the object during a gap too."""
    motion = Turning(rate_drift=math.radians(1.0), yaw_drift=yaw_drift)
    seen = [found([1.0 + 0.05 * k]) for k in range(6)]
    missed, later = after([*seen, *[None] * gap], motion), after(seen, motion)
    (ahead,) = later.expected(elapsed=float(gap))
    later.take(None, elapsed=float(gap))
    for mode in (ahead, best(later)):
        np.testing.assert_allclose(mode.covariance, best(missed).covariance, rtol=2e-3, atol=1e-8)
        assert mode.yaw_std == pytest.approx(best(missed).yaw_std, rel=1e-2)  # which components merged differs


def test_smoothing_over_a_gap_is_smoothing_over_missed_frames():
    """A gap after two frames with a hypothesis, and one after a frame that showed nothing and had none before it."""
    motion = Turning(rate_drift=math.radians(1.0), yaw_drift=0.0)
    ways = []
    for missed, gap in ((3, 1.0), (0, 4.0)):
        frames = [(None, 1.0)] * (1 + missed) + [(found([1.0]), gap), (found([1.1]), 1.0)]
        frames += [(None, 1.0)] * missed + [(found([1.4]), gap), (found([1.5]), 1.0)]
        tracker = sj.Tracker(Reader(), motion, config=PLAIN)
        beliefs = [tracker.take(one, elapsed=elapsed).belief for one, elapsed in frames]
        smoothed = run_smoother(jax.tree.map(lambda *v: jnp.stack(v), *beliefs), tracker.numbers)
        times = np.cumsum([0.0, *(elapsed for _, elapsed in frames[1:])])
        ways.append([modes_of(each_of(smoothed)[k])[0] for k in np.searchsorted(times, [0.0, 4.0, 5.0, 9.0])])
    for missed, once in zip(*ways, strict=True):
        assert off(once.yaw, missed.yaw) == pytest.approx(0.0, abs=1e-4)
        np.testing.assert_allclose(once.covariance, missed.covariance, rtol=0.02, atol=1e-7)


def test_less_than_a_frame_has_no_turn_by_a_drifting_rate():
    still = Turning(rate_std=0.0, rate_drift=0.1, yaw_drift=0.02)
    tracker = after([found([1.0])], still)
    (soon,) = tracker.expected(elapsed=0.5)
    assert soon.covariance[0, 0] == pytest.approx(best(tracker).covariance[0, 0] + 0.5 * 0.02**2, rel=1e-3)
    assert soon.covariance[0, 3] == 0.0


def test_a_turn_through_north_goes_on(rng):
    yaws = math.radians(340.0) + math.radians(5.0) * np.arange(20)
    tracker = after([found([yaw]) for yaw in yaws], Turning())
    mode = best(tracker)
    assert 0 <= mode.yaw < 2 * math.pi
    assert off(mode.yaw, yaws[-1]) == pytest.approx(0.0, abs=math.radians(0.5))
    assert mode.rate == pytest.approx(math.radians(5.0), abs=math.radians(0.5))
    around = best(after([found([yaw]) for yaw in (-0.02, 0.02, 2 * math.pi - 0.02, 0.02)]))
    assert off(around.yaw, 0.0) == pytest.approx(0.0, abs=1e-4)
    assert around.yaw_std < STD


# ---------------------------------------------------------------- several hypotheses


def test_two_yaws_are_kept_apart_until_a_frame_decides():
    both = [1.0, 1.0 + math.pi]
    tracker = after([found(both, [0.8, 0.8 - 0.0002 * (-1) ** k]) for k in range(100)], config=TrackConfig())
    modes = modes_of(tracker.belief)
    assert len(modes) == 2
    assert sorted(off(m.yaw, 1.0) % (2 * math.pi) for m in modes) == pytest.approx([0.0, math.pi], abs=0.01)
    assert min(m.probability for m in modes) > 0.4
    for _ in range(8):
        tracker.take(found(both, [0.75, 0.8]))
    assert off(best(tracker).yaw, both[1]) == pytest.approx(0.0, abs=0.01)
    assert best(tracker).probability > 0.99


def test_frames_that_find_one_of_two_equal_yaws_by_turns_do_not_decide():
    both = [1.0, 1.0 + math.pi]
    tracker = after([found([both[k % 2]], probability=0.4) for k in range(40)], config=TrackConfig())
    assert [m.probability > 0.05 for m in modes_of(tracker.belief)[:2]] == [True, True]


@pytest.mark.parametrize("wrong", [1, 5])
def test_frames_astray_do_not_move_a_belief(wrong):
    """Also where they agree with each other."""
    right = [found([1.0 + 0.001 * k]) for k in range(20)]
    tracker = after([*right, *[found([2.5], probability=0.6)] * wrong], config=TrackConfig())
    assert off(best(tracker).yaw, 1.01) == pytest.approx(0.0, abs=math.radians(0.5))


def test_an_object_that_is_turned_over_is_found_again():
    frames = [found([1.0])] * 100 + [found([2.5])] * 25
    assert off(best(after(frames, config=TrackConfig())).yaw, 2.5) == pytest.approx(0.0, abs=math.radians(0.5))


def test_an_unlikely_frame_says_little():
    """Of two single frames that disagree, the one that probably does not show the target counts for less."""
    sure, unsure = found([1.0], probability=0.9), found([3.0], probability=0.05)
    for frames in ([sure, unsure], [unsure, sure]):
        mode = best(after(frames, config=TrackConfig()))
        assert off(mode.yaw, 1.0) == pytest.approx(0.0, abs=0.01)
        assert mode.probability > 0.8


def test_a_missed_frame_widens_what_moves_and_nothing_else():
    seen = [found([1.0]), found([1.05]), found([1.1])]
    still, turning = after(seen[:1]), after(seen, Turning())
    before = [best(still), best(turning)]
    for tracker in (still, turning):
        tracker.take(None)
    assert best(still).yaw == pytest.approx(before[0].yaw)
    assert best(still).yaw_std == pytest.approx(before[0].yaw_std, rel=1e-3)
    assert best(still).probability == pytest.approx(before[0].probability, abs=1e-2)
    assert off(best(turning).yaw, before[1].yaw + before[1].rate) == pytest.approx(0.0, abs=1e-3)
    assert best(turning).yaw_std > 1.5 * before[1].yaw_std


# ---------------------------------------------------------------- known poses of the sonar


def moved(pose: sj.Pose, at: sj.Pose) -> tuple[float, float, float]:
    """Yaw, x, y of a pose of a sonar's frame in the frame in which that sonar is `at`: by complex numbers."""
    turn = np.exp(1j * float(at.yaw))
    place = complex(float(at.x), float(at.y)) + turn * complex(float(pose.x), float(pose.y))
    return float(pose.yaw) + float(at.yaw), place.real, place.imag


def test_a_belief_from_elsewhere_is_the_belief_moved():
    at = sj.Pose(1.0, -2.0, 2.2)
    frames = [found([1.0 + 0.01 * k], place=(2.0 + 0.003 * k, 0.1)) for k in range(4)]
    here, there = after(frames), after(frames, poses=[at] * 4)
    own = best(here)
    expected = moved(sj.Pose(own.x, own.y, own.yaw), at)
    mode = best(there)
    assert off(mode.yaw, expected[0]) == pytest.approx(0.0, abs=1e-4)
    assert [mode.x, mode.y] == pytest.approx(expected[1:], abs=1e-4)
    assert mode.yaw_std == pytest.approx(own.yaw_std, rel=1e-3)


def test_views_from_around_become_one_and_their_shared_errors_average_out():
    """An object at x 3, y 1, yaw 0.5; each place errs by its own amount, the range by the same everywhere."""
    config = TrackConfig(yaw_scale=0.2, tail=1e-6, misses=1e-6, floor=math.radians(1.0), aspect=math.radians(3.0))
    frames, poses = [], []
    for k in range(8):
        heading = k * math.pi / 4
        poses.append(sj.Pose(3.0 - 2.0 * math.cos(heading), 1.0 - 2.0 * math.sin(heading), heading))
        frames.append(found([0.5 - heading + math.radians((-1) ** k)], place=(2.01, 0.0)))
    around = best(after(frames, config=config, poses=poses))
    assert off(around.yaw, 0.5) == pytest.approx(0.0, abs=math.radians(0.3))
    assert [around.x, around.y] == pytest.approx([3.0, 1.0], abs=2e-3)
    one_place = best(after([frames[0]] * 8, config=config))
    assert one_place.yaw_std == pytest.approx(math.radians(1.0), rel=0.05)
    assert around.yaw_std == pytest.approx(math.radians(1.0) / math.sqrt(8), rel=0.1)


def test_what_is_expected_is_given_in_the_sonars_frame():
    tracker = after([found([1.0])] * 3)
    tracker.take(found([1.0]))
    at = sj.Pose(0.5, -0.3, 0.7)
    (start,) = tracker._starts(np.array([0.5, -0.3, 0.7]), 1.0)
    assert moved(start, at) == pytest.approx((1.0, 2.0, 0.1), abs=1e-3)


# ---------------------------------------------------------------- transformations


def measurements(config: TrackConfig, shift: float = 0.0):
    frames = [found([0.3 + shift + 0.1 * k, 3.0 - 0.2 * k], [0.8, 0.7]) for k in range(6)]
    rows = [measurement_of(one, 36, config, np.zeros(3), float(k > 0)) for k, one in enumerate(frames)]
    return jax.tree.map(lambda *v: jnp.stack(v), *rows)


def same(one, other) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)


def test_a_scan_and_a_batch_are_the_loop():
    config = TrackConfig(components=8)
    numbers, start = numbers_of(Turning(), config), nothing_known(config)
    many = [measurements(config, shift) for shift in (0.0, 0.4, 1.1)]
    looped = []
    for one in many:
        belief = start
        for row in each_of_measurements(one):
            belief = next_belief(belief, row, numbers)
        looped.append(belief)
    scanned = [jax.tree.map(lambda v: v[-1], run_filter(start, one, numbers)) for one in many]
    stacked = jax.tree.map(lambda *v: jnp.stack(v), *many)
    batch = jax.vmap(run_filter, in_axes=(None, 0, None))(start, stacked, numbers)
    for k, belief in enumerate(looped):
        same(summed(belief), summed(scanned[k]))
        same(summed(belief), summed(jax.tree.map(lambda v, k=k: v[k, -1], batch)))


def each_of_measurements(whole):
    return [jax.tree.map(lambda v, k=k: v[k], whole) for k in range(len(whole.elapsed))]


def summed(belief) -> list[float]:
    """What does not depend on the order of equal components."""
    weight = jnp.exp(belief.log_weight)
    return [weight.sum(), weight @ jnp.cos(belief.mean[:, 0]), weight @ belief.mean[:, 1], weight[0]]


def test_the_64_bit_mode_is_one_clear_error():
    config = TrackConfig(components=4)
    start, rows, numbers = nothing_known(config), measurements(config), numbers_of(Turning(), config)
    with jax.enable_x64(True), pytest.raises(sj.SonarjaxError, match="JAX_ENABLE_X64: expected it off"):
        run_filter(start, rows, numbers)


def test_weights_are_probabilities_and_covariances_stay_positive(rng):
    config = TrackConfig()
    numbers, belief = numbers_of(Turning(), config), nothing_known(config)
    for _ in range(60):
        yaws = rng.uniform(0, 2 * math.pi, 3)
        one = found(yaws, rng.uniform(0.3, 0.9, 3), probability=float(rng.uniform(0, 1)))
        belief = next_belief(belief, measurement_of(one, 36, config, np.zeros(3), 1.0), numbers)
        assert float(jnp.exp(belief.log_weight).sum()) == pytest.approx(1.0, abs=1e-4)
        alive = np.isfinite(np.asarray(belief.log_weight))
        alive[0] = False
        assert np.linalg.eigvalsh(np.asarray(belief.covariance, float)[alive]).min() > -1e-6
    assert all(np.isfinite(v).all() for v in (belief.mean, belief.covariance))


def test_beliefs_one_by_one():
    config = TrackConfig(components=4)
    beliefs = run_filter(nothing_known(config), measurements(config), numbers_of(Standing(), config))
    parts = each_of(beliefs)
    assert len(parts) == 6
    np.testing.assert_array_equal(parts[-1].mean, np.asarray(beliefs.mean[-1]))


def test_a_lowered_threshold_says_that_the_target_is_there():
    """Even odds at the threshold: p' = p (1 - t) / (p (1 - t) + t (1 - p))."""
    frame = found([1.0], probability=0.02)
    assert probability(replace(frame, threshold=0.5)) == pytest.approx(0.02)
    assert probability(replace(frame, threshold=0.02)) == pytest.approx(0.5)
    assert probability(replace(frame, threshold=0.0)) == 1.0
    bank = replace(frame, score_bank=frame.score)  # no rule made this score
    assert probability(replace(bank, identified=True)) > 0.5 > probability(replace(bank, identified=False))


def test_an_error_bar_holds_what_a_standard_deviation_does():
    """Of two Gaussians about one yaw, against the normal distribution's integral by a fine sum."""
    config = TrackConfig(components=3)
    belief = nothing_known(config)
    covariance = np.tile(np.eye(7, dtype=np.float32) * 1e-4, (3, 1, 1))
    covariance[2, 0, 0] = 9e-4
    belief = replace(belief, log_weight=jnp.log(jnp.array([0.0, 0.6, 0.4])), covariance=jnp.asarray(covariance))
    (mode,) = modes_of(belief)
    at = np.linspace(-0.2, 0.2, 40001)
    density = sum(w * np.exp(-((at / s) ** 2) / 2) / s for w, s in ((0.6, 0.01), (0.4, 0.03))) / math.sqrt(2 * math.pi)
    held = density[np.abs(at) <= mode.yaw_std].sum() * (at[1] - at[0])
    assert held == pytest.approx(0.6827, abs=1e-3)
    assert math.sqrt(mode.covariance[0, 0]) > mode.yaw_std


def test_no_probability_exceeds_one():
    """The weights are rounded to float32, and so is their sum."""
    belief = nothing_known(TrackConfig(components=3))
    weights = jnp.array([-jnp.inf, jnp.log(0.5), jnp.log(0.5) + 4e-7])
    (mode,) = modes_of(replace(belief, log_weight=weights))
    assert np.exp(np.asarray(weights, float)).sum() > 1.0, "nothing to see: the test would pass without the limit"
    assert mode.probability == 1.0


def test_a_place_drifts_alike_along_both_axes() -> None:
    tracker = after([found([1.0])], Standing(place_drift=0.02))
    before, (later,) = best(tracker), tracker.expected(elapsed=4.0)
    grown = np.diag(later.covariance - before.covariance)
    assert grown[[1, 2]] == pytest.approx([4 * 0.02**2] * 2, rel=1e-3)


def test_an_unknown_rate_parts_the_shared_errors_of_two_aspects() -> None:
    config, spread = TrackConfig(components=2), 0.05
    belief = nothing_known(config)
    belief = replace(belief, covariance=belief.covariance.at[:, 3, 3].set(spread**2))
    expected = predicted(belief, jnp.zeros(3), jnp.float32(2.0), numbers_of(Turning(), config))
    np.testing.assert_allclose(expected.transition[:, 4, 4], math.exp(-2 * spread / config.aspect), rtol=1e-4)


def test_later_evidence_fades_as_earlier_does() -> None:
    """One frame that shows two yaws alike, and a later one in which one of them is e times likelier."""
    both = [1.0, 1.0 + math.pi]
    tracker = sj.Tracker(Reader(), config=replace(PLAIN, memory=1.0))
    beliefs = [tracker.take(found(both, scores)).belief for scores in ([0.8, 0.8], [0.8, 0.79])]
    smoothed = run_smoother(jax.tree.map(lambda *v: jnp.stack(v), *beliefs), tracker.numbers)
    first, second = modes_of(each_of(smoothed)[0])
    assert first.yaw == pytest.approx(1.0, abs=1e-3)
    assert math.log(first.probability / second.probability) == pytest.approx(math.exp(-1), abs=0.02)
