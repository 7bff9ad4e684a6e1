"""Where the half-planes of constant azimuth are put: slabs between beam edges and the azimuths where a slice may jump.

Between two neighbouring vertex azimuths every triangle is either cut by all half-planes or by none, so the visible
profile is a continuous function of azimuth. A vertical edge makes it jump, and only there. Slabs therefore end at the
azimuths of the vertices, and those ends move with the pose: the derivative of an integral over azimuth then holds the
boundary term that a fixed set of rays loses (Leibniz' rule).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from sonarjax.render.segments import NEAR_M


class Slabs(NamedTuple):
    """Azimuth slabs of a window, in ascending order."""

    middle: Float[Array, "slab"]
    """Azimuth in the middle of each slab [rad]."""
    width: Float[Array, "slab"]
    """Width of each slab [rad]; may be zero."""
    weights: Float[Array, "beam slab"]
    """Share of each beam's width that a slab makes up; the row of a divided beam sums to 1."""


def make_slabs(
    azimuth_edges: Float[Array, "edge"], events: Float[Array, "event"], sub_beams: int, columns: int | None = None
) -> Slabs:
    """Slabs between beam edges (edge,) [rad], `sub_beams` even parts of each, and event azimuths (event,) [rad].

    With `columns`, only so many beams are divided, from the one of the first event on: the object touches no others.
    """
    beams = len(azimuth_edges) - 1
    divided = beams if columns is None else min(columns, beams)
    fixed_edges, first_event = stop_gradient((azimuth_edges, events.min()))
    first = jnp.clip((fixed_edges <= first_event).sum() - 1, 0, beams - divided)
    edges = jax.lax.dynamic_slice(azimuth_edges, (first,), (divided + 1,))
    parts = jnp.arange(sub_beams, dtype=jnp.float32) / sub_beams
    inner = (edges[:-1, None] + jnp.diff(edges)[:, None] * parts).reshape(-1)
    bounds = jnp.concatenate([inner, edges[-1:], jnp.clip(events, edges[0], edges[-1])])
    bounds = bounds[jnp.argsort(stop_gradient(bounds))]
    middle, slab_width = (bounds[1:] + bounds[:-1]) / 2, jnp.diff(bounds)
    fixed = stop_gradient(middle)
    inside_beam = (fixed >= azimuth_edges[:-1, None]) & (fixed < azimuth_edges[1:, None])
    return Slabs(middle, slab_width, jnp.where(inside_beam, slab_width / jnp.diff(azimuth_edges)[:, None], 0.0))


def event_azimuths(
    vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"], crease: Int[Array, "crease"], limit: int
) -> Float[Array, "event_and_ends"]:
    """Azimuths (event + 2,) [rad] of the vertices at sharp edges and of the two outermost vertices of all.

    The outermost two are where a smooth body begins and ends. Of more than `limit` vertices at sharp edges those are
    taken at which the profile of this view jumps the most. Vertices (vertex, 3) [m] are in the sonar frame.
    """
    fixed = stop_gradient(vertices)
    lateral = jnp.arctan2(fixed[:, 1], fixed[:, 0])
    if len(crease) > limit:
        jump = silhouette_jump(fixed, faces)
        # One entry a vertex, so that the padding of `crease` takes no places.
        crease = jax.lax.top_k(jnp.full(len(fixed), -1.0).at[crease].set(jump[crease]), limit)[1]
    chosen = jnp.concatenate([crease, jnp.argmin(lateral)[None], jnp.argmax(lateral)[None]])
    return safe_azimuth(vertices[chosen])


def silhouette_jump(vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"]) -> Float[Array, "vertex"]:
    """How far the profile may jump in the tangent of elevation [1] at the azimuth of each vertex (vertex, 3) [m].

    It jumps where a silhouette is steep: this is the extent in elevation of the silhouette's edges at a vertex, less
    their extent in azimuth. An edge is silhouette where only one of its two triangles faces the sonar head. Each
    triangle adds its edges to their ends, one with each sign; edges between triangles that face the same way cancel.
    """
    view = vertices[:, 1:] / jnp.maximum(vertices[:, :1], NEAR_M)  # (vertex, 2): tangents of azimuth and elevation
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    facing = jnp.sign((jnp.cross(b - a, c - a) * a).sum(-1))
    corner = view[faces]
    # Of the two edges at a corner one is added and one taken away: what remains is the edge opposite to it.
    opposite = jnp.roll(corner, -1, axis=1) - jnp.roll(corner, -2, axis=1)  # (face, corner, 2)
    extent = jnp.abs(jnp.zeros_like(view).at[faces].add(facing[:, None, None] * opposite))
    return jnp.maximum(extent[:, 1] - extent[:, 0], 0.0)


def safe_azimuth(points: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Azimuth [rad] of points (..., 3) [m], with a zero gradient on the vertical through the sonar."""
    x, y = points[..., 0], points[..., 1]
    safe = x * x + y * y > 1e-8
    return jnp.where(safe, jnp.arctan2(y, jnp.where(safe, x, 1.0)), 0.0)
