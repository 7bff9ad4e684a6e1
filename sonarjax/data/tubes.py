"""Random tubes: solids of revolution (bottles, cans, cones), extruded outlines, lumps, bent pipes and tori."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.data.draws import Stream
from sonarjax.data.shapes import RING_SIDES, RINGS, tube_vertices
from sonarjax.exact import full_precision
from sonarjax.scene.pose import rotation_x, rotation_y, rotation_z

KINDS = ("revolution", "outline", "lump", "bent")
SHARES = (0.35, 0.25, 0.15, 0.25)
"""Probability of each of `KINDS`."""
POSTURES = (0.4, 0.45, 0.15)
"""Probability that it stands upright, lies, or leans."""
LENGTHS_M, RADII_M = (0.04, 0.4), (0.02, 0.14)
"""Least and largest length and radius of straight tubes [m]."""
BENDS_M, BENT, THICKNESS = (0.05, 0.25), (1.5, 2 * math.pi), (0.08, 0.42)
"""Radius [m] and angle [rad] of a bent pipe's path, and the pipe's radius as a share of the path's."""
CLOSED_SHARE = 0.5
"""Probability that a bent pipe is closed to a torus."""
NUMBERS = 48  # random numbers that a tube takes from its stream


@full_precision
def draw_tube(*, key: Array) -> Float[Array, "vertex 3"]:
    """Draw the vertices (vertex, 3) [m], for `shape_mesh`, of a random tube around the origin whose lowest
    point is at z = 0.
    """
    stream = Stream(NUMBERS, key=key)
    kind = stream.pick(SHARES)
    points = jnp.where(kind == KINDS.index("bent"), _bent(stream), _straight(kind, stream))
    pitch = jnp.stack([jnp.zeros(()), jnp.full((), math.pi / 2), stream.between(0.0, math.pi / 2)])
    rotation = rotation_y(pitch[stream.pick(POSTURES)]) @ rotation_z(stream.between(0.0, 2 * math.pi))
    points = points @ (rotation_z(stream.between(0.0, 2 * math.pi)) @ rotation).T
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return points - middle.at[2].set(points[:, 2].min())


def _straight(kind: Array, stream: Stream) -> Float[Array, "vertex 3"]:
    """A tube along z, whose radius varies from ring to ring, from side to side, or both."""
    length, radius = stream.log_between(*LENGTHS_M), stream.log_between(*RADII_M)
    share = jnp.linspace(0.0, 1.0, RINGS)
    by_ring = jnp.stack([stream.between(0.3, 1.0) for _ in range(RINGS)])
    by_ring = (by_ring + jnp.roll(by_ring, 1)) / 2  # smoothed, so that no ring is a needle
    by_side = jnp.stack([stream.between(0.35, 1.0) for _ in range(RING_SIDES)])
    ball = jnp.sqrt(jnp.maximum(1 - (2 * share - 1) ** 2, 0.02))
    outline = kind == KINDS.index("outline")
    profile = jnp.where(kind == KINDS.index("lump"), ball, jnp.where(outline, 1.0, by_ring))
    sides = jnp.where(kind == KINDS.index("revolution"), 1.0, by_side)
    path = share[:, None] * length * jnp.array([0.0, 0.0, 1.0])
    across, up = (jnp.broadcast_to(jnp.array(v), (RINGS, 3)) for v in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    return tube_vertices(path, across, up, radius * profile[:, None] * sides)


@full_precision
def _bent(stream: Stream) -> Float[Array, "vertex 3"]:
    """A pipe along an arc around z, open or closed to a torus."""
    bend = stream.log_between(*BENDS_M)
    angle = jnp.where(stream.happens(CLOSED_SHARE), 2 * math.pi, stream.between(*BENT)) * jnp.linspace(0.0, 1.0, RINGS)
    outwards = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros(RINGS)], axis=1)
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (RINGS, 3))
    radius = bend * stream.between(*THICKNESS)
    # The cross product of `up` and `outwards` points along the path.
    points = tube_vertices(bend * outwards, up, outwards, jnp.broadcast_to(radius, (RINGS, RING_SIDES)))
    return points @ rotation_x(stream.between(-0.1, 0.1)).T
