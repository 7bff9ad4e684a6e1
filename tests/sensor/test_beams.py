"""Beam pattern, crosstalk, streaks, gains and the display against closed forms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from sonarjax.sensor import array_pattern, beam_gains, beam_mixing, compress, crosstalk_mixing, quantise, streaks
from sonarjax.sonar import Sonar

WIDTH = math.radians(0.3)


def pattern(offset: float) -> float:
    return float(array_pattern(jnp.float32(offset), WIDTH))


def test_beam_is_as_wide_as_it_says() -> None:
    half = brentq(lambda offset: pattern(offset) - 0.5, 0.3 * WIDTH, 0.7 * WIDTH)
    assert 2 * half == pytest.approx(WIDTH, rel=2e-3)


def test_first_side_lobe_is_that_of_sinc() -> None:
    zero = math.asin(WIDTH / 0.8859)
    assert pattern(zero) < 1e-7
    lobe = minimize_scalar(lambda offset: -pattern(offset), bounds=(1.1 * zero, 1.9 * zero), method="bounded")
    assert 10 * math.log10(-lobe.fun) == pytest.approx(-13.26, abs=0.01)
    assert lobe.x == pytest.approx(1.4303 * zero, rel=1e-2)  # tan u = u at u = 1.4303π


def test_two_ways_double_the_decibels() -> None:
    sonar = Sonar.preset("didson-hf")
    once, twice = (np.asarray(beam_mixing(sonar, 2.0, ways), np.float64)[48] for ways in (1.0, 2.0))
    assert (twice / twice[48])[40:57] == pytest.approx(((once / once[48]) ** 2)[40:57], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("name", ["didson-hf", "aris-3000", "oculus"])
def test_mixing_keeps_an_even_floor_even(name: str) -> None:
    sonar = Sonar.preset(name)
    for matrix in (beam_mixing(sonar, 1.3, 1.5), crosstalk_mixing(sonar.n_beams, 0.05, 8.0)):
        assert np.asarray(matrix).sum(axis=1) == pytest.approx(1.0, abs=1e-5)
        assert np.asarray(matrix).min() >= 0


def test_mixing_follows_an_uneven_table() -> None:
    """Weights relative to the own beam are the pattern at the table's own angles, times the source's width."""
    sonar = Sonar.preset("aris-3000").replace(beam_width=math.radians(0.4))
    matrix = np.asarray(beam_mixing(sonar, 1.0, 1.0), np.float64)
    azimuth, spacing = np.asarray(sonar.azimuth, np.float64), np.diff(np.asarray(sonar.azimuth_edges, np.float64))
    for beam in (3, 64, 120):
        u = 0.8859 * np.sin(azimuth[beam] - azimuth) / math.radians(0.4)
        expected = np.sinc(u) ** 2 * spacing
        assert matrix[beam] == pytest.approx(expected / expected.sum(), abs=1e-5)


def test_crosstalk_is_a_comb_of_the_group_s_period() -> None:
    row = np.asarray(crosstalk_mixing(96, 0.1, 8.0), np.float64)[40]
    row = row / row[40]
    assert np.flatnonzero(row > 1e-9).tolist() == list(range(0, 96, 8))
    assert row[[32, 48, 24, 56, 16]] == pytest.approx([0.1, 0.1, 0.05, 0.05, 0.025], rel=1e-5)


def test_streak_lights_the_glint_s_row_only() -> None:
    image = jnp.full((20, 10), 0.1).at[5, 3].set(100.0).at[12, 4].set(1.0)
    highlight = jnp.zeros((20, 10)).at[5, 3].set(1.0).at[12, 4].set(1.0)
    added = np.asarray(streaks(image, highlight, 0.01) - image)
    assert added[5] == pytest.approx(1.0, rel=1e-4)  # 1 % of the glint, in every beam
    assert added[12] == pytest.approx(1e-4, rel=0.05)  # 1 % of a pixel that is 1 % of the glint
    assert np.abs(np.delete(added, [5, 12], axis=0)).max() < 1e-6


def test_streaks_of_a_frame_without_an_object_have_a_derivative() -> None:
    image, nothing = jnp.ones((8, 4)), jnp.zeros((8, 4))
    added, slope = jax.jvp(lambda level: streaks(image, nothing, level), (0.01,), (1.0,))
    np.testing.assert_array_equal(added, image)
    np.testing.assert_array_equal(slope, 0.0)
    along = jax.jvp(lambda v: streaks(v, nothing, 0.01), (image,), (image,))[1]
    np.testing.assert_array_equal(along, image)


def test_beam_gains_spread_by_decibels(key: jax.Array) -> None:
    decibels = 10 * np.log10(np.asarray(beam_gains(20_000, 0.5, key=key)))
    assert decibels.std() == pytest.approx(0.5, rel=0.02)
    assert decibels.mean() == pytest.approx(0.0, abs=0.02)


def test_compression_in_decibels_and_in_powers() -> None:
    energy = jnp.array([1.0, 10.0, 100.0, 1e4])  # white lies 20 dB above 1
    assert np.asarray(compress(energy, 20.0, 1.0, 40.0, 0.25)) == pytest.approx([0.5, 0.75, 1.0, 1.0], abs=1e-5)
    root = [0.01**0.25, 0.1**0.25, 1.0, 1.0]
    assert np.asarray(compress(energy, 20.0, 0.0, 40.0, 0.25)) == pytest.approx(root, abs=1e-5)
    blend = 0.5 * (np.array([0.5, 0.75, 1.0, 1.0]) + root)
    assert np.asarray(compress(energy, 20.0, 0.5, 40.0, 0.25)) == pytest.approx(blend, abs=1e-5)
    assert float(compress(jnp.float32(0.0), 20.0, 1.0, 40.0, 0.25)) == 0.0


def test_quantisation_is_eight_bits_with_a_straight_slope(rng: np.random.Generator) -> None:
    image = jnp.asarray(rng.uniform(size=5000), jnp.float32)
    stored = np.asarray(quantise(image))
    assert np.abs(255 * stored - np.rint(255 * stored)).max() < 1e-4
    assert np.abs(stored - np.asarray(image)).max() <= 0.5 / 255 + 1e-6
    assert np.unique(stored).size == 256
    assert np.all(np.asarray(jax.grad(lambda v: quantise(v).sum())(image)) == 1.0)
