"""Objects that lie on no floor, or look like no brick: chains, frames of bars, hanging, large and pale objects.

Tank and harbour frames show many of them. `vary` turns some of the objects of `draw_shape` into such.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.data.draws import Stream
from sonarjax.data.objects import Shape
from sonarjax.data.shapes import BOXES, RING_SIDES, RINGS, TUBE, box_vertices, pile_vertices, tube_vertices
from sonarjax.exact import full_precision
from sonarjax.scene.pose import rotation_x, rotation_y, rotation_z
from sonarjax.sonar import Sonar

KIND_SHARES = (0.70, 0.16, 0.14)
"""Probability that an object stays as it is, or becomes a chain or a frame of bars."""
HANGING_SHARE, HANGING_M = 0.18, (0.04, 0.5)
"""Probability that an object hangs in the water, and its height above the floor then [m]."""
LARGE_SHARE, LARGE = 0.2, (1.2, 2.2)
"""Probability that an object is enlarged, and the factor [1]."""
PALE_SHARE, PALE_DB = 0.25, (3.0, 14.0)
"""Probability that an object sends back less than usual, and by how much less [dB]."""
NO_FLOOR_SHARE, NO_FLOOR_M = 0.05, 1e-3
"""Probability that no floor is in view where there are no walls, and the side of the floor then [m]: a spot below the
object.
"""
CHAIN_M, CHAIN_RADIUS_M, CHAIN_TURN = (0.15, 0.9), (0.006, 0.025), 1.1
"""Length and half thickness of a chain or rope [m], and its largest turn to either side [rad]."""
FRAME_M, BAR_M = (0.15, 0.6), (0.012, 0.05)
"""Side of a frame, and thickness of its bars [m]."""
FRAME_POSTURES = (0.4, 0.35, 0.25)
"""Probability that a frame or chain lies on the floor, stands, or leans."""
GAP_M = 0.001
"""Gap between the bars of a frame [m], so that no two faces coincide."""


class Variation(NamedTuple):
    """What is unusual about a pair beside its object's form."""

    reflectivity: Float[Array, ""]
    """Factor on the energy that the object sends back [1]."""
    no_floor: Array
    """Whether no floor is in view ()."""


def vary(shape: Shape, *, key: Array) -> tuple[Shape, Variation]:
    """Turn some of the objects into unusual ones; one that is nothing stays nothing."""
    stream = Stream(48, key=key)
    kind = stream.pick(KIND_SHARES)
    chain, frame = _chain(stream), _frame(stream)
    vertices = jnp.where(kind == 1, chain, jnp.where(kind == 2, frame, shape.vertices))
    vertices = vertices * stream.sometimes(LARGE_SHARE, stream.between(*LARGE), 1.0)
    hanging = stream.sometimes(HANGING_SHARE, stream.log_between(*HANGING_M), 0.0)
    vertices = vertices + hanging * jnp.array([0.0, 0.0, 1.0])
    nothing = jnp.ptp(shape.vertices, axis=0).max() == 0
    pale = stream.sometimes(PALE_SHARE, stream.between(*PALE_DB), 0.0)
    return (
        Shape(jnp.array([shape.kind, TUBE, BOXES])[kind], jnp.where(nothing, 0.0, vertices)),
        Variation(10 ** (-pale / 10), stream.happens(NO_FLOOR_SHARE)),
    )


def without_floor(sonar: Sonar, gone: Array) -> Sonar:
    """The sonar over no floor where `gone` () is true."""
    floor = sonar.floor
    assert floor is not None  # every view has a floor
    length, width = (jnp.where(gone, NO_FLOOR_M, side) for side in (floor.length, floor.width))
    return replace(sonar, floor=replace(floor, length=length, width=width))


@full_precision
def _chain(stream: Stream) -> Float[Array, "vertex 3"]:
    """A thin chain, rope or wire, which winds to either side and never turns back."""
    length, radius = stream.log_between(*CHAIN_M), stream.log_between(*CHAIN_RADIUS_M)
    aside = jnp.stack([stream.between(-CHAIN_TURN, CHAIN_TURN) for _ in range(RINGS - 1)])
    steps = length / (RINGS - 1) * jnp.stack([jnp.zeros(RINGS - 1), jnp.sin(aside), jnp.cos(aside)], axis=1)
    path = jnp.concatenate([jnp.zeros((1, 3)), jnp.cumsum(steps, axis=0)])
    across, up = (jnp.broadcast_to(jnp.array(v), (RINGS, 3)) for v in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    links = jnp.where(jnp.arange(RINGS) % 2, 1.0, 0.6)[:, None]  # links lie across and along in turn
    points = tube_vertices(path, across, up, jnp.broadcast_to(radius * links, (RINGS, RING_SIDES)))
    return _put_down(points @ rotation_y(jnp.float32(math.pi / 2)).T, stream)


@full_precision
def _frame(stream: Stream) -> Float[Array, "vertex 3"]:
    """Four bars in a rectangle."""
    length, width, bar = stream.log_between(*FRAME_M), stream.log_between(*FRAME_M), stream.log_between(*BAR_M)
    zero, inner = jnp.zeros(()), width - 2 * bar - 2 * GAP_M
    sizes = jnp.stack([jnp.stack([length, bar, bar])] * 2 + [jnp.stack([bar, inner, bar])] * 2)
    x, y = (length - bar) / 2, (width - bar) / 2
    centers = jnp.stack([jnp.stack(c) for c in ((zero, -y, zero), (zero, y, zero), (-x, zero, zero), (x, zero, zero))])
    corners = box_vertices(sizes, jnp.broadcast_to(jnp.eye(3), (4, 3, 3)), centers)
    turned = _put_down(pile_vertices(corners)[:32], stream)
    return jnp.concatenate([turned, jnp.broadcast_to(turned[:1], (RINGS * RING_SIDES + 2 - 32, 3))])


@full_precision
def _put_down(points: Float[Array, "vertex 3"], stream: Stream) -> Float[Array, "vertex 3"]:
    """What lies in the plane z = 0, laid down, stood up or leant, at any yaw; its lowest point is at z = 0."""
    lean = jnp.stack([jnp.zeros(()), jnp.full((), math.pi / 2), stream.between(0.0, math.pi / 2)])
    tilted = rotation_x(lean[stream.pick(FRAME_POSTURES)]) @ rotation_z(stream.between(0.0, 2 * math.pi))
    points = points @ (rotation_z(stream.between(0.0, 2 * math.pi)) @ tilted).T
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return points - middle.at[2].set(points[:, 2].min())
