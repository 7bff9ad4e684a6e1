"""Footprints in range bins, held to a dense count of what lies inside the intervals."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render.rasterise import (
    covered,
    covered_and_spread,
    covered_by_each,
    covered_by_two,
    ramp,
    rasterised,
    spread,
)

ROWS, SLABS, ITEMS, OWNERS = 80, 5, 4, 3
EACH = jnp.eye(SLABS)
"""Every slab is a beam of its own."""
STEPS = 400
"""Points of a bin, and azimuths of a slab, that are counted."""


@pytest.fixture
def spans(rng):
    """Ends [bins], sweeps [bins], presence and owners; what is absent has no number for its ends."""
    near = rng.uniform(-2, ROWS, (SLABS, ITEMS))
    middle = np.stack([near, near + rng.uniform(0.5, 6, near.shape)], axis=1)
    half = rng.uniform(-3, 3, middle.shape)
    present = rng.uniform(size=near.shape) < 0.8
    middle = np.where(present[:, None], middle, np.nan)
    return middle, half, present, rng.integers(0, OWNERS, near.shape)


def counted(middle: np.ndarray, half: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Share (range, slab) of each bin that all intervals of a slab cover together, by counting."""
    shares = np.zeros((ROWS, SLABS))
    at = (np.arange(STEPS) + 0.5) / STEPS
    for slab in range(SLABS):
        for item in np.flatnonzero(present[slab]):
            ends = middle[slab, :, item] + (2 * at[:, None] - 1) * half[slab, :, item]  # (azimuth, 2)
            edges = np.clip(np.arange(ROWS + 1)[:, None], *ends.T)
            shares[:, slab] += np.where(ends[:, 0] < ends[:, 1], np.diff(edges, axis=0), 0).mean(axis=1)
    return np.clip(shares, 0, 1)


def test_each_owner_covers_what_a_count_finds(spans):
    middle, half, present, owner = spans
    half = np.sign(half) * np.minimum(np.abs(half), (middle[:, 1] - middle[:, 0])[:, None] / 2)  # ends keep their order
    together, apart = covered_by_each(
        *map(jnp.asarray, (middle, half, present)), EACH, ROWS, jnp.asarray(owner), OWNERS
    )
    np.testing.assert_allclose(together, counted(middle, half, present), atol=5e-3)
    for one in range(OWNERS):
        np.testing.assert_allclose(apart[one], counted(middle, half, present & (owner == one)), atol=5e-3)


def test_all_owners_together_cover_what_one_pass_finds(spans):
    middle, half, present, owner = spans
    together, apart = covered_by_each(
        *map(jnp.asarray, (middle, half, present)), EACH, ROWS, jnp.asarray(owner), OWNERS
    )
    np.testing.assert_allclose(together, covered(*map(jnp.asarray, (middle, half, present)), EACH, ROWS), atol=1e-5)
    assert np.isfinite(apart).all() and (np.asarray(apart).max(axis=(1, 2)) > 0.5).all()


def test_two_lists_in_one_pass_cover_what_each_covers_by_itself(spans):
    middle, half, present, _ = map(jnp.asarray, spans)
    first = middle, half, present
    second = tuple(values[..., :2] for values in (middle[:, :, ::-1] + 3.3, half, present[:, ::-1]))
    for found, one in zip(covered_by_two(first, second, EACH, ROWS), (first, second), strict=True):
        np.testing.assert_allclose(found, covered(*one, EACH, ROWS), atol=1e-5)
        assert 0.02 < np.mean(found) < 0.9


def test_density_is_spread_over_what_its_span_covers(spans):
    middle, half, present, _ = spans
    half = np.sign(half) * np.minimum(np.abs(half), (middle[:, 1] - middle[:, 0])[:, None] / 2)
    density = np.where(present, np.arange(1.0, ITEMS + 1), 0.0)
    together, echo = covered_and_spread(*map(jnp.asarray, (middle, half, present)), EACH, ROWS, jnp.asarray(density))
    each = [counted(middle, half, present & (np.arange(ITEMS) == item)) for item in range(ITEMS)]
    np.testing.assert_allclose(together, counted(middle, half, present), atol=5e-3)
    np.testing.assert_allclose(echo, sum((k + 1) * one for k, one in enumerate(each)), atol=2e-2)
    alone = spread(jnp.asarray(middle), jnp.asarray(half), EACH, ROWS, jnp.asarray(density))
    np.testing.assert_allclose(alone, echo, atol=1e-6)


def test_bins_that_no_span_touches_are_dark():
    """Rows are taken in parts, and those without a span are skipped: ends of spans lie on both sides of a border."""
    middle = jnp.array([[[31.0], [33.0]], [[64.0], [64.5]], [[10.0], [75.0]]])
    shares = [
        covered(one, jnp.zeros_like(one), jnp.ones((1, 1), bool), jnp.eye(1), ROWS)[:, 0] for one in middle[:, None]
    ]
    expected = np.zeros((3, ROWS))
    expected[0, 31:33], expected[1, 64], expected[2, 10:75] = 1.0, 0.5, 1.0
    np.testing.assert_allclose(shares, expected, atol=5e-4)


@pytest.mark.parametrize("rows", [1, 2, 31])
def test_fewer_bins_than_are_taken_at_a_time(spans, rows):
    middle, half, present, _ = (jnp.asarray(v) for v in spans)
    few, all_bins = (covered(middle % 40, half, present, EACH, count) for count in (rows, ROWS))
    assert few.shape == (rows, SLABS) and np.any(few)
    np.testing.assert_allclose(few, all_bins[:rows], atol=1e-5)


def test_an_accelerator_takes_all_rows_at_once(spans, monkeypatch):
    middle, half, present, _ = (jnp.asarray(v) for v in spans)
    in_parts = covered(middle, half, present, EACH, ROWS)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    np.testing.assert_allclose(covered(middle, half, present, EACH, ROWS), in_parts, atol=1e-5)


def test_slabs_of_a_beam_are_averaged(spans):
    middle, half, present, _ = (jnp.asarray(v) for v in spans)
    beams = jnp.array([[0.25, 0.75, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]])
    each = covered(middle, half, present, EACH, ROWS)
    np.testing.assert_allclose(covered(middle, half, present, beams, ROWS), each @ beams.T, atol=1e-5)


@pytest.mark.parametrize("sums", [1, 2, 3])
def test_derivatives_are_those_that_autodiff_finds(rng, sums):
    near = rng.uniform(-2, ROWS, (SLABS, ITEMS))
    middle = jnp.asarray(np.stack([near, near + rng.uniform(0.5, 6, near.shape)], axis=1), jnp.float32)
    half = jnp.asarray(rng.uniform(-3, 3, middle.shape), jnp.float32)
    weights = jnp.asarray(rng.uniform(size=(SLABS, ITEMS, sums)), jnp.float32)
    at = middle, half, weights
    along = tuple(jnp.asarray(rng.normal(size=value.shape), jnp.float32) for value in at)

    def plain(middle, half, weights):
        edges = jnp.arange(ROWS + 1, dtype=jnp.float32)
        length = ramp(middle[:, 0], half[:, 0], edges) - ramp(middle[:, 1], half[:, 1], edges)
        summed = jnp.einsum("sne,snk->ske", length, weights, precision=jax.lax.Precision.HIGHEST)
        return jnp.moveaxis(jnp.diff(summed, axis=-1), 0, 2)

    def rendered(middle, half, weights):
        return rasterised(middle, half, weights, EACH, ROWS, lambda sums: sums)

    for moving in ((0, 1, 2), (0, 1), (1,), (2,)):

        def of_moving(function, *moved, moving=moving):
            return function(*(moved[moving.index(k)] if k in moving else at[k] for k in range(3)))

        start, direction = [at[k] for k in moving], [along[k] for k in moving]
        (value, slope), (expected, expected_slope) = (
            jax.jvp(partial(of_moving, function), start, direction) for function in (rendered, plain)
        )
        np.testing.assert_allclose(value, expected, atol=1e-5)
        np.testing.assert_allclose(slope, expected_slope, atol=2e-4)
    for number in (0, 2):
        back, expected = (
            jax.grad(lambda *of, function=function: (function(*of) ** 2).sum(), number)(*at)
            for function in (rendered, plain)
        )
        np.testing.assert_allclose(back, expected, atol=1e-3)
