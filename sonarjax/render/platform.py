"""A platform instead of an endless floor: which ranges of a slice lie on a rectangle at z = 0."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.render.spans import Scene, floor_line, interval_range
from sonarjax.sonar import Sonar

FAR_M = 1e4
STEEPEST_TAU = 1e3  # no ray is steeper: stands for "no limit" and, as the lower limit, for "nothing"
PARALLEL = 1e-9  # a side with less slope in tau [1/m] is met at no elevation of the slice


def platform_span(azimuth: Float[Array, "*slab"], scene: Scene, sonar: Sonar) -> tuple[Array, Array]:
    """First and last slant range [m], each (..., slab, 1), on the platform; (0, FAR_M) if the floor is endless.

    On the floor line of a slice, each side of the rectangle is a linear inequality in tau.
    """
    if sonar.floor is None:
        return jnp.zeros((*azimuth.shape, 1)), jnp.full((*azimuth.shape, 1), FAR_M)
    a, b = floor_line(azimuth, scene.view)
    low, high = _tau_span(azimuth, a, b, sonar)
    line = jnp.stack(jnp.broadcast_arrays(a, b), -1)
    start, stop = interval_range(line, low), interval_range(line, jnp.maximum(high, low))
    return start[..., None], stop[..., None]


def _tau_span(azimuth: Array, a: Array, b: Array, sonar: Sonar) -> tuple[Array, Array]:
    patch = sonar.floor
    assert patch is not None
    yaw = jnp.asarray(patch.yaw, jnp.float32)
    along, across = (jnp.cos(yaw), jnp.sin(yaw)), (-jnp.sin(yaw), jnp.cos(yaw))
    forward, port = _ground_direction(azimuth, sonar)
    low, high = jnp.full(a.shape, -STEEPEST_TAU), jnp.full(a.shape, STEEPEST_TAU)
    for axis, side in ((along, patch.length), (across, patch.width)):
        center = axis[0] * patch.x + axis[1] * patch.y
        # Ground position along the axis is (p + q·tau) / s with s = a + b·tau on the floor.
        p = axis[0] * forward[0] + axis[1] * port[0]
        q = axis[0] * forward[1] + axis[1] * port[1]
        for sign in (1.0, -1.0):
            limit = sign * center + jnp.asarray(side, jnp.float32) / 2
            constant, slope = limit * a - sign * p, limit * b - sign * q  # inside where constant + slope·tau ≥ 0
            parallel = jnp.abs(slope) <= PARALLEL
            bound = -constant / jnp.where(parallel, 1.0, slope)
            low = jnp.where(~parallel & (slope > 0), jnp.maximum(low, bound), low)
            high = jnp.where(~parallel & (slope < 0), jnp.minimum(high, bound), high)
            # A side line through the point under the sonar has all of the slice on one side.
            low = jnp.where(parallel & (constant < 0), STEEPEST_TAU, low)
    horizon = -a / jnp.where(jnp.abs(b) > 1e-9, b, -1e-9)
    return low, jnp.minimum(high, horizon - 1e-4)


def _ground_direction(azimuth: Array, sonar: Sonar) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Ground x and y of the ray (cos θ, sin θ, tau), each as (constant, slope in tau)."""
    ct, st = jnp.cos(jnp.asarray(sonar.tilt)), jnp.sin(jnp.asarray(sonar.tilt))
    cr, sr = jnp.cos(jnp.asarray(sonar.roll)), jnp.sin(jnp.asarray(sonar.roll))
    c, s = jnp.cos(azimuth), jnp.sin(azimuth)
    return (ct * c + st * sr * s, st * cr), (cr * s, -sr)


def platform_lit(azimuth: Float[Array, "beam"], scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]) -> Array:
    """Which pixels (range, beam) lie on the floor or the platform at their middle; range `edges` (edge,) [m]."""
    start, stop = platform_span(azimuth, scene, sonar)
    middle = ((edges[1:] + edges[:-1]) / 2)[:, None]
    return (middle >= start[:, 0]) & (middle <= stop[:, 0])
