"""Rasterise spans: how much of each range bin a span covers whose ends move across a slab of azimuth."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.slabs import per_beam

ROWS = 32
"""Range bins that are taken at a time on a CPU."""
FEW = 2  # up to this many sums over the items are computed each by itself, which needs no array of all overlaps


def covered(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], present: Bool[Array, "slab item"],
    beams: Float[Array, "beam slab"], rows: int,
) -> Float[Array, "range beam"]:  # fmt: skip
    """Share (`rows`, beam) of each pixel that the items' spans cover, at most 1 in each slab.

    Exact for a single span whose ends move linearly across the slab: the mean over the slab of the clipped overlap.

    Args:
        middle: Near and far end (slab, 2, item) [bins] of each span in the middle of the slab.
        half: How far each end moves [bins] from the middle of the slab to its edge.
        present: Which items (slab, item) exist.
        beams: Share of each beam that a slab fills (beam, slab).
        rows: Number of range bins.
    """
    return rasterised(middle, half, present[..., None].astype(jnp.float32), beams, rows, _share)[0]


def covered_by_two(
    first: tuple[Array, Array, Array], second: tuple[Array, Array, Array], beams: Float[Array, "beam slab"], rows: int
) -> tuple[Float[Array, "range beam"], Float[Array, "range beam"]]:
    """As `covered`, for two lists of items: the share (`rows`, beam) that each covers, in one pass over the range bins.

    Args:
        first: Middle and half (slab, 2, item) [bins] and presence (slab, item) of the first list, as in `covered`.
        second: The same of the second list, which may have another number of items.
        beams: Share of each beam that a slab fills (beam, slab).
        rows: Number of range bins.
    """
    middle, half = (jnp.concatenate([a, b], axis=-1) for a, b in zip(first[:2], second[:2], strict=True))
    present = [items[2][..., None].astype(jnp.float32) for items in (first, second)]
    apart = [jnp.pad(items, ((0, 0), (0, 0), (n, 1 - n))) for n, items in enumerate(present)]
    layers = rasterised(middle, half, jnp.concatenate(apart, axis=1), beams, rows, _share)
    return layers[0], layers[1]


def covered_by_each(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    present: Bool[Array, "slab item"],
    beams: Float[Array, "beam slab"],
    rows: int,
    owner: Int[Array, "slab item"],
    owners: int,
) -> tuple[Float[Array, "range beam"], Float[Array, "owner range beam"]]:
    """As `covered`, and the same share (owner, `rows`, beam) of the items of each `owner` (slab, item), 0 and on."""
    own = present[..., None] & (owner[..., None] == jnp.arange(owners))

    def together_and_apart(sums: Float[Array, "slab owner bin"]) -> Float[Array, "slab layer bin"]:
        return _share(jnp.concatenate([sums.sum(axis=1, keepdims=True), sums], axis=1))

    layers = rasterised(middle, half, own.astype(jnp.float32), beams, rows, together_and_apart)
    return layers[0], layers[1:]


def covered_and_spread(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    present: Bool[Array, "slab item"],
    beams: Float[Array, "beam slab"],
    rows: int,
    density: Float[Array, "slab item"],
) -> tuple[Float[Array, "range beam"], Float[Array, "range beam"]]:
    """As `covered`, and as `spread`."""

    def both(sums: Float[Array, "slab 2 bin"]) -> Float[Array, "slab 2 bin"]:
        return jnp.concatenate([_share(sums[:, :1]), jnp.maximum(sums[:, 1:], 0.0)], axis=1)

    weights = jnp.stack([present.astype(jnp.float32), density], axis=-1)
    share, echo = rasterised(middle, half, weights, beams, rows, both)
    return share, echo


def spread(
    middle: Float[Array, "slab 2 item"],
    half: Float[Array, "slab 2 item"],
    beams: Float[Array, "beam slab"],
    rows: int,
    density: Float[Array, "slab item"],
) -> Float[Array, "range beam"]:
    """Sum (`rows`, beam) over items of `density` times the share of each pixel that they cover; at least 0.

    An item without any `density` does not count, whatever its ends are. The other arguments are as in `covered`.
    """
    return rasterised(middle, half, density[..., None], beams, rows, lambda sums: jnp.maximum(sums, 0.0))[0]


def _share(sums: Float[Array, "slab sum bin"]) -> Float[Array, "slab sum bin"]:
    return jnp.clip(sums, 0.0, 1.0)


def rasterised(
    middle: Float[Array, "slab 2 item"], half: Float[Array, "slab 2 item"], weights: Float[Array, "slab item sum"],
    beams: Float[Array, "beam slab"], rows: int, finish: Callable[[Array], Array],
) -> Float[Array, "layer range beam"]:  # fmt: skip
    """Sums over items of `weights` times the share of each range bin that the item's span covers, then `finish`ed in
    each slab and averaged over the slabs of a beam.

    An item whose weights are all zero does not count, whatever its ends are; its derivative by them is zero.

    On a CPU the range bins are taken `ROWS` at a time, and those that no span touches are skipped: an object's echo
    is a small part of its window. An accelerator would wait for each decision.
    """
    counts = (weights != 0).any(axis=-1)
    middle, half = (jnp.where(counts[:, None], ends, 0.0) for ends in (middle, half))
    size = ROWS if jax.default_backend() == "cpu" else rows
    first = jnp.arange(0, rows, size)

    def some_rows(first: Array) -> Float[Array, "layer bin beam"]:
        return per_beam(beams, finish(jnp.diff(_below(middle - first, half, weights, size), axis=-1)))

    if len(first) == 1:
        return some_rows(first[0])[:, :rows]
    nothing = jnp.zeros(jax.eval_shape(some_rows, first[0]).shape)
    touched = _touched(middle, half, counts, first, size)
    parts = jax.lax.map(lambda at: jax.lax.cond(at[1], some_rows, lambda _: nothing, at[0]), (first, touched))
    return jnp.moveaxis(parts, 0, 1).reshape(len(nothing), -1, len(beams))[:, :rows]


def _touched(middle: Array, half: Array, counts: Array, first: Int[Array, "part"], size: int) -> Bool[Array, "part"]:
    """Which parts of `size` range bins, from `first` on, any span touches."""
    reach, part = _at_least(half)[..., 0], first[:, None, None]
    near, far = middle[:, 0] - reach[:, 0], middle[:, 1] + reach[:, 1]
    return stop_gradient((counts & (near < part + size) & (far > part)).any(axis=(1, 2)))


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


@partial(_below.defjvp, symbolic_zeros=True)
def _below_jvp(rows: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """Derivative written by hand, as products of matrices; nothing is computed for what does not move.

    What an end adds depends on the share of the slab's azimuths at which it has passed an edge. This is the same for
    derivatives in all directions, but XLA would compute what autodiff makes of it anew for each.
    """
    middle, half, weights = primals
    moved, widened, heavier = tangents
    sign = jnp.array([-1.0, 1.0])[:, None]  # of near ends and far ends
    value = _below(middle, half, weights, rows)
    change = jnp.zeros_like(value) if _stays(heavier) else _below(middle, half, heavier, rows)
    if _stays(moved) and _stays(widened):
        return value, change
    moved, widened = (jnp.zeros_like(middle) if _stays(tangent) else tangent for tangent in (moved, widened))

    def by_end(tangent: Float[Array, "slab 2 item"]) -> Float[Array, "slab end sum"]:
        return ((sign * tangent)[..., None] * weights[:, None]).reshape(len(weights), -1, weights.shape[-1])

    edges = jnp.arange(rows + 1, dtype=jnp.float32)
    passed = share_passed(middle, half, edges).reshape(len(weights), -1, rows + 1)
    change += _summed(passed, by_end(moved))
    change -= _summed(passed - passed * passed, by_end(widened * jnp.sign(half)))
    return value, change


def _stays(tangent: Any) -> bool:
    """Whether an argument does not depend on what is derived by."""
    return isinstance(tangent, SymbolicZero)


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
