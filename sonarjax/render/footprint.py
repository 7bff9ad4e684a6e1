"""Footprints in range: how much of each range bin an interval covers whose ends sweep across a slab of azimuth."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sonarjax.render.slices import GAUSS


def swept(at_nodes: Float[Array, "2 slab item"]) -> tuple[Float[Array, "slab item"], Float[Array, "slab item"]]:
    """Middle and half-sweep of an end over its slab, from its values at the two Gauss nodes (linear in azimuth)."""
    return (at_nodes[0] + at_nodes[1]) / 2, (at_nodes[1] - at_nodes[0]) * (0.25 / GAUSS)


def covered(
    near: tuple[Array, Array], far: tuple[Array, Array], present: Bool[Array, "slab item"], edges: Float[Array, "edge"]
) -> Float[Array, "slab range"]:
    """Sum over items of the share of each bin that [near, far] covers; each end is (middle, half-sweep) in bins.

    `edges` (edge,) are the bins' edges in bins, `present` says which items count. Exact for ends that move linearly
    across the slab: the mean of the clipped overlap over the sweep.
    """
    ramps = ramp(near[0], near[1], edges) - ramp(far[0], far[1], edges)
    return jnp.diff(jnp.where(present[..., None], ramps, 0.0).sum(axis=1), axis=-1)


@jax.custom_jvp
def ramp(
    middle: Float[Array, "slab item"], half: Float[Array, "slab item"], edges: Float[Array, "edge"]
) -> Float[Array, "slab item edge"]:
    """Mean of max(0, edge − end) over an end's sweep, middle ± half [bins]: zero, a parabola, then a straight line."""
    half = _at_least(half)
    ahead = edges - middle[..., None]
    inside = jnp.clip(ahead, -half, half)
    return (inside + half) ** 2 / (4 * half) + jnp.maximum(ahead - half, 0.0)


@ramp.defjvp
def _ramp_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """By hand, because autodiff keeps every intermediate of this largest array of the renderer (half the time)."""
    middle, half, edges = primals
    width = _at_least(half)
    passed = jnp.clip((edges - middle[..., None] + width) / (2 * width), 0.0, 1.0)
    d_half = (passed - passed * passed) * jnp.sign(half)[..., None]
    tangent = -passed * tangents[0][..., None] + d_half * tangents[1][..., None]
    return ramp(middle, half, edges), tangent


def _at_least(half: Float[Array, "slab item"], least: float = 1e-3) -> Float[Array, "slab item 1"]:
    return jnp.maximum(jnp.abs(half), least)[..., None]
