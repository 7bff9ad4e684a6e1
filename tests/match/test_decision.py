"""Eq. 5 and the peaks of score curves whose answer is known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import peak_prominences

from sonarjax.match import between_bins, decide, peaks
from sonarjax.match.decision import prominence

YAWS = jnp.deg2rad(jnp.arange(0.0, 360.0, 10.0))


def test_decide_reports_the_best_bin_either_way() -> None:
    scores = 0.5 + 0.2 * jnp.cos(YAWS - YAWS[7])
    yes, no = decide(scores, YAWS, 0.69), decide(scores, YAWS, 0.71)
    assert bool(yes.identified)
    assert not bool(no.identified)
    assert int(yes.yaw_bin) == int(no.yaw_bin) == 7
    assert float(yes.yaw) == pytest.approx(np.deg2rad(70))
    assert float(yes.score) == pytest.approx(0.7)
    with pytest.raises(AttributeError):
        yes.score = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("at", [6.8, 7.0, 7.3, 35.6])
def test_a_peak_between_bins_is_found_by_its_parabola(at: float) -> None:
    scores = np.asarray(0.5 + 0.2 * jnp.cos(YAWS - np.deg2rad(10 * at)))
    best = int(scores.argmax())
    assert (best + between_bins(scores, best)) % 36 == pytest.approx(at, abs=0.01)
    assert between_bins(np.ones(36), 3) == 0.0


def test_a_symmetric_curve_gives_two_hypotheses() -> None:
    found = peaks(0.5 + 0.2 * jnp.cos(2 * (YAWS - YAWS[3])) + 0.01 * jnp.cos(YAWS - YAWS[3]), YAWS)
    assert found.valid.tolist() == [True, True, False, False]
    np.testing.assert_array_equal(found.yaw_bin[:2], [3, 21])
    assert found.score[0] > found.score[1]
    assert np.isnan(found.yaw[2])
    assert found.score[2] == -np.inf


def test_a_peak_at_the_seam_is_found_once() -> None:
    scores = 0.5 + 0.2 * jnp.cos(YAWS)
    found = peaks(scores.at[35].set(scores[0]), YAWS)
    assert found.valid.tolist() == [True, False, False, False]
    assert int(found.yaw_bin[0]) == 0


def test_small_low_and_near_bumps_are_left_out() -> None:
    scores = 0.5 + 0.2 * jnp.cos(YAWS)
    assert int(peaks(scores.at[9].add(0.045), YAWS).valid.sum()) == 1  # rises 0.01 over its saddle
    assert int(peaks(scores.at[18].add(0.1), YAWS).valid.sum()) == 1  # 0.4 of at most 0.7
    near = scores.at[1].add(-0.1)  # bins 0 and 2 are 20° apart
    assert int(peaks(near, YAWS, min_separation=0.2).valid.sum()) == 2
    assert int(peaks(near, YAWS).valid.sum()) == 1


def test_a_flat_or_negative_curve_still_has_its_best_bin() -> None:
    for scores in (jnp.zeros(36), jnp.full(36, -0.2), -0.5 + 0.1 * jnp.cos(YAWS)):
        found = peaks(scores, YAWS)
        assert bool(found.valid[0])
        assert int(found.valid.sum()) == 1
        assert int(found.yaw_bin[0]) == int(jnp.argmax(scores))


def test_prominence_equals_scipy() -> None:
    rng = np.random.default_rng(1)
    scores = rng.random(40).astype(np.float32)
    start = int(np.argmax(scores))
    unrolled = np.concatenate([np.roll(scores, -start), scores[start : start + 1]])  # from the summit round to itself
    inner = [k for k in range(1, 40) if unrolled[k] > max(unrolled[k - 1], unrolled[k + 1])]
    expected = peak_prominences(unrolled, inner)[0]
    ours = np.asarray(prominence(jnp.asarray(scores)))
    np.testing.assert_allclose(np.roll(ours, -start)[inner], expected, atol=1e-6)
    assert ours[start] == pytest.approx(scores.max() - scores.min())


def test_jit_and_vmap() -> None:
    curves = jnp.stack([0.5 + 0.2 * jnp.cos(n * YAWS) for n in (1, 2, 3)])
    found = jax.jit(jax.vmap(lambda s: peaks(s, YAWS)))(curves)
    np.testing.assert_array_equal(found.valid.sum(axis=1), [1, 2, 3])
    decided = jax.vmap(lambda s: decide(s, YAWS, 0.6))(curves)
    np.testing.assert_array_equal(decided.yaw_bin, [0, 0, 0])
