"""Cut triangles with a half-plane of constant azimuth into segments over elevation tangent and 1/planar range.

With tau = tan(elevation) and s = 1 / planar range, a plane of eq. 1 becomes the straight line s = G · (cos θ, sin θ,
tau). The nearest surface of a slice is therefore the upper envelope of straight segments.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.vector import Corners, Vector, normal_of

NEAR_M = 1e-2  # surfaces nearer to the sonar head than this are cut off

# What ends a visible interval. Spans use it to recompute that end from the vertices, as a differentiable number.
EDGE, TAU_MIN, TAU_MAX, FLOOR, NEAR, CROSSING, FIXED = range(7)


class View(NamedTuple):
    """What bounds a slice, apart from the mesh."""

    tau_min: Float[Array, ""]
    """Tangent of the lowest insonified elevation."""
    tau_max: Float[Array, ""]
    """Tangent of the highest insonified elevation."""
    up: Float[Array, "3"]
    """The ground's vertical in the sonar frame."""
    height: Float[Array, ""]
    """Height of the sonar above the floor [m]."""


class Segments(NamedTuple):
    """Segments into which a slice cuts its candidate triangles; both ends in ascending order of tau."""

    tau: Float[Array, "*batch 2"]
    """Elevation tangents of the lower and the upper end."""
    line: Float[Array, "*batch 2"]
    """(a, b) of s = a + b·tau [1/m]."""
    across: Float[Array, "*batch"]
    """Third component [1/m] of the plane's normal (a, across, b): the one to port of the slice."""
    kind: Int[Array, "*batch 2"]
    """What ends the segment: EDGE, TAU_MIN, TAU_MAX, FLOOR or NEAR."""
    edge: Int[Array, "*batch 2"]
    """Which edge of the triangle (0: corners 0–1, 1: 1–2, 2: 2–0) holds the end, where kind is EDGE."""
    hit: Bool[Array, "*batch"]
    """False where no part of the triangle lies in the slice's view."""


def plane_line(
    corners: Corners, azimuth: Float[Array, "*#batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Line s = a + b·tau that the plane of each triangle becomes at `azimuth` [rad].

    Returns:
        (a, b) [1/m].
    """
    ahead, _, up = plane_normal(corners, azimuth)
    return ahead, up


def plane_normal(
    corners: Corners, azimuth: Float[Array, "*#batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Normal of each triangle's plane along the slice at `azimuth` [rad], to port of it, and upwards [1/m].

    Its length is one over the plane's distance from the sonar head.
    """
    normal = normal_of(corners)
    offset = normal.dot(corners[0])
    # A plane through the sonar head is seen edge-on and has no line. Its offset is replaced by a small one of the same
    # sign, so that nothing jumps. A padding triangle has no area and no normal: 1e-14 keeps its derivatives finite.
    floor = 1e-7 * jnp.sqrt(normal.dot(normal) + 1e-14)
    safe = jnp.where(jnp.abs(offset) > floor, offset, jnp.where(offset < 0, -floor, floor))
    gradient = normal / safe
    ahead, across = gradient.turned(azimuth)
    return ahead, across, jnp.broadcast_to(gradient.z, ahead.shape)


def edge_point(
    start: Vector, end: Vector, azimuth: Float[Array, "*#batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Planar range and height (rho, z) [m] of the point where the edge from `start` to `end` [m] crosses `azimuth`
    [rad].
    """
    (rho0, u0), (rho1, u1) = start.turned(azimuth), end.turned(azimuth)
    step = u0 - u1
    safe = jnp.abs(step) > 1e-9
    share = jnp.clip(jnp.where(safe, u0 / jnp.where(safe, step, 1.0), 0.5), 0.0, 1.0)
    return rho0 + share * (rho1 - rho0), start.z + share * (end.z - start.z)


def cut(corners: Corners, azimuth: Float[Array, "*#batch"], view: View) -> Segments:
    """Cut triangles at `azimuth` [rad]; keep what is inside the aperture and above the floor."""
    side = [corner.turned(azimuth)[1] > 0 for corner in corners]  # to port of the slice
    crossed = [side[k] != side[(k + 1) % 3] for k in range(3)]  # two of the edges, or none
    point = [edge_point(corners[k], corners[(k + 1) % 3], azimuth) for k in range(3)]
    first = tuple(jnp.where(crossed[0], a, b) for a, b in zip(point[0], point[1], strict=True))
    second = tuple(jnp.where(crossed[2], a, b) for a, b in zip(point[2], point[1], strict=True))
    edge = jnp.where(crossed[0], 0, 1), jnp.where(crossed[2], 2, 1)
    (t0, kind0), (t1, kind1), kept = _clip(first, second, azimuth, view)

    def tangent(t: Array) -> Array:
        rho, z = (a + t * (b - a) for a, b in zip(first, second, strict=True))
        return z / jnp.maximum(rho, NEAR_M / 2)

    tau0, tau1 = tangent(t0), tangent(t1)
    flip = tau0 > tau1

    def ascending(a: Array, b: Array) -> Array:
        return jnp.stack([jnp.where(flip, b, a), jnp.where(flip, a, b)], axis=-1)

    a, across, b = plane_normal(corners, azimuth)
    hit = (crossed[0] | crossed[1]) & kept & (tau0 != tau1)
    line = jnp.stack([a, b], axis=-1)
    return Segments(ascending(tau0, tau1), line, across, ascending(kind0, kind1), ascending(*edge), hit)


def _clip(first: tuple, second: tuple, azimuth: Array, view: View) -> tuple[tuple, tuple, Array]:
    """Clip segments to the view by Liang and Barsky's method: (t, kind) of both ends, and whether anything is left."""
    lateral = view.up[0] * jnp.cos(azimuth) + view.up[1] * jnp.sin(azimuth)
    inside = (
        (TAU_MIN, lambda rho, z: z - view.tau_min * rho),
        (TAU_MAX, lambda rho, z: view.tau_max * rho - z),
        (FLOOR, lambda rho, z: view.height + lateral * rho + view.up[2] * z),
        (NEAR, lambda rho, z: rho - NEAR_M),
    )
    t0, t1 = jnp.zeros_like(first[0]), jnp.ones_like(first[0])
    kind0 = kind1 = jnp.full(t0.shape, EDGE)
    kept = jnp.ones(t0.shape, bool)
    for name, distance in inside:
        d0, d1 = distance(*first), distance(*second)
        enters, leaves = (d0 < 0) & (d1 >= 0), (d0 >= 0) & (d1 < 0)
        t = d0 / jnp.where(enters | leaves, d0 - d1, 1.0)
        kind0, t0 = jnp.where(enters & (t > t0), name, kind0), jnp.where(enters, jnp.maximum(t0, t), t0)
        kind1, t1 = jnp.where(leaves & (t < t1), name, kind1), jnp.where(leaves, jnp.minimum(t1, t), t1)
        kept = kept & ((d0 >= 0) | (d1 >= 0))
    return (t0, kind0), (t1, kind1), kept & (t1 > t0)
