"""The random object of a training pair: bricks, cylinders and balls (Fig. 4), tubes of many shapes, or nothing."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.random import split
from jaxtyping import Array, Float, Int

from sonarjax.data.bricks import draw_pile
from sonarjax.data.draws import Stream
from sonarjax.data.shapes import (
    BALL,
    BALL_VERTICES,
    BOXES,
    CYLINDER,
    CYLINDER_VERTICES,
    TUBE,
    pile_vertices,
    round_vertices,
)
from sonarjax.data.tubes import draw_tube
from sonarjax.exact import full_precision
from sonarjax.scene.pose import rotation_y, rotation_z

KIND_SHARES = (0.44, 0.14, 0.07, 0.35)
"""Probability that the object is a pile of boxes, a cylinder, a ball, or a tube."""
PITCH_SHARES = (0.4, 0.5, 0.1)
"""Probability that a cylinder stands upright, lies, or leans."""
NOTHING_SHARE = 0.04
"""Probability that there is no object."""
RAISED_SHARE, RAISED_M = 0.1, 0.04
"""Probability that the object does not touch the floor, and its largest height then [m]."""


class Shape(NamedTuple):
    """An object around the origin of its own frame, standing on z = 0."""

    kind: Int[Array, ""]
    """BOXES, CYLINDER, BALL or TUBE of `shapes`."""
    vertices: Float[Array, "vertex 3"]
    """Vertices [m] for `shape_mesh`; they all coincide if there is no object."""


def draw_shape(*, key: Array) -> Shape:
    """Draw a random object."""
    pile_key, own_key, tube_key = split(key, 3)
    stream = Stream(16, key=own_key)
    kind = jnp.array([BOXES, CYLINDER, BALL, TUBE])[stream.pick(KIND_SHARES)]
    vertices = jnp.where(kind == BOXES, pile_vertices(draw_pile(key=pile_key)), _draw_round(kind, stream))
    vertices = jnp.where(kind == TUBE, draw_tube(key=tube_key), vertices)
    raised = stream.sometimes(RAISED_SHARE, stream.between(0.0, RAISED_M), 0.0)
    vertices = vertices + raised * jnp.array([0.0, 0.0, 1.0])
    return Shape(kind, jnp.where(stream.happens(NOTHING_SHARE), 0.0, vertices))


@full_precision
def _draw_round(kind: Array, stream: Stream) -> Float[Array, "vertex 3"]:
    """A ball, or a cylinder that stands upright, lies or leans; its lowest point is at z = 0."""
    radius, length = stream.log_between(0.025, 0.15), stream.log_between(0.05, 0.4)
    pitches = jnp.stack([jnp.zeros(()), jnp.full((), math.pi / 2), stream.between(0.0, math.pi / 2)])
    pitch = pitches[stream.pick(PITCH_SHARES)]
    points = round_vertices(kind, radius, jnp.minimum(length, 8 * radius)) @ rotation_y(pitch).T
    points = points @ rotation_z(stream.between(0.0, 2 * math.pi)).T
    used = jnp.where(kind == BALL, BALL_VERTICES, CYLINDER_VERTICES)
    padding = jnp.arange(len(points)) >= used
    points = jnp.where(padding[:, None], points[0], points)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return points - middle.at[2].set(points[:, 2].min())
