"""Place the slabs of azimuth: they end at beam edges and at azimuths where the profile may jump.

Between two neighbouring vertex azimuths a triangle is cut by all half-planes or by none, so the visible profile is a
continuous function of azimuth. Only a vertical edge can make it jump. Slabs therefore end at vertex azimuths, and these
ends move with the pose. The derivative of an integral over azimuth then keeps the boundary term of Leibniz' rule, which
a fixed set of rays would lose.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from sonarjax.exact import full_precision
from sonarjax.render.segments import NEAR_M


class Slabs(NamedTuple):
    """Azimuth slabs of a window, in ascending order."""

    middle: Float[Array, "slab"]
    """Azimuth in the middle of each slab [rad]."""
    width: Float[Array, "slab"]
    """Width of each slab [rad]; may be zero."""
    weights: Float[Array, "beam slab"]
    """Share of each beam's width that a slab fills. For a beam that is divided into slabs the shares sum to 1."""


def make_slabs(
    azimuth_edges: Float[Array, "edge"], events: Float[Array, "event"], sub_beams: int, columns: int | None = None
) -> Slabs:
    """Divide beams into slabs: `sub_beams` equal parts each, divided further at the event azimuths.

    Args:
        azimuth_edges: Edges (edge,) of the beams [rad], ascending.
        events: Azimuths (event,) [rad] at which a slab must end.
        sub_beams: Number of equal parts of each beam.
        columns: Divide only this many beams, starting at the beam of the first event, because the object touches no
            others. None divides all.
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


@full_precision
def per_beam(
    beams: Float[Array, "beam slab"], values: Float[Array, "slab layer range"]
) -> Float[Array, "layer range beam"]:
    """Average layers of slabs over each beam; `beams` are the `weights` of `Slabs`."""
    return jnp.einsum("bs,slr->lrb", beams, values)


def event_azimuths(
    vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"], crease: Int[Array, "crease"], limit: int
) -> Float[Array, "event_and_ends"]:
    """Azimuths (event + 2,) [rad] of the vertices at sharp edges, and of the two outermost vertices of the mesh.

    The outermost two are where a smooth body begins and ends. If more than `limit` vertices lie at sharp edges, those
    where this view's profile jumps most are taken. Vertices (vertex, 3) [m] are in the sonar frame.
    """
    fixed = stop_gradient(vertices)
    lateral = jnp.arctan2(fixed[:, 1], fixed[:, 0])
    if len(crease) > limit:
        jump = silhouette_jump(fixed, faces)
        # One entry for each vertex, so that repeated (padding) entries of `crease` take no places in the list.
        crease = jax.lax.top_k(jnp.full(len(fixed), -1.0).at[crease].set(jump[crease]), limit)[1]
    chosen = jnp.concatenate([crease, jnp.argmin(lateral)[None], jnp.argmax(lateral)[None]])
    return safe_azimuth(vertices[chosen])


def silhouette_jump(vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"]) -> Float[Array, "vertex"]:
    """How far the profile may jump at the azimuth of each vertex (vertex, 3) [m], in tangents of elevation [1].

    The profile jumps where a silhouette is steep. The value is the extent in elevation of the silhouette edges at a
    vertex, minus their extent in azimuth. An edge is a silhouette if only one of its two triangles faces the sonar
    head. Each triangle adds its edges, with a sign, to the vertices at their ends; edges between two triangles that
    face the same way cancel.
    """
    view = vertices[:, 1:] / jnp.maximum(vertices[:, :1], NEAR_M)  # (vertex, 2): tangents of azimuth and elevation
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    facing = jnp.sign((jnp.cross(b - a, c - a) * a).sum(-1))
    corner = view[faces]
    # One edge at a corner is added and the other subtracted; the difference is the edge opposite the corner.
    opposite = jnp.roll(corner, -1, axis=1) - jnp.roll(corner, -2, axis=1)  # (face, corner, 2)
    extent = jnp.abs(jnp.zeros_like(view).at[faces].add(facing[:, None, None] * opposite))
    return jnp.maximum(extent[:, 1] - extent[:, 0], 0.0)


def safe_azimuth(points: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Azimuth [rad] of points (..., 3) [m]; its gradient is zero on the vertical through the sonar, where it would be
    infinite.
    """
    x, y = points[..., 0], points[..., 1]
    safe = x * x + y * y > 1e-8
    return jnp.where(safe, jnp.arctan2(y, jnp.where(safe, x, 1.0)), 0.0)
