"""Exact visibility in one slice: the upper envelope of line segments, as an ordered list of visible intervals.

Nothing here carries a gradient. For each end of an interval this file records what makes it: a mesh edge, a crossing of
two planes, the aperture or the floor. `spans.py` recomputes the end from the vertices, as a differentiable number.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sonarjax.render.segments import CROSSING, EDGE, FIXED, Segments

INSET = 0.02  # sample the nearest triangle this share of an interval inside its ends: at the end itself neighbours tie
TOUCH = 1e-6  # segments touch if their ends in tau differ by less: the two triangles at an edge round it differently
MEET = 0.1  # two lines meet at an end if their distance there is below this share of their largest between the samples
BEND = 1e-4  # lines whose largest distance is below this share of 1/planar range count as one line
EXACT_LIMIT = 32  # above this many candidates a slice is sampled in elevation instead


class VisibleIntervals(NamedTuple):
    """Stretches of elevation with one nearest triangle each, in ascending elevation; `-1` where nothing is hit."""

    winner: Int[Array, "slab interval"]
    """Candidate that is nearest, or -1 for none."""
    tau: Float[Array, "slab interval 2"]
    """Elevation tangents of both ends."""
    end: Int[Array, "slab interval 2"]
    """What makes each end: 2 × candidate + side (0 for the lower, 1 for the upper end of the candidate's segment)."""
    how: Int[Array, "slab interval 2"]
    """EDGE where the candidate's segment ends there, CROSSING where the two surfaces cross, FIXED for neither."""


def visible_intervals(segments: Segments, crossing: bool, elevations: int) -> VisibleIntervals:
    """Find the visible intervals of each slice.

    Exact for up to EXACT_LIMIT candidates in a slice. Above that, the nearest triangle is sampled. Where surfaces pass
    through each other, an interval between two ends shows two of them at most; see `_exact_crossing`.

    Args:
        segments: Segments (slab, candidate).
        crossing: Whether segments may cross each other between their ends.
        elevations: Number of samples, over the elevations that the object fills; unused where the result is exact.
    """
    if not is_sampled(segments):
        return _exact_crossing(segments) if crossing else _exact(segments)
    return _sampled(segments, elevations)


def is_sampled(segments: Segments) -> bool:
    """True if a slice has too many candidates to be solved exactly."""
    return segments.hit.shape[1] > EXACT_LIMIT


def _nearest(segments: Segments, tau: Float[Array, "slab point"]) -> Int[Array, "slab point"]:
    """The candidate with the largest 1/planar range at each elevation tangent, or -1 where there is none.

    A single integer maximum finds it, because the candidate's number replaces the lowest bits of that. These bits
    are worth 1/2¹³ of the range for 1,024 candidates and 1/2¹⁹ for 16, which is below any sonar's resolution. The loop
    over candidates keeps XLA from fusing the segments into the comparison, where it would compute them anew at every
    point.
    """
    count = segments.hit.shape[1]
    bits = (count - 1).bit_length()
    low = jnp.where(segments.hit, segments.tau[..., 0] - TOUCH, jnp.inf)
    columns = [v.T for v in (low, segments.tau[..., 1] + TOUCH, *jnp.moveaxis(segments.line, -1, 0))]

    def closer(number: Array, best: Array) -> Array:
        low, high, a, b = (jax.lax.dynamic_index_in_dim(v, number, keepdims=False)[:, None] for v in columns)
        s = a + b * tau
        key = ((s.view(jnp.int32) >> bits) << bits) | number
        active = (tau >= low) & (tau <= high) & (s > 0)
        return jnp.where(active, jnp.maximum(best, key), best)

    # A CPU stops at the last candidate of the fullest slice; elsewhere a loop of unknown length waits for each turn.
    used = jnp.where(segments.hit, jnp.arange(1, count + 1), 0).max() if jax.default_backend() == "cpu" else count
    key = jax.lax.fori_loop(0, used, closer, jnp.full(tau.shape, -1, jnp.int32))
    return jnp.where(key < 0, -1, key & ((1 << bits) - 1))


def _intervals(segments: Segments) -> tuple[Array, Array, Array]:
    """The segments' ends in ascending order (slab, end), and the lowest and highest tau between neighbouring ends."""
    slabs, count = segments.hit.shape
    ends = jnp.where(segments.hit[..., None], segments.tau, jnp.inf).reshape(slabs, 2 * count)
    order = _sorted_order(ends)
    bound = jnp.take_along_axis(ends, order, axis=1)  # inf at the end
    # Unused ends are put above every segment, where nothing is found.
    bound = jnp.where(jnp.isfinite(bound), bound, 1e3)
    return order, bound[:, :-1], bound[:, 1:]


def _exact(segments: Segments) -> VisibleIntervals:
    order, low, high = _intervals(segments)
    how = jnp.full((*low.shape, 2), EDGE)
    winner = _nearest(segments, (low + high) / 2)
    return VisibleIntervals(winner, jnp.stack([low, high], -1), jnp.stack([order[:, :-1], order[:, 1:]], -1), how)


def _exact_crossing(segments: Segments) -> VisibleIntervals:
    """As `_exact`, but two surfaces may cross inside an interval: each interval is given as two halves.

    Its two ends tell which surfaces these are. A third that is nearest only in the middle, between two crossings, is
    missed; to find it too would take half as many intervals again in every scene of several objects.
    """
    order, low, high = _intervals(segments)
    inset = INSET * (high - low)
    asked = jnp.concatenate([low + inset, high - inset], axis=1)
    lower, upper = jnp.split(_nearest(segments, asked), 2, axis=1)  # winners just inside both ends
    crossing = _crossing_tau(segments, lower, upper, low, high)
    meets = lower != upper  # two surfaces cross here; otherwise the second half is empty
    how = jnp.where(meets, CROSSING, EDGE)
    edge = jnp.full(how.shape, EDGE)

    def interleave(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
        halves = jnp.stack([jnp.stack(first, axis=-1), jnp.stack(second, axis=-1)], axis=2)
        return halves.reshape(len(low), -1, 2)

    return VisibleIntervals(
        winner=jnp.stack([lower, upper], axis=2).reshape(len(low), -1),
        tau=interleave((low, crossing), (crossing, high)),
        end=interleave(
            (order[:, :-1], jnp.where(meets, 2 * upper, order[:, 1:])),
            (jnp.where(meets, 2 * lower, order[:, 1:]), order[:, 1:]),
        ),
        how=interleave((edge, how), (how, edge)),
    )


def _sorted_order(values: Float[Array, "slab end"]) -> Int[Array, "slab end"]:
    """As `argsort` along the last axis, three times as fast: one integer sort, with the position in the lowest bits."""
    bits = (values.shape[1] - 1).bit_length()
    as_int = values.view(jnp.int32)
    ordered = jnp.where(as_int < 0, as_int ^ 0x7FFFFFFF, as_int)
    return jnp.sort(((ordered >> bits) << bits) | jnp.arange(values.shape[1]), axis=1) & ((1 << bits) - 1)


def _crossing_tau(segments: Segments, i: Array, j: Array, low: Array, high: Array) -> Array:
    """Where the lines of candidates i and j cross, kept inside [low, high]; `high` where i equals j."""
    a_i, b_i = (jnp.take_along_axis(segments.line[..., k], jnp.maximum(i, 0), axis=1) for k in (0, 1))
    a_j, b_j = (jnp.take_along_axis(segments.line[..., k], jnp.maximum(j, 0), axis=1) for k in (0, 1))
    differs = (i != j) & (i >= 0) & (j >= 0) & (jnp.abs(b_i - b_j) > 1e-9)
    tau = (a_j - a_i) / jnp.where(differs, b_i - b_j, 1.0)
    return jnp.where(differs, jnp.clip(tau, low, high), high)


def _sampled(segments: Segments, elevations: int) -> VisibleIntervals:
    low = jnp.where(segments.hit, segments.tau[..., 0], jnp.inf).min(axis=1)[:, None]
    high = jnp.where(segments.hit, segments.tau[..., 1], -jnp.inf).max(axis=1)[:, None]
    any_hit = jnp.isfinite(low)
    low, high = jnp.where(any_hit, low, 0.0), jnp.where(any_hit, high, 0.0)
    # Chebyshev's nodes: denser towards both ends, where a round body's range changes with the root of elevation.
    share = 0.5 - 0.5 * jnp.cos(jnp.pi * (jnp.arange(elevations) + 0.5) / elevations)
    node = low + (high - low) * share  # (slab, elevation)
    winner = _nearest(segments, node)
    tau, ends, starts, how = _boundaries(segments, node, winner)
    first, last = winner[:, :1], winner[:, -1:]
    edge = jnp.full(first.shape, EDGE)

    def per_piece(lowest: Array, starts: Array, ends: Array, highest: Array) -> Array:
        """Values at the lower and the upper end of each interval (slab, elevation, 2)."""
        lower, upper = jnp.concatenate([lowest, starts], axis=1), jnp.concatenate([ends, highest], axis=1)
        return jnp.stack([lower, upper], axis=-1)

    return VisibleIntervals(
        winner,
        tau=per_piece(_end(segments, first, 0), tau, tau, _end(segments, last, 1)),
        end=per_piece(2 * first, starts, ends, 2 * last + 1),
        how=per_piece(edge, how, how, edge),
    )


def _take(values: Array, index: Array) -> Array:
    return jnp.take_along_axis(values, jnp.maximum(index, 0), axis=1)


def _end(segments: Segments, index: Array, side: int) -> Array:
    return jnp.where(index >= 0, _take(segments.tau[..., side], index), 0.0)


def _boundaries(segments: Segments, node: Array, winner: Array) -> tuple[Array, Array, Array, Array]:
    """Where the nearest surface changes between neighbouring samples.

    The sampling may miss candidates between two samples, so the end of the nearest candidate's segment need not be
    where its surface ends. The rules, in this order: if such an end lies on the other candidate's line, the two
    surfaces meet there. Otherwise they meet where their lines cross, if that is between the samples. Otherwise one
    surface hides the other, and the end of the nearer one counts.

    Returns:
        For each boundary (slab, elevation - 1): its elevation tangent, what ends the interval below, what starts the
        interval above, and the kind of end.
    """
    i, j = winner[:, :-1], winner[:, 1:]
    below, above = node[:, :-1], node[:, 1:]
    i_end, j_start = _end(segments, i, 1), _end(segments, j, 0)
    (a_i, b_i), (a_j, b_j) = ((_take(segments.line[..., 0], k), _take(segments.line[..., 1], k)) for k in (i, j))
    s_i, s_j = a_i + b_i * below, a_j + b_j * above
    i_ends, j_starts = (i >= 0) & (i_end < above), (j >= 0) & (j_start > below)

    def apart(tau: Array) -> Array:
        return a_j - a_i + (b_j - b_i) * tau

    both = (i >= 0) & (j >= 0)
    most = jnp.maximum(jnp.abs(apart(below)), jnp.abs(apart(above)))
    at_i, at_j = (
        jnp.where(inside, jnp.abs(apart(tau)), jnp.inf) for inside, tau in ((i_ends, i_end), (j_starts, j_start))
    )
    meet = both & (jnp.minimum(at_i, at_j) < MEET * most)
    # Lines that nearly coincide have no reliable crossing.
    cross = both & ~meet & (apart(below) * apart(above) < 0) & (most > BEND * s_i)
    use_i = i_ends & ~cross & jnp.where(meet, at_i <= at_j, ~j_starts | (s_i >= s_j))
    use_j = j_starts & ~cross & ~use_i
    tau = jnp.where(use_i, i_end, jnp.where(use_j, j_start, (below + above) / 2))
    tau = jnp.where(cross, (a_i - a_j) / jnp.where(cross, b_j - b_i, 1.0), tau)
    end = jnp.where(use_i, 2 * i + 1, 2 * j)
    how = jnp.where(cross, CROSSING, jnp.where(use_i | use_j, EDGE, FIXED))
    return jnp.clip(tau, below, above), end, jnp.where(cross, 2 * i, end), how
