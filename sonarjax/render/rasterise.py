"""Rasterise spans: how much of each range bin a span covers whose ends move across a slab of azimuth."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

FEW = 2  # up to this many sums over the items are computed each by itself, which needs no array of all overlaps


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
    return jnp.clip(weighted(middle, half, present[..., None].astype(jnp.float32), rows)[:, 0], 0.0, 1.0)


def covered_by_each(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    present: Bool[Array, "slab item"],
    rows: int,
    owner: Int[Array, "slab item"],
    owners: int,
) -> tuple[Float[Array, "slab range"], Float[Array, "owner slab range"]]:
    """As `covered`, and the same share (owner, slab, `rows`) of the items of each `owner` (slab, item), 0 and on."""
    own = present[..., None] & (owner[..., None] == jnp.arange(owners))
    parts = jnp.moveaxis(weighted(middle, half, own.astype(jnp.float32), rows), 1, 0)
    return jnp.clip(parts.sum(axis=0), 0.0, 1.0), jnp.clip(parts, 0.0, 1.0)


def covered_and_spread(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    present: Bool[Array, "slab item"],
    rows: int,
    density: Float[Array, "slab item"],
) -> tuple[Float[Array, "slab range"], Float[Array, "slab range"]]:
    """As `covered`, and the sum (slab, `rows`) over items of `density` times the share of each bin that they cover.

    `density` carries no gradient.
    """
    sums = weighted(middle, half, jnp.stack([present.astype(jnp.float32), density], axis=-1), rows)
    return jnp.clip(sums[:, 0], 0.0, 1.0), sums[:, 1]


def weighted(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], weights: Float[Array, "slab item sum"],
    rows: int,
) -> Float[Array, "slab sum range"]:  # fmt: skip
    """Sums over items of `weights` times the share of each range bin that the item's span covers.

    `weights` carry no gradient. An item whose weights are all zero does not count, whatever its ends are. The other
    arguments are as in `covered`.
    """
    counts = (weights != 0).any(axis=-1)[:, None]
    middle, half = (jnp.where(counts, ends, 0.0) for ends in (middle, half))
    return jnp.diff(_below(middle, half, stop_gradient(weights), rows), axis=-1)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def _below(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], weights: Float[Array, "slab item sum"],
    rows: int,
) -> Float[Array, "slab sum edge"]:  # fmt: skip
    """Weighted sums of the length [bins] of each span that lies below each edge of the range bins."""
    edges = jnp.arange(rows + 1, dtype=jnp.float32)
    length = ramp(middle[:, 0], half[:, 0], edges) - ramp(middle[:, 1], half[:, 1], edges)
    if weights.shape[-1] > FEW:
        return _summed(length, weights)
    return jnp.stack([(weights[..., k, None] * length).sum(axis=1) for k in range(weights.shape[-1])], axis=1)


@_below.defjvp
def _below_jvp(rows: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """Derivative written by hand, as products of matrices.

    What an end adds depends on the share of the slab's azimuths at which it has passed an edge. This is the same for
    derivatives in all directions, but XLA would compute what autodiff makes of it anew for each.
    """
    middle, half, weights = primals
    moved, widened, _ = tangents
    sign = jnp.array([-1.0, 1.0])[:, None]  # of near ends and far ends

    def by_end(tangent: Float[Array, "slab 2 item"]) -> Float[Array, "slab end sum"]:
        return ((sign * tangent)[..., None] * weights[:, None]).reshape(len(weights), -1, weights.shape[-1])

    edges = jnp.arange(rows + 1, dtype=jnp.float32)
    passed = share_passed(middle, half, edges).reshape(len(weights), -1, rows + 1)
    change = _summed(passed, by_end(moved))
    change -= _summed(passed - passed * passed, by_end(widened * jnp.sign(half)))
    return _below(middle, half, weights, rows), change


def _summed(
    values: Float[Array, "slab item edge"], weights: Float[Array, "slab item sum"]
) -> Float[Array, "slab sum edge"]:
    return jnp.einsum("sne,snk->ske", values, weights, precision=jax.lax.Precision.HIGHEST)


def ramp(
    middle: Float[Array, "slab item"], half: Float[Array, "slab item"], edges: Float[Array, "edge"]
) -> Float[Array, "slab item edge"]:
    """Mean of max(0, edge − end) while the end moves over middle ± half [bins]: zero, then a parabola, then a straight
    line.
    """
    passed, half = share_passed(middle, half, edges), _at_least(half)
    return half * passed * passed + jnp.maximum(edges - middle[..., None] - half, 0.0)


def share_passed(
    middle: Float[Array, "*batch"], half: Float[Array, "*batch"], edges: Float[Array, "edge"]
) -> Float[Array, "*batch edge"]:
    """Share of the time that an end is below each edge while it moves over middle ± half [bins]."""
    return jnp.clip((edges - middle[..., None]) * (0.5 / _at_least(half)) + 0.5, 0.0, 1.0)


def _at_least(half: Float[Array, "*batch"], least: float = 1e-3) -> Float[Array, "*batch 1"]:
    return jnp.maximum(jnp.abs(half), least)[..., None]
