"""From a slice's visible pieces to the ends of its highlights and shadows, and their ranges as differentiable numbers.

A *run* is a chain of visible pieces without a gap in range: its echo covers every range between its nearest and
its farthest point. A *stretch* is a chain of pieces without a gap in elevation: it hides every floor point between
its ends. The chains are found without a gradient; `trace_ranges` then follows their ends through the vertices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.envelope import TOUCH, Pieces
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
from sonarjax.scene.mesh import CREASE_ANGLE

EMPTY_TAU = 1e-7  # a piece narrower than this is nothing
HORIZON = 1e-4  # least 1/planar range [1/m]: farther surfaces are put at 10 km
MOST_ITEMS = 12
SMOOTH_COSINE = math.cos(CREASE_ANGLE)  # a sharper bend is an edge of the body
GAP = 1e-4  # relative step in range that ends a run: ten times float32's error, far below any sonar's resolution


class Ends(NamedTuple):
    """Ends of runs or stretches (slab, item), as what makes them."""

    surface: Int[Array, "slab item"]
    """Triangle whose plane gives the range, -1 for no item."""
    source: Int[Array, "slab item"]
    """Triangle whose segment ends, or crosses, here."""
    kind: Int[Array, "slab item"]
    """What makes the end: see segments.py."""
    edge: Int[Array, "slab item"]
    """Edge of the source triangle, where kind is EDGE."""
    tau: Float[Array, "slab item"]
    """Elevation tangent in the middle of the slab."""
    foot: Bool[Array, "slab item"]
    """True where the nearest point is the foot of the perpendicular, not an end."""


class Outline(NamedTuple):
    """All that a slab shows. One array holds all ends, so that one pass follows them through the vertices."""

    ends: Ends
    """Ends (slab, 2 run + 2 stretch): runs' nearest points, their farthest, stretches' lower ends, their upper ends."""
    runs: Bool[Array, "slab run"]
    """Which runs exist."""
    stretches: Bool[Array, "slab stretch"]
    """Which stretches exist."""
    angle: Float[Array, "slab run"]
    """Elevation [rad] that each run fills, without a gradient: its share of the energy sent out."""

    @property
    def on_object(self) -> Bool[Array, "end"]:
        """Which ends (2 run + 2 stretch,) lie on the object; those of stretches lie on the floor behind it."""
        return jnp.arange(self.ends.tau.shape[1]) < 2 * self.runs.shape[1]


def max_items(crossings: int, by_facet: bool = False) -> tuple[int, int]:
    """How many runs, and how many stretches, a slice keeps; further ones are joined to the last.

    A run shows at least a triangle or two, a body that stands alone more; `by_facet` one is enough.
    """
    runs = crossings if by_facet else crossings // 3
    return max(2, min(runs, MOST_ITEMS)), max(2, min(crossings // 4, MOST_ITEMS))


def piece_range(line: Float[Array, "*#batch 2"], tau: Float[Array, "*#batch"]) -> Float[Array, "*batch"]:
    """Slant range [m] at elevation tangent `tau` on the line (a, b) [1/m] (eq. 1 in slice coordinates)."""
    s = line[..., 0] + line[..., 1] * tau
    return jnp.sqrt(1 + tau * tau) / jnp.maximum(s, HORIZON)


def find_outline(
    pieces: Pieces,
    segments: Segments,
    table: Int[Array, "slab candidate"],
    lit: Bool[Array, "slab piece"],
    items: tuple[int, int],
    sampled: bool,
    by_facet: Bool[Array, ""] | bool = False,
) -> Outline:
    """Chains of visible pieces; `table` holds the candidates' triangle ids, `lit` the pieces that give highlight.

    Runs also end where the surface bends sharply if they are `by_facet`: each then is about equally bright.

    Between neighbouring pieces of a `sampled` profile others were passed over: a step in range that the two pieces'
    own slopes explain is then no gap.
    """
    solid = pieces.winner >= 0
    line = _of_candidate(segments.line, pieces.winner)
    start, end = (piece_range(line, pieces.tau[..., k]) for k in (0, 1))
    slope = jnp.abs(end - start) if sampled else jnp.zeros_like(start)
    same_range = jnp.abs(_previous(end) - start) < GAP * start + jnp.maximum(slope, _previous(slope))
    shown = solid & lit
    goes_on = _previous(shown) & same_range
    if by_facet is not False:
        normal = _normal(line)
        before = jnp.pad(normal[:, :-1], ((0, 0), (1, 0), (0, 0)))
        goes_on &= ((normal * before).sum(-1) > SMOOTH_COSINE) | ~jnp.asarray(by_facet)
    run = _chain(shown, shown & ~goes_on, items[0])
    stretch = _chain(solid, solid & ~_previous(solid), items[1])
    foot_tau = line[..., 1] / jnp.maximum(line[..., 0], 1e-9)
    foot = (foot_tau > pieces.tau[..., 0]) & (foot_tau < pieces.tau[..., 1])
    foot_range = jnp.where(foot, jax.lax.rsqrt((line**2).sum(-1) + 1e-12), jnp.inf)
    nearest = jnp.minimum(jnp.minimum(start, end), foot_range)
    number = jnp.arange(solid.shape[1])
    near, far = _extreme(nearest, run, -1), _extreme(jnp.maximum(start, end), run, 1)
    lower = jnp.where(stretch, number[:, None], len(number) - 1).min(axis=1)
    upper = jnp.where(stretch, number[:, None], 0).max(axis=1)
    at_end = jnp.take_along_axis(end - start, jnp.concatenate([near, far], axis=1), axis=1)
    at_foot = jnp.take_along_axis(foot_range < jnp.minimum(start, end), near, axis=1)
    upper_end = jnp.concatenate([at_end[:, : items[0]] < 0, at_end[:, items[0] :] > 0], axis=1)
    runs, stretches = run.any(axis=1), stretch.any(axis=1)
    no, never = jnp.zeros_like(stretches), jnp.zeros_like(jnp.concatenate([runs, stretches, stretches], axis=1))
    return Outline(
        _ends(
            pieces,
            segments,
            table,
            piece=jnp.concatenate([near, far, lower, upper], axis=1),
            upper_end=jnp.concatenate([upper_end, no, ~no], axis=1),
            exists=jnp.concatenate([runs, runs, stretches, stretches], axis=1),
            foot=jnp.concatenate([at_foot, never], axis=1),
        ),
        runs,
        stretches,
        jnp.where(run, jnp.diff(jnp.arctan(pieces.tau), axis=-1), 0.0).sum(axis=1),
    )


def _of_candidate(values: Float[Array, "slab candidate 2"], index: Int[Array, "slab piece"]) -> Array:
    return jnp.take_along_axis(values, jnp.maximum(index, 0)[..., None], axis=1)


def _normal(line: Float[Array, "slab piece 2"]) -> Float[Array, "slab piece 2"]:
    """Unit normals of surfaces as they are cut by a slice, from their lines (a, b)."""
    return line / jnp.sqrt((line**2).sum(-1, keepdims=True) + 1e-24)


def _previous(values: Array) -> Array:
    """Each piece's lower neighbour's value (slab, piece); zero or False for the first."""
    return jnp.pad(values[:, :-1], ((0, 0), (1, 0)))


def _chain(member: Bool[Array, "slab piece"], starts: Bool[Array, "slab piece"], items: int) -> Array:
    """Membership (slab, piece, item) of pieces in chains, numbered from the lowest elevation."""
    number = jnp.minimum(jnp.cumsum(starts, axis=1) - 1, items - 1)
    return member[..., None] & (number[..., None] == jnp.arange(items))


def _extreme(value: Float[Array, "slab piece"], chain: Bool[Array, "slab piece item"], sign: int) -> Array:
    """Piece (slab, item) with the least (sign -1) or largest (sign 1) value in its chain.

    One integer reduction: positive floats sort like their bits, whose lowest ones make room for the piece's number.
    """
    bits = (value.shape[1] - 1).bit_length()
    key = ((value.astype(jnp.float32).view(jnp.int32) >> bits) << bits) | jnp.arange(value.shape[1])
    if sign > 0:
        best = jnp.where(chain, key[..., None], 0).max(axis=1)
    else:
        best = jnp.where(chain, key[..., None], jnp.iinfo(jnp.int32).max).min(axis=1)
    # An empty chain has no piece: any index inside the array will do, where one outside would read NaN.
    return jnp.minimum(best & ((1 << bits) - 1), value.shape[1] - 1)


def _ends(
    pieces: Pieces, segments: Segments, table: Array, piece: Array, upper_end: Array, exists: Array, foot: Array
) -> Ends:
    def take(values: Array, index: Array) -> Array:
        return jnp.take_along_axis(values.reshape(len(piece), -1), index, axis=1)

    side = 2 * piece + upper_end
    end, how, tau = take(pieces.end, side), take(pieces.how, side), take(pieces.tau, side)
    end = jnp.maximum(end, 0)
    surface = take(table, jnp.maximum(take(pieces.winner, piece), 0))
    kind = jnp.where(how == EDGE, take(segments.kind, end), how)
    return Ends(jnp.where(exists, surface, -1), take(table, end // 2), kind, take(segments.edge, end), tau, foot)


def all_ends(pieces: Pieces, segments: Segments, table: Int[Array, "slab candidate"]) -> Ends:
    """The ends (slab, 2 × piece) of every visible piece, all lower ones first, for the energy integral.

    Where a surface goes on smoothly across an edge of its tessellation, the end stays at its elevation: both sides
    show the same ranges there, and such an edge may sweep over the whole surface within one slab.
    """
    piece = jnp.broadcast_to(jnp.arange(pieces.winner.shape[1]), pieces.winner.shape)
    solid = (pieces.winner >= 0) & (pieces.tau[..., 1] - pieces.tau[..., 0] > EMPTY_TAU)
    upper = jnp.repeat(jnp.array([False, True]), piece.shape[1]) & jnp.ones((len(piece), 1), bool)
    piece, solid = jnp.tile(piece, 2), jnp.tile(solid, 2)
    ends = _ends(pieces, segments, table, piece, upper, solid, jnp.zeros_like(upper))
    smooth = jnp.concatenate(_smooth_sides(pieces, segments), axis=1)
    return ends._replace(kind=jnp.where(smooth, FIXED, ends.kind))


def _smooth_sides(pieces: Pieces, segments: Segments) -> tuple[Bool[Array, "slab piece"], Bool[Array, "slab piece"]]:
    """Whether each piece's surface goes on smoothly below it, and above: no step in range, no edge of the body.

    Pieces between segments that touch are passed over: which of the two surfaces they show is chance.
    """
    count = pieces.winner.shape[1]
    number = jnp.where(pieces.tau[..., 1] - pieces.tau[..., 0] > TOUCH, jnp.arange(count), -1)
    before = _previous(jax.lax.cummax(number, axis=1) + 1) - 1  # -1 for none
    after = jax.lax.cummin(jnp.where(number < 0, count, number), axis=1, reverse=True)
    after = jnp.pad(after[:, 1:], ((0, 0), (0, 1)), constant_values=count)
    line = _of_candidate(segments.line, pieces.winner)
    start, end = (piece_range(line, pieces.tau[..., k]) for k in (0, 1))
    normal = _normal(line)
    place = jnp.maximum(before, 0)
    straight = (normal * jnp.take_along_axis(normal, place[..., None], axis=1)).sum(-1) > SMOOTH_COSINE
    near = jnp.abs(jnp.take_along_axis(end, place, axis=1) - start) < GAP * start
    solid = pieces.winner >= 0
    below = solid & (before >= 0) & jnp.take_along_axis(solid, place, axis=1) & straight & near
    above = solid & (after < count) & jnp.take_along_axis(below, jnp.minimum(after, count - 1), axis=1)
    return below, above


class Scene(NamedTuple):
    """The surface in the sonar frame and what bounds the view: all that the ranges are differentiated through."""

    vertices: Float[Array, "vertex 3"]
    """Vertices [m]."""
    faces: Int[Array, "face 3"]
    """Triangles."""
    view: View
    """Aperture and floor."""


def corners_of(scene: Scene, triangle: Int[Array, "*batch"]) -> Float[Array, "*batch 3 3"]:
    """Corners (..., corner, xyz) [m] of triangles by id (-1 is read as 0)."""
    return scene.vertices[scene.faces[jnp.maximum(triangle, 0)]]


def floor_line(azimuth: Float[Array, "*batch"], view: View) -> tuple[Array, Array]:
    """(a, b) [1/m] of the floor as a line s = a + b·tau; s ≤ 0 at and above the horizon."""
    a = -(view.up[0] * jnp.cos(azimuth) + view.up[1] * jnp.sin(azimuth)) / view.height
    return a, jnp.broadcast_to(-view.up[2] / view.height, a.shape)


def trace_tau(
    ends: Ends, azimuth: Float[Array, "slab 1"], scene: Scene, surface: tuple[Array, Array]
) -> tuple[Float[Array, "slab item"], Float[Array, "slab item"]]:
    """Elevation tangent of each end, as a function of `azimuth` [rad], and the slant range [m] of its source's edge.

    `surface` is the line (a, b) of the surface at the end.
    """
    corners = corners_of(scene, ends.source)
    first = _corner(corners, ends.edge)
    second = _corner(corners, (ends.edge + 1) % 3)
    rho, z = edge_point(first, second, azimuth)
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


def _corner(corners: Float[Array, "*batch 3 3"], index: Int[Array, "*batch"]) -> Float[Array, "*batch 3"]:
    i = index[..., None]
    return jnp.where(i == 0, corners[..., 0, :], jnp.where(i == 1, corners[..., 1, :], corners[..., 2, :]))


def trace_ranges(outline: Outline, azimuth: Float[Array, "slab"], scene: Scene) -> Float[Array, "slab end"]:
    """Slant ranges [m] of an outline's ends at `azimuth` [rad]: runs' near and far points, floor behind stretches.

    The floor at and above the horizon is very far. Differentiable in `azimuth` too, at the middle of the slabs.
    """
    theta = azimuth[:, None]
    ends = outline.ends
    corners = corners_of(scene, ends.surface)
    surface = plane_line(corners, theta)
    tau, edge_range = trace_tau(ends, theta, scene, surface)
    on_object = outline.on_object
    line = [jnp.where(on_object, o, f) for o, f in zip(surface, floor_line(theta, scene.view), strict=True)]
    # No point of a triangle is nearer than its nearest corner or farther than its farthest, as seen along the slice;
    # the plane of a facet seen edge-on is, as soon as it is followed to another azimuth.
    reach = jnp.cos(theta)[..., None] * corners[..., 0] + jnp.sin(theta)[..., None] * corners[..., 1]
    nearest, farthest = jnp.maximum(reach.min(-1), NEAR_M), jnp.maximum(reach.max(-1), NEAR_M)
    s = line[0] + line[1] * tau
    s = jnp.where(on_object, jnp.clip(s, 1 / farthest, 1 / nearest), jnp.maximum(s, HORIZON))
    foot = jnp.maximum(jax.lax.rsqrt(surface[0] ** 2 + surface[1] ** 2 + 1e-12), nearest)
    ranges = jnp.where(ends.foot, foot, jnp.sqrt(1 + tau * tau) / s)
    # Where a facet ends at its own edge that edge's range is exact, and stays so for one that is seen edge-on.
    own = on_object & (ends.kind == EDGE) & (ends.source == ends.surface) & ~ends.foot
    return jnp.where(own, edge_range, ranges)


def facet_width(outline: Outline, azimuth: Float[Array, "slab"], scene: Scene) -> Float[Array, "slab end"]:
    """Azimuth [rad] over which each end can be followed: the lesser width of its edge and its surface, seen from above.

    Only ends on the object have a surface of their own; those of stretches lie on the floor.
    """
    c, s = jnp.cos(azimuth)[:, None, None], jnp.sin(azimuth)[:, None, None]

    def around(points: Float[Array, "slab item point 3"]) -> Float[Array, "slab item"]:
        ahead = jnp.maximum(c * points[..., 0] + s * points[..., 1], NEAR_M)
        aside = (c * points[..., 1] - s * points[..., 0]) / ahead
        return aside.max(-1) - aside.min(-1)

    ends = outline.ends
    corners = corners_of(scene, ends.source)
    edge = jnp.stack([_corner(corners, ends.edge), _corner(corners, (ends.edge + 1) % 3)], axis=-2)
    surface = around(corners_of(scene, ends.surface))
    width = jnp.where(outline.on_object, surface, jnp.inf)
    return jnp.where(ends.kind == EDGE, jnp.minimum(width, around(edge)), width)


def incidence_cosine(
    pieces: Pieces, segments: Segments, corners: Float[Array, "slab candidate 3 3"], azimuth: Float[Array, "slab"]
) -> Float[Array, "slab piece"]:
    """Cosine of the angle between the ray to the middle of each piece and its facet's normal."""
    normal = jnp.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normal = normal / (jnp.sqrt((normal**2).sum(-1, keepdims=True)) + 1e-20)
    n = jnp.take_along_axis(normal, jnp.maximum(pieces.winner, 0)[..., None], axis=1)
    tau = pieces.tau.mean(-1)
    along = n[..., 0] * jnp.cos(azimuth)[:, None] + n[..., 1] * jnp.sin(azimuth)[:, None] + n[..., 2] * tau
    return jnp.abs(along) / jnp.sqrt(1 + tau * tau)


def lit_pieces(cosine: Float[Array, "slab piece"], max_incidence_deg: float) -> Bool[Array, "slab piece"]:
    """Pieces that give highlight: struck no more obliquely than `max_incidence_deg` [deg] from their normal."""
    return cosine >= math.cos(math.radians(max_incidence_deg))
