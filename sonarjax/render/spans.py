"""Turn a slice's visible intervals into echo spans and occluded spans, whose ends are differentiable numbers.

An *echo span* is a chain of visible intervals without a gap in range: its echo covers every range between its nearest
and its farthest point. An *occluded span* is a chain of visible intervals without a gap in elevation: it hides all
floor between its ends. Finding the chains carries no gradient; `trace_ranges` then computes their ends from the
vertices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sonarjax.exact import full_precision
from sonarjax.render.segments import (
    CROSSING,
    EDGE,
    FIXED,
    FLOOR,
    NEAR_M,
    TAU_MAX,
    TAU_MIN,
    Segments,
    View,
    edge_point,
    plane_line,
)
from sonarjax.render.vector import Corners, Vector, normal_of, take_points, unit
from sonarjax.render.visibility import TOUCH, VisibleIntervals
from sonarjax.scene.mesh import CREASE_ANGLE

EMPTY_TAU = 1e-7  # an interval narrower than this counts as empty
HORIZON = 1e-4  # least 1/planar range [1/m]: farther surfaces are put at 10 km
FEW_FACETS = 8  # facets that a slice of any body may tell apart: piles of three bricks seldom show more
MOST_ITEMS = 12  # most spans of a kind that a slice keeps, where spans are not told apart by object
FEW_FACES = 48  # triangles of a mesh of which every two may be a thin strip with a gap to the next
BLOCK = 32  # longest axis that XLA reduces in one plain loop
LONGEST_PRODUCT = 128  # intervals up to which a product of matrices counts faster than `cumsum`
SMOOTH_COSINE = math.cos(CREASE_ANGLE)  # a sharper bend is an edge of the body
STEEPNESS = 8.0  # of the incidence limit: at 60° the echo falls from 88 % to 12 % between 51° and 68°
FAINT = 0.02  # facets that the incidence limit leaves less of their echo have no span
BANDS = 4  # a smooth surface that fades about the incidence limit is taken as so many spans, each evenly bright
GAP = 1e-4  # relative step in range that ends an echo span: ten times float32's error, below any sonar's resolution


class Ends(NamedTuple):
    """Ends of echo spans or occluded spans (slab, item), described by what makes them."""

    surface: Int[Array, "slab item"]
    """Triangle whose plane gives the range; -1 where the span does not exist."""
    source: Int[Array, "slab item"]
    """Triangle whose segment ends here, or crosses the surface here."""
    kind: Int[Array, "slab item"]
    """What makes the end: EDGE, TAU_MIN, TAU_MAX, FLOOR, NEAR, CROSSING or FIXED of segments.py."""
    edge: Int[Array, "slab item"]
    """Edge of the source triangle, where kind is EDGE."""
    tau: Float[Array, "slab item"]
    """Elevation tangent in the middle of the slab."""
    at_perpendicular: Bool[Array, "slab item"]
    """True where the surface is nearest at the foot of the perpendicular from the sonar head, not at an end."""


class Spans(NamedTuple):
    """All spans of each slab. One array holds all their ends, so that a single pass computes them from the vertices."""

    ends: Ends
    """All ends (slab, end): nearest points of echo spans, their farthest points, lower ends of occluded spans, upper
    ends.
    """
    echo_spans: Bool[Array, "slab echo_span"]
    """Which echo spans exist."""
    occluded_spans: Bool[Array, "slab occluded_span"]
    """Which occluded spans exist."""
    angle: Float[Array, "slab echo_span"]
    """Elevation [rad] that each echo span fills: its share of the energy sent out. Carries no gradient."""
    kept: Float[Array, "slab echo_span"]
    """Share of its echo that the incidence limit leaves. Its only gradient is that by the limit."""

    @property
    def on_object(self) -> Bool[Array, "end"]:
        """Which ends (end,) lie on the object: those of echo spans. The ends of occluded spans lie on the floor."""
        return jnp.arange(self.ends.tau.shape[1]) < 2 * self.echo_spans.shape[1]


def max_items(crossings: int, by_facet: bool = False, objects: int = 0, faces: int | None = None) -> tuple[int, int]:
    """How many echo spans and how many occluded spans a slice keeps; any further ones are joined to the last.

    The estimate allows three triangles to an echo span and four to an occluded span. `by_facet` allows two triangles to
    an echo span, and one to each of the first `FEW_FACETS`. Where spans are told apart by object, each of the `objects`
    may add one more. Where a slice may cross all of a mesh's few `faces`, every two may be a strip: rungs of a ladder.
    """
    echo_spans = min(crossings, max(FEW_FACETS, crossings // 2)) if by_facet else crossings // 3
    strips = faces // 2 if faces is not None and faces <= min(crossings, FEW_FACES) else 0
    least = max(2, strips)
    return max(least, min(echo_spans, MOST_ITEMS)) + objects, max(least, min(crossings // 4, MOST_ITEMS)) + objects


def interval_range(line: Float[Array, "*#batch 2"], tau: Float[Array, "*#batch"]) -> Float[Array, "*batch"]:
    """Slant range [m] at elevation tangent `tau` on the line (a, b) [1/m] (eq. 1 in slice coordinates)."""
    s = line[..., 0] + line[..., 1] * tau
    return jnp.sqrt(1 + tau * tau) / jnp.maximum(s, HORIZON)


def find_spans(
    intervals: VisibleIntervals,
    segments: Segments,
    table: Int[Array, "slab candidate"],
    kept: Float[Array, "slab interval"],
    items: tuple[int, int],
    sampled: bool,
    by_facet: Bool[Array, ""] | bool = False,
    owner: Int[Array, "slab interval"] | None = None,
) -> Spans:
    """Join visible intervals to echo spans and occluded spans.

    Args:
        intervals: The visible intervals.
        segments: The candidates' segments.
        table: Triangle id of each candidate (slab, candidate).
        kept: Share of the echo of each interval (slab, interval) that the incidence limit leaves, see `kept_by_limit`.
        items: Number of echo spans and of occluded spans to keep, see `max_items`.
        sampled: Whether the intervals were sampled. Then intervals may be missing between neighbours, and a step in
            range that the slopes of the two explain is not a gap.
        by_facet: Whether an echo span also ends where the surface bends sharply, or fades by a quarter about the
            incidence limit. Each echo span is then about equally bright all over, and there are also those of facets
            beyond the limit that have some echo left.
        owner: Object that each interval (slab, interval) shows. If given, a span never joins two objects.
    """
    solid = intervals.winner >= 0
    line = _of_candidate(segments.line, intervals.winner)
    start, end = (interval_range(line, intervals.tau[..., k]) for k in (0, 1))
    slope = jnp.abs(end - start) if sampled else jnp.zeros_like(start)
    same_range = jnp.abs(_previous(end) - start) < GAP * start + jnp.maximum(slope, _previous(slope))
    shown = solid & (kept >= jnp.where(by_facet, FAINT, 0.5))
    goes_on = _previous(shown) & same_range
    if by_facet is not False:
        normal = _unit_normal(line)
        before = jnp.pad(normal[:, :-1], ((0, 0), (1, 0), (0, 0)))
        band = jnp.minimum(jnp.floor(BANDS * kept), BANDS - 1)
        even = ((normal * before).sum(-1) > SMOOTH_COSINE) & (band == _previous(band))
        goes_on &= even | ~jnp.asarray(by_facet)
    same_object = jnp.asarray(True) if owner is None else owner == _previous(owner)
    echo_span = _chain(shown, shown & ~(goes_on & same_object), items[0])
    occluded_span = _chain(solid, solid & ~(_previous(solid) & same_object), items[1])
    perpendicular_tau = line[..., 1] / jnp.maximum(line[..., 0], 1e-9)
    at_perpendicular = (perpendicular_tau > intervals.tau[..., 0]) & (perpendicular_tau < intervals.tau[..., 1])
    perpendicular_range = jnp.where(at_perpendicular, jax.lax.rsqrt((line**2).sum(-1) + 1e-12), jnp.inf)
    nearest = jnp.minimum(jnp.minimum(start, end), perpendicular_range)
    number = jnp.arange(solid.shape[1])
    near, far = _extreme(nearest, echo_span, -1), _extreme(jnp.maximum(start, end), echo_span, 1)
    lower = _over_intervals(jnp.min, jnp.where(occluded_span, number[:, None], len(number) - 1))
    upper = _over_intervals(jnp.max, jnp.where(occluded_span, number[:, None], 0))
    at_end = jnp.take_along_axis(end - start, jnp.concatenate([near, far], axis=1), axis=1)
    nearest_at_perpendicular = jnp.take_along_axis(perpendicular_range < jnp.minimum(start, end), near, axis=1)
    upper_end = jnp.concatenate([at_end[:, : items[0]] < 0, at_end[:, items[0] :] > 0], axis=1)
    echo_spans, occluded_spans = _over_intervals(jnp.any, echo_span), _over_intervals(jnp.any, occluded_span)
    no = jnp.zeros_like(occluded_spans)
    never = jnp.concatenate([jnp.zeros_like(echo_spans), no, no], axis=1)
    angle = jnp.where(echo_span, jnp.diff(jnp.arctan(intervals.tau), axis=-1), 0.0)
    total, left = angle.sum(axis=1), (angle * kept[..., None]).sum(axis=1)
    return Spans(
        _ends(
            intervals,
            segments,
            table,
            interval=jnp.concatenate([near, far, lower, upper], axis=1),
            upper_end=jnp.concatenate([upper_end, no, ~no], axis=1),
            exists=jnp.concatenate([echo_spans, echo_spans, occluded_spans, occluded_spans], axis=1),
            at_perpendicular=jnp.concatenate([nearest_at_perpendicular, never], axis=1),
        ),
        echo_spans,
        occluded_spans,
        total,
        jnp.where(total > 0, left / jnp.where(total > 0, total, 1.0), 1.0),
    )


def _of_candidate(values: Float[Array, "slab candidate 2"], index: Int[Array, "slab interval"]) -> Array:
    return jnp.take_along_axis(values, jnp.maximum(index, 0)[..., None], axis=1)


def _unit_normal(normal: Float[Array, "slab interval axis"]) -> Float[Array, "slab interval axis"]:
    """Normals at length 1: within the slice for lines (a, b), in space with the component across the slice."""
    return normal / jnp.sqrt((normal**2).sum(-1, keepdims=True) + 1e-24)


def _previous(values: Array) -> Array:
    """Value of the next lower interval (slab, interval); zero or False for the first."""
    return jnp.pad(values[:, :-1], ((0, 0), (1, 0)))


def _chain(member: Bool[Array, "slab interval"], starts: Bool[Array, "slab interval"], items: int) -> Array:
    """Which chain each interval belongs to (slab, interval, item); chains are numbered from the lowest elevation."""
    number = jnp.minimum(_running_count(starts) - 1, items - 1)
    return member[..., None] & (number[..., None] == jnp.arange(items))


@full_precision
def _running_count(flags: Bool[Array, "slab interval"]) -> Int[Array, "slab interval"]:
    """How many flags are set up to each interval, as `cumsum`: a small product of matrices is far faster."""
    count = flags.shape[1]
    if count > LONGEST_PRODUCT:
        return jnp.cumsum(flags, axis=1)
    return (flags.astype(jnp.float32) @ jnp.triu(jnp.ones((count, count)))).astype(jnp.int32)  # exact below 2**24


def _over_intervals(reduction: Callable[..., Array], values: Array) -> Array:
    """A minimum, a maximum or any over axis 1, in blocks: XLA's CPU code for one long axis is far slower."""
    blocks = jnp.array_split(values, -(-values.shape[1] // BLOCK), axis=1)
    return reduction(jnp.stack([reduction(block, axis=1) for block in blocks]), axis=0)


def _extreme(value: Float[Array, "slab interval"], chain: Bool[Array, "slab interval item"], sign: int) -> Array:
    """The interval (slab, item) with the least (sign -1) or largest (sign 1) value in its chain.

    One integer reduction finds it: positive floats sort like their bits, and the interval's number replaces the lowest.
    """
    bits = (value.shape[1] - 1).bit_length()
    key = ((value.astype(jnp.float32).view(jnp.int32) >> bits) << bits) | jnp.arange(value.shape[1])
    if sign > 0:
        best = _over_intervals(jnp.max, jnp.where(chain, key[..., None], 0))
    else:
        best = _over_intervals(jnp.min, jnp.where(chain, key[..., None], jnp.iinfo(jnp.int32).max))
    # An empty chain has no interval. Any index inside the array will do; one outside would read NaN.
    return jnp.minimum(best & ((1 << bits) - 1), value.shape[1] - 1)


def _ends(
    intervals: VisibleIntervals,
    segments: Segments,
    table: Array,
    interval: Array,
    upper_end: Array,
    exists: Array,
    at_perpendicular: Array,
) -> Ends:
    def take(values: Array, index: Array) -> Array:
        return jnp.take_along_axis(values.reshape(len(interval), -1), index, axis=1)

    side = 2 * interval + upper_end
    end, how, tau = take(intervals.end, side), take(intervals.how, side), take(intervals.tau, side)
    end = jnp.maximum(end, 0)
    surface = take(table, jnp.maximum(take(intervals.winner, interval), 0))
    kind = jnp.where(how == EDGE, take(segments.kind, end), how)
    return Ends(
        jnp.where(exists, surface, -1), take(table, end // 2), kind, take(segments.edge, end), tau, at_perpendicular
    )


def all_ends(
    intervals: VisibleIntervals, segments: Segments, table: Int[Array, "slab candidate"],
    reflectivity: Float[Array, "face"] | None, lambert: Float[Array, ""] | float,
) -> Ends:  # fmt: skip
    """The ends (slab, 2 × interval) of every visible interval, all lower ends first, for the energy integral.

    Where a smooth surface continues across an edge of its tessellation, the end stays at its elevation. Both sides show
    the same ranges there and send as much back, and such an edge may sweep over the whole surface within one slab. This
    does not hold between different `reflectivity` (face,), nor at upright edges if `lambert` is above 0.
    """
    interval = jnp.broadcast_to(jnp.arange(intervals.winner.shape[1]), intervals.winner.shape)
    solid = (intervals.winner >= 0) & (intervals.tau[..., 1] - intervals.tau[..., 0] > EMPTY_TAU)
    upper = jnp.repeat(jnp.array([False, True]), interval.shape[1]) & jnp.ones((len(interval), 1), bool)
    interval, solid = jnp.tile(interval, 2), jnp.tile(solid, 2)
    ends = _ends(intervals, segments, table, interval, upper, solid, jnp.zeros_like(upper))
    paint = None if reflectivity is None else reflectivity[jnp.maximum(table, 0)]
    across = jnp.where(jnp.asarray(lambert) > 0, segments.across, 0.0)
    smooth = jnp.concatenate(_smooth_sides(intervals, segments, across, paint), axis=1)
    return ends._replace(kind=jnp.where(smooth, FIXED, ends.kind))


def _smooth_sides(
    intervals: VisibleIntervals, segments: Segments, across: Float[Array, "slab candidate"],
    paint: Float[Array, "slab candidate"] | None,
) -> tuple[Bool[Array, "slab interval"], Bool[Array, "slab interval"]]:  # fmt: skip
    """Whether each interval's surface continues smoothly below it, and above it: no step in range and no sharp edge,
    nor one between two kinds of `paint` (reflectivity).

    With the normals' components `across` the slice the bend is that in space, without them that within the slice.
    Intervals between segments that merely touch are skipped: which of the two surfaces they show is chance.
    """
    count = intervals.winner.shape[1]
    number = jnp.where(intervals.tau[..., 1] - intervals.tau[..., 0] > TOUCH, jnp.arange(count), -1)
    before = _previous(jax.lax.cummax(number, axis=1) + 1) - 1  # -1 for none
    after = jax.lax.cummin(jnp.where(number < 0, count, number), axis=1, reverse=True)
    after = jnp.pad(after[:, 1:], ((0, 0), (0, 1)), constant_values=count)
    line = _of_candidate(segments.line, intervals.winner)
    start, end = (interval_range(line, intervals.tau[..., k]) for k in (0, 1))
    place, winner = jnp.maximum(before, 0), jnp.maximum(intervals.winner, 0)
    normal = _unit_normal(jnp.concatenate([line, jnp.take_along_axis(across, winner, axis=1)[..., None]], -1))
    alike = (normal * jnp.take_along_axis(normal, place[..., None], axis=1)).sum(-1) > SMOOTH_COSINE
    if paint is not None:
        own = jnp.take_along_axis(paint, winner, axis=1)
        alike &= own == jnp.take_along_axis(own, place, axis=1)
    near = jnp.abs(jnp.take_along_axis(end, place, axis=1) - start) < GAP * start
    solid = intervals.winner >= 0
    below = solid & (before >= 0) & jnp.take_along_axis(solid, place, axis=1) & alike & near
    above = solid & (after < count) & jnp.take_along_axis(below, jnp.minimum(after, count - 1), axis=1)
    return below, above


class Scene(NamedTuple):
    """What the ranges are differentiated through: the surface in the sonar frame, and the bounds of the view."""

    vertices: Float[Array, "vertex 3"]
    """Vertices [m]."""
    faces: Int[Array, "face 3"]
    """Triangles."""
    view: View
    """Aperture and floor."""


def corners_of(scene: Scene, triangle: Int[Array, "*batch"]) -> Corners:
    """Corners of triangles by id (-1 is read as 0)."""
    number = scene.faces[jnp.maximum(triangle, 0)]
    first, second, third = (take_points(scene.vertices, number[..., k]) for k in range(3))
    return first, second, third


def floor_line(azimuth: Float[Array, "*batch"], view: View) -> tuple[Array, Array]:
    """The floor as a line s = a + b·tau: (a, b) [1/m]. At and above the horizon s ≤ 0."""
    a = -(view.up[0] * jnp.cos(azimuth) + view.up[1] * jnp.sin(azimuth)) / view.height
    return a, jnp.broadcast_to(-view.up[2] / view.height, a.shape)


def trace_tau(
    ends: Ends, azimuth: Float[Array, "slab 1"], scene: Scene, surface: tuple[Array, Array]
) -> tuple[Float[Array, "slab item"], Float[Array, "slab item"]]:
    """Compute each end from the vertices, as a differentiable function of `azimuth` [rad].

    `surface` is the line (a, b) of the surface at the end.

    Returns:
        The elevation tangent of each end, and the slant range [m] of the source triangle's edge there.
    """
    corners = corners_of(scene, ends.source)
    rho, z = edge_point(*_edge(corners, ends.edge), azimuth)
    a, b = plane_line(corners, azimuth)
    floor_a, floor_b = floor_line(azimuth, scene.view)
    at_floor = ends.kind == FLOOR
    other_a, other_b = jnp.where(at_floor, floor_a, surface[0]), jnp.where(at_floor, floor_b, surface[1])
    slope = b - other_b
    meets = (at_floor | (ends.kind == CROSSING)) & (jnp.abs(slope) > 1e-6)
    crossing = (other_a - a) / jnp.where(meets, slope, 1.0)
    view = scene.view
    tau = jnp.where(ends.kind == EDGE, z / jnp.maximum(rho, 1e-3), ends.tau)
    tau = jnp.where(ends.kind == TAU_MIN, view.tau_min, jnp.where(ends.kind == TAU_MAX, view.tau_max, tau))
    return jnp.where(meets, crossing, tau), jnp.sqrt(rho * rho + z * z + 1e-12)


def _edge(corners: Corners, edge: Int[Array, "*batch"]) -> tuple[Vector, Vector]:
    """Start and end of each triangle's edge 0, 1 or 2."""

    def corner(number: Array) -> Vector:
        return jax.tree.map(lambda *v: jnp.where(number == 0, v[0], jnp.where(number == 1, v[1], v[2])), *corners)

    return corner(edge), corner((edge + 1) % 3)


def trace_ranges(spans: Spans, azimuth: Float[Array, "slab"], scene: Scene) -> Float[Array, "slab end"]:
    """Slant ranges [m] of all ends at `azimuth` [rad]: points on the object for echo spans, on the floor for occluded
    spans.

    The floor at and above the horizon is put very far away. Differentiable in `azimuth` too, at the middle of the
    slabs.
    """
    theta = azimuth[:, None]
    ends = spans.ends
    corners = corners_of(scene, ends.surface)
    surface = plane_line(corners, theta)
    tau, edge_range = trace_tau(ends, theta, scene, surface)
    on_object = spans.on_object
    line = [jnp.where(on_object, o, f) for o, f in zip(surface, floor_line(theta, scene.view), strict=True)]
    # No point of a triangle is nearer than its nearest corner or farther than its farthest corner, measured along the
    # slice. Its plane has no such bounds: the plane of a facet seen edge-on is far away at a slightly other azimuth.
    nearest, farthest = (jnp.maximum(reach, NEAR_M) for reach in reach_of(corners, theta))
    s = line[0] + line[1] * tau
    s = jnp.where(on_object, jnp.clip(s, 1 / farthest, 1 / nearest), jnp.maximum(s, HORIZON))
    at_perpendicular = jnp.maximum(jax.lax.rsqrt(surface[0] ** 2 + surface[1] ** 2 + 1e-12), nearest)
    ranges = jnp.where(ends.at_perpendicular, at_perpendicular, jnp.sqrt(1 + tau * tau) / s)
    # Where a facet ends at its own edge, the range of that edge is exact, even for a facet seen edge-on.
    own = on_object & (ends.kind == EDGE) & (ends.source == ends.surface) & ~ends.at_perpendicular
    return jnp.where(own, edge_range, ranges)


def reach_of(
    corners: Corners, azimuth: Float[Array, "*#batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Nearest and farthest planar range [m] of each triangle's corners, measured along the slice at `azimuth` [rad]."""
    ahead = [corner.turned(azimuth)[0] for corner in corners]
    return reduce(jnp.minimum, ahead), reduce(jnp.maximum, ahead)


def facet_width(spans: Spans, azimuth: Float[Array, "slab"], scene: Scene) -> Float[Array, "slab end"]:
    """Azimuth [rad] over which each end can be followed: the width, seen from above, of its edge or its surface if
    narrower.

    Only the ends of echo spans lie on a surface of their own; those of occluded spans lie on the floor.
    """

    def around(points: Sequence[Vector]) -> Float[Array, "slab item"]:
        turned = [point.turned(azimuth[:, None]) for point in points]
        aside = [port / jnp.maximum(ahead, NEAR_M) for ahead, port in turned]
        return reduce(jnp.maximum, aside) - reduce(jnp.minimum, aside)

    ends = spans.ends
    width = jnp.where(spans.on_object, around(corners_of(scene, ends.surface)), jnp.inf)
    edge = around(_edge(corners_of(scene, ends.source), ends.edge))
    return jnp.where(ends.kind == EDGE, jnp.minimum(width, edge), width)


def incidence_cosine(
    intervals: VisibleIntervals, corners: Corners, azimuth: Float[Array, "slab"]
) -> Float[Array, "slab interval"]:
    """Cosine of the angle between a facet's normal and the ray to the middle of its interval."""
    index = jnp.maximum(intervals.winner, 0)
    normal = jax.tree.map(lambda v: jnp.take_along_axis(v, index, axis=1), unit(normal_of(corners)))
    tau = intervals.tau.mean(-1)
    along = normal.turned(azimuth[:, None])[0] + normal.z * tau
    return jnp.abs(along) / jnp.sqrt(1 + tau * tau)


def kept_by_limit(cosine: Float[Array, "*batch"], max_incidence_deg: Any) -> Float[Array, "*batch"]:
    """Share of the echo [1] that an incidence limit [deg] leaves, given the `cosine` of incidence.

    A logistic step in the cosine's ratio to that of the limit, where the share is one half. A limit of 90° leaves all;
    one below some 40° also takes from echoes at normal incidence. No source: a model of ours.
    """
    limit = jnp.maximum(jnp.cos(jnp.radians(max_incidence_deg)), 1e-3)
    return jax.nn.sigmoid(STEEPNESS * (cosine / limit - 1))
