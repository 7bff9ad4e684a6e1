"""What the network is shown: ranks do not change with the display law, and have the right derivative."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import rankdata

from sonarjax.segment.inputs import network_input, ranks

IMAGE = np.round(255 * np.random.default_rng(3).gamma(2.0, 0.12, (128, 128)).clip(0, 1)).astype(np.float32) / 255


def test_ranks_are_those_of_scipy() -> None:
    expected = (rankdata(IMAGE, method="average").reshape(IMAGE.shape) - 0.5) / IMAGE.size
    assert np.asarray(ranks(jnp.asarray(2 * IMAGE - 1))) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("law", [np.sqrt, np.square, lambda v: np.log1p(20 * v) / np.log(21)])
def test_a_display_law_does_not_change_ranks(law) -> None:
    shown = law(IMAGE).astype(np.float32)
    before, after = (np.asarray(ranks(jnp.asarray(2 * v - 1))) for v in (IMAGE, shown))
    assert np.abs(before - after).mean() < 4e-3
    assert np.abs(IMAGE - shown).mean() > 0.05


def test_two_channels_and_one() -> None:
    image = jnp.asarray(2 * IMAGE - 1)[None, ..., None]
    assert network_input(image, "grey") is image
    shown = np.asarray(network_input(image, "ranks"))
    assert shown.shape == (1, 128, 128, 2) and np.abs(shown).max() <= 1
    brighter = np.asarray(network_input(0.5 * image + 0.2, "ranks"))
    assert np.abs(brighter - shown).mean() < 0.02  # gain and offset change neither channel


def test_an_even_image_is_in_the_middle() -> None:
    assert np.asarray(network_input(jnp.zeros((1, 8, 8, 1)), "ranks")) == pytest.approx(0.0, abs=1e-6)


def test_derivative_agrees_with_finite_differences() -> None:
    image = jnp.asarray(np.random.default_rng(0).uniform(-0.9, 0.9, (6, 5)), jnp.float32)
    weights = jnp.asarray(np.random.default_rng(1).normal(size=(6, 5)), jnp.float32)

    def total(v: jax.Array) -> jax.Array:
        return (weights * ranks(v)).sum() * 100

    along = jnp.asarray(np.random.default_rng(2).normal(size=(6, 5)), jnp.float32)
    step = 2e-5  # far below the width of a level: no pixel passes from one to the next
    numeric = (total(image + step * along) - total(image - step * along)) / (2 * step)
    assert float(jnp.vdot(jax.grad(total)(image), along)) == pytest.approx(float(numeric), rel=0.05)
