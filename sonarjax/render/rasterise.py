"""Rasterise spans: how much of each range bin a span covers whose ends move across a slab of azimuth."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


def covered(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], present: Bool[Array, "slab item"], rows: int
) -> Float[Array, "slab range"]:
    """Share (slab, `rows`) of each range bin that the items' spans cover, at most 1.

    Exact for a single span whose ends move linearly across the slab: the mean over the slab of the clipped overlap.

    Args:
        middle: Near and far end (slab, 2, item) [bins] of each span in the middle of the slab.
        half: How far each end moves [bins] from the middle of the slab to its edge.
        present: Which items (slab, item) exist.
        rows: Number of range bins.
    """
    shares = jnp.where(present[..., None], _overlap(middle, half, rows), 0.0)
    return jnp.clip(jnp.diff(shares.sum(axis=1), axis=-1), 0.0, 1.0)


def covered_by_each(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    present: Bool[Array, "slab item"],
    rows: int,
    owner: Int[Array, "slab item"],
    owners: int,
) -> tuple[Float[Array, "slab range"], Float[Array, "owner slab range"]]:
    """As `covered`, and the same share (owner, slab, `rows`) of the items of each `owner` (slab, item), 0 and on."""
    overlap = jnp.where(present[..., None], _overlap(middle, half, rows), 0.0)
    own = (owner[..., None] == jnp.arange(owners)).astype(jnp.float32)
    # One product for all owners: the overlaps, which are most of the work, are computed once.
    shares = jnp.einsum("sio,sie->ose", own, overlap, precision=jax.lax.Precision.HIGHEST)
    parts = jnp.diff(shares, axis=-1)
    return jnp.clip(parts.sum(axis=0), 0.0, 1.0), jnp.clip(parts, 0.0, 1.0)


def spread(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], weight: Float[Array, "slab item"], rows: int
) -> Float[Array, "slab range"]:
    """Sum (slab, `rows`) over items of `weight` times the share of each range bin that the item's span covers.

    Arguments as in `covered`. An item of weight zero does not count, whatever its ends are.
    """
    shares = jnp.where(weight[..., None] != 0, weight[..., None] * _overlap(middle, half, rows), 0.0)
    return jnp.diff(shares.sum(axis=1), axis=-1)


def _overlap(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], rows: int
) -> Float[Array, "slab item edge"]:
    """Length [bins] of each span that lies below each edge of the `rows` range bins."""
    edges = jnp.arange(rows + 1, dtype=jnp.float32)
    return ramp(middle[:, 0], half[:, 0], edges) - ramp(middle[:, 1], half[:, 1], edges)


@jax.custom_jvp
def ramp(
    middle: Float[Array, "slab item"], half: Float[Array, "slab item"], edges: Float[Array, "edge"]
) -> Float[Array, "slab item edge"]:
    """Mean of max(0, edge − end) while the end moves over middle ± half [bins]: zero, then a parabola, then a straight
    line.
    """
    half = _at_least(half)
    ahead = edges - middle[..., None]
    inside = jnp.clip(ahead, -half, half)
    return (inside + half) ** 2 / (4 * half) + jnp.maximum(ahead - half, 0.0)


@ramp.defjvp
def _ramp_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """Derivative written by hand: autodiff would store every intermediate of the renderer's largest array, at twice the
    time.
    """
    middle, half, edges = primals
    width = _at_least(half)
    passed = jnp.clip((edges - middle[..., None] + width) / (2 * width), 0.0, 1.0)
    d_half = (passed - passed * passed) * jnp.sign(half)[..., None]
    tangent = -passed * tangents[0][..., None] + d_half * tangents[1][..., None]
    return ramp(middle, half, edges), tangent


def _at_least(half: Float[Array, "slab item"], least: float = 1e-3) -> Float[Array, "slab item 1"]:
    return jnp.maximum(jnp.abs(half), least)[..., None]
