"""Footprints in range bins, held to a dense count of what lies inside the intervals."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render.rasterise import covered, covered_by_each

ROWS, SLABS, ITEMS, OWNERS = 24, 5, 4, 3
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
    """Share (slab, range) of each bin that all intervals of a slab cover together, by counting."""
    shares = np.zeros((SLABS, ROWS))
    at = (np.arange(STEPS) + 0.5) / STEPS
    for slab in range(SLABS):
        for item in np.flatnonzero(present[slab]):
            ends = middle[slab, :, item] + (2 * at[:, None] - 1) * half[slab, :, item]  # (azimuth, 2)
            edges = np.clip(np.arange(ROWS + 1)[:, None], *ends.T)
            shares[slab] += np.where(ends[:, 0] < ends[:, 1], np.diff(edges, axis=0), 0).mean(axis=1)
    return np.clip(shares, 0, 1)


def test_each_owner_covers_what_a_count_finds(spans):
    middle, half, present, owner = spans
    half = np.sign(half) * np.minimum(np.abs(half), (middle[:, 1] - middle[:, 0])[:, None] / 2)  # ends keep their order
    together, apart = covered_by_each(*map(jnp.asarray, (middle, half, present)), ROWS, jnp.asarray(owner), OWNERS)
    np.testing.assert_allclose(together, counted(middle, half, present), atol=5e-3)
    for one in range(OWNERS):
        np.testing.assert_allclose(apart[one], counted(middle, half, present & (owner == one)), atol=5e-3)


def test_all_owners_together_cover_what_one_pass_finds(spans):
    middle, half, present, owner = spans
    together, apart = covered_by_each(*map(jnp.asarray, (middle, half, present)), ROWS, jnp.asarray(owner), OWNERS)
    np.testing.assert_allclose(together, covered(*map(jnp.asarray, (middle, half, present)), ROWS), atol=1e-5)
    assert np.isfinite(apart).all() and (np.asarray(apart).max(axis=(1, 2)) > 0.5).all()
