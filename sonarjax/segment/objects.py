"""The objects in a semantic map, as boxes: connected parts of highlight and shadow, the clearest first.

Everything has fixed shapes and runs under jit and vmap. Nothing here has a derivative.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

LEAST_EVIDENCE = 0.25
"""A pixel belongs to an object if its grey differs from the background's by more than this."""
CLOSING = (9, 3)
"""Gaps of up to this many pixels (range, beam) between parts of an object are closed."""
JUMPS = 10
"""Chains of labels are followed for 2¹⁰ steps in one round."""
LEAST_SHARE = 0.05
"""Objects with less than this share of the clearest object's evidence are dropped: each closer
look takes time, and at still smaller objects it made the maps of drawn frames no better."""


class Objects(NamedTuple):
    """The objects of a map, the clearest first."""

    bounds: Int[Array, "object 4"]
    """First row and column of each object, and one past its last ones [pixels]; arbitrary where not `found`."""
    found: Bool[Array, "object"]
    """False for unused places."""


def find_objects(grey: Float[Array, "range beam"], most: int) -> Objects:
    """Find up to `most` connected parts (8 neighbours) of `grey` (range, beam) that are not background (0.5).

    The evidence of an object is the sum over its pixels of the difference between their grey and the background's.
    """
    evidence = jnp.abs(jax.lax.stop_gradient(grey) - 0.5)
    labels = connected_parts(_closed(evidence > LEAST_EVIDENCE))
    count = max(labels.size + 1, most)  # a frame of very few pixels has fewer labels than places
    sums = jax.ops.segment_sum(evidence.ravel(), labels.ravel(), count).at[0].set(0.0)
    largest, chosen = jax.lax.top_k(sums, most)
    found = (largest > 0) & (largest >= LEAST_SHARE * largest[0])
    return Objects(jax.vmap(lambda label: _bounds(labels == label))(chosen), found)


def connected_parts(mask: Bool[Array, "range beam"]) -> Int[Array, "range beam"]:
    """Label (range, beam) each connected part of `mask` with a number of 1 or more; 0 outside.

    Each pixel takes the largest label around it, and each label is then replaced by the largest that any of its pixels
    has met (Shiloach and Vishkin 1982). A few rounds suffice for any shape.
    """
    numbers = jnp.arange(1, mask.size + 1).reshape(mask.shape)

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        labels, _ = state
        near = jnp.where(mask, _largest_around(labels, (3, 3)), 0)
        met = jnp.arange(mask.size + 1).at[labels.ravel()].max(near.ravel())
        met = jax.lax.fori_loop(0, JUMPS, lambda _, m: m[m], met)  # follow each chain to its end
        spread = jnp.where(mask, met[near], 0)
        return spread, (spread != labels).any()

    labels, _ = jax.lax.while_loop(lambda state: state[1], spread, (jnp.where(mask, numbers, 0), mask.any()))
    return labels


def _largest_around(values: Int[Array, "range beam"], size: tuple[int, int]) -> Int[Array, "range beam"]:
    return jax.lax.reduce_window(values, 0, jax.lax.max, size, (1, 1), "SAME")


def _closed(mask: Bool[Array, "range beam"]) -> Bool[Array, "range beam"]:
    """Morphological closing: dilation, then erosion. Outside the frame there is neither object nor background."""
    dilated = _largest_around(mask.astype(jnp.int32), CLOSING)
    return _largest_around(1 - dilated, CLOSING) == 0


def _bounds(inside: Bool[Array, "range beam"]) -> Int[Array, "4"]:
    """First row and column where `inside` is true, and one past the last."""
    rows, columns = inside.any(axis=1), inside.any(axis=0)
    last = [len(touched) - jnp.argmax(touched[::-1]) for touched in (rows, columns)]
    return jnp.stack([jnp.argmax(rows), jnp.argmax(columns), *last])
