"""Footprints in range: how much of each range bin an interval covers whose ends sweep across a slab of azimuth."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.render.slices import GAUSS


def swept(at_low: Float[Array, "*batch"], at_high: Float[Array, "*batch"]) -> tuple[Array, Array]:
    """Middle and half-sweep [m] of an end over its slab, from its ranges at the two Gauss nodes [m] (linear in azimuth)."""
    return (at_low + at_high) / 2, (at_high - at_low) * (0.25 / GAUSS)


def covered(
    near: tuple[Array, Array], far: tuple[Array, Array], edges: Float[Array, "edge"]
) -> Float[Array, "*batch range"]:
    """Share of each bin between range `edges` (edge,) [bins] covered by [near, far], each (middle, half-sweep) [bins].

    Exact for ends that move linearly across the slab: the mean of the clipped overlap over the sweep.
    """
    return jnp.diff(_ramp(near, edges) - _ramp(far, edges), axis=-1)


def _ramp(end: tuple[Array, Array], edges: Array) -> Array:
    """Mean over the sweep of max(0, edge − end): zero, then a parabola over the sweep, then a straight line."""
    middle, half = end[0][..., None], jnp.maximum(jnp.abs(end[1]), 1e-3)[..., None]
    ahead = edges - middle
    inside = jnp.clip(ahead, -half, half)
    return (inside + half) ** 2 / (4 * half) + jnp.maximum(ahead - half, 0.0)
