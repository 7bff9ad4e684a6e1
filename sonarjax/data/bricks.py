"""Random piles of one to four boxes: bricks of Fig. 4 laid side by side, stacked, on edge, or leaning.

No pile equals one of the test objects. Target and non-target are three bricks, two on the floor and one lying across
them. Here a pile of three has either all bricks on the floor or only one, so that at most two of three can coincide.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sonarjax.data.draws import Stream
from sonarjax.data.shapes import MOST_BOXES, box_vertices
from sonarjax.exact import full_precision
from sonarjax.scene.objects import BRICK_M
from sonarjax.scene.pose import rotation_x, rotation_y, rotation_z

COUNT_SHARES = (0.2, 0.3, 0.25, 0.25)
"""Probability that a pile has 1, 2, 3 and 4 boxes."""
STANDING_SHARES = (0.65, 0.2, 0.15)
"""Probability that a brick lies flat, stands on its long narrow side, or stands on its end."""
LEANING_SHARE, LEAN = 0.35, 0.45
"""Probability that one brick of the pile leans, and its largest lean [rad]. Only one leans, because
`shapes.CROSSINGS` assumes so.
"""
BRICK_SHARE = 0.65
"""Probability that the boxes are equal bricks."""
TOUCH_M = 0.001
"""Least gap between two bricks [m], so that no two faces coincide."""
SCATTERED_SHARE, SCATTERED_M = 0.12, (0.1, 0.6)
"""Probability that boxes on the floor stand far apart, as separate objects, and the range of their distance [m]."""
NUMBERS = 112  # random numbers that a pile takes from its stream
_AXES = np.array([[0, 1, 2], [0, 2, 1], [2, 1, 0]])  # which side of a brick becomes its x, y and z


def draw_pile(*, key: Array) -> Float[Array, "box 8 3"]:
    """Draw the corners (box, 8, 3) [m] of a random pile on z = 0 around the origin; boxes that do not exist
    have no extent.
    """
    stream = Stream(NUMBERS, key=key)
    count = 1 + stream.pick(COUNT_SHARES)
    size = _sizes(stream)
    on_floor = [stream.happens(0.5) for _ in range(MOST_BOXES)]
    on_floor[2] = jnp.where(count == 3, on_floor[1], on_floor[2])  # of three never two below and one above
    scattered = stream.happens(SCATTERED_SHARE)
    leaning = jnp.where(stream.happens(LEANING_SHARE), jnp.floor(stream.between(0, MOST_BOXES)), -1)
    corners: list[Array] = []
    yaw = jnp.zeros(())
    for number in range(MOST_BOXES):
        yaw = _next_yaw(yaw, stream)
        own = _turned(size[number], yaw, leaning == number, stream)
        if corners:
            own = own + _place(own, jnp.stack(corners), on_floor[number], scattered, stream)
            # A box that does not exist shrinks to a corner of the first. It comes last, so none is placed beside it.
            own = jnp.where(number < count, own, corners[0][:1])
        corners.append(own)
    pile = jnp.stack(corners)
    middle = (pile.min(axis=(0, 1)) + pile.max(axis=(0, 1))) / 2
    return pile - middle.at[2].set(0.0)


def _sizes(stream: Stream) -> Float[Array, "box 3"]:
    """Sizes (box, 3) [m]: equal bricks of about the usual shape, or arbitrary boxes."""
    scale = jnp.exp(stream.between(-0.3, 0.3))
    brick = jnp.stack([scale * side * (1 + 0.04 * stream.normal()) for side in BRICK_M])
    boxes = jnp.stack([stream.log_between(0.04, 0.25) for _ in range(3 * MOST_BOXES)]).reshape(MOST_BOXES, 3)
    return jnp.where(stream.happens(BRICK_SHARE), brick, boxes)


def _next_yaw(previous: Array, stream: Stream) -> Array:
    """The yaw of the next brick: half of them lie roughly along or across the previous one."""
    aligned = previous + jnp.where(stream.happens(0.5), math.pi / 2, 0.0) + 0.08 * stream.normal()
    return stream.sometimes(0.5, aligned, stream.between(0.0, 2 * math.pi))


@full_precision
def _turned(size: Float[Array, "3"], yaw: Array, leans: Array, stream: Stream) -> Float[Array, "8 3"]:
    """Corners (8, 3) [m] of a box at `yaw` [rad], with its lowest point at z = 0 and its middle above the origin."""
    size = size[jnp.asarray(_AXES)[stream.pick(STANDING_SHARES)]]
    pitch, roll = (jnp.where(leans, stream.between(-LEAN, LEAN), 0.0) for _ in range(2))
    rotation = rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)
    corners = box_vertices(size[None], rotation[None], jnp.zeros((1, 3)))[0]
    return corners.at[:, 2].add(-corners[:, 2].min())


@full_precision
def _place(
    own: Float[Array, "8 3"], there: Float[Array, "box 8 3"], on_floor: Bool[Array, ""], scattered: Array,
    stream: Stream,
) -> Array:  # fmt: skip
    """Where a box goes (3,) [m]: beside all existing boxes, or on top of them, but never through them."""
    angle = stream.between(0.0, 2 * math.pi)
    ahead = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    aside = jnp.stack([-ahead[1], ahead[0]])
    gap = stream.sometimes(0.4, 0.0, stream.between(0.0, 0.35) ** 2) + TOUCH_M
    gap = jnp.where(scattered, stream.between(*SCATTERED_M), gap)
    # A vertical plane at right angles to `ahead` separates the new box from all others.
    distance = (there[..., :2] @ ahead).max() - (own[:, :2] @ ahead).min() + gap
    beside = distance * ahead + stream.between(-0.08, 0.08) * aside
    below = there[jnp.floor(stream.between(0, len(there) - 1e-3)).astype(jnp.int32)]
    low, high = below[:, :2].min(axis=0), below[:, :2].max(axis=0)
    above = (low + high) / 2 + 0.4 * (high - low) * jnp.stack([stream.between(-1.0, 1.0) for _ in range(2)])
    height = _top_below(own[:, :2] + above, there) + TOUCH_M
    return jnp.where(on_floor, jnp.append(beside, 0.0), jnp.append(above, height))


def _top_below(own: Float[Array, "8 2"], there: Float[Array, "box 8 3"]) -> Array:
    """Height [m] of the highest box on which `own` may lie: among those whose bounds from above overlap with
    its own.
    """
    apart = (own.min(axis=0) > there[..., :2].max(axis=1)) | (own.max(axis=0) < there[..., :2].min(axis=1))
    return jnp.where(apart.any(axis=-1), 0.0, there[..., 2].max(axis=1)).max()
