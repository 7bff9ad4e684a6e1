"""Place the objects of a data set's frame at random in the sonar's view, without overlap.

`placement_limits` computes on the host where objects may stand. `draw_layout` draws their places under `jax.jit`, and
`join_layout` joins the placed objects into one mesh.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.records import record
from sonarjax.render import floor_point
from sonarjax.render.window import Objects
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import FloorPatch, Sonar

TRIES = 64
"""Number of places that are drawn for an object. If none of them is free, the object is left out."""
SPARE_BEAMS = 4
"""Beams added to the number that an object touches: for places between the sampled ones, and beams touched in part."""
GAP_M = 0.02
"""Least distance between the circles around two objects [m]."""
OUTERMOST = 0.9
"""Central share of the angle between the outer beams, and of the lit ranges, in which the objects' origins may lie."""
AROUND = 64
"""Number of points on a circle from which the azimuths that it covers are found."""
GRID = 257
"""Number of ranges, and of azimuths, at which a place on a platform is looked for."""


class Limits(NamedTuple):
    """Where the origins of objects may lie."""

    near: float
    """Smallest slant range of an origin [m]."""
    far: float
    """Largest slant range of an origin [m]."""
    left: float
    """Starboard-most azimuth of an origin [rad]."""
    right: float
    """Port-most azimuth of an origin [rad]."""


@record
class Layout:
    """The objects of a frame. Unused entries come last."""

    mesh: Int[Array, "object"]
    """Index of each object's mesh."""
    pose: Pose
    """Pose of each object; its fields have shape (object,)."""
    there: Bool[Array, "object"]
    """Whether the object exists; False for unused entries."""


def placement_limits(sonar: Sonar, name: str = "sonar") -> Limits:
    """Compute where objects can stand on the floor that `sonar` lights, within its ranges and beams.

    Args:
        sonar: The sonar.
        name: What an error message begins with.

    Raises:
        SonarjaxError: The sonar sees no floor, or its platform lies outside the limits.
    """
    height, tilt, half = (float(v) for v in (sonar.height, sonar.tilt, sonar.elevation_aperture / 2))
    steep, flat = tilt + half, tilt - half
    low, high = float(sonar.range_min), float(sonar.range_max)
    near = max(low, height / math.sin(min(steep, math.pi / 2))) if steep > 0 else math.inf
    far = min(high, height / math.sin(flat)) if flat > 0 else high
    if not near < far:
        raise SonarjaxError(
            f"{name}: the sonar sees no floor: expected tilt_deg, height_m and elevation_aperture_deg that light it "
            f"at ranges from {low:g} to {high:g} m"
        )
    margin = (1 - OUTERMOST) / 2 * (far - near)
    azimuth = np.asarray(sonar.azimuth)
    middle, half_view = (azimuth.min() + azimuth.max()) / 2, OUTERMOST * ((azimuth.max() - azimuth.min()) / 2)
    limits = Limits(near + margin, far - margin, float(middle - half_view), float(middle + half_view))
    return limits if sonar.floor is None else _on_platform(limits, sonar, name)


def _on_platform(limits: Limits, sonar: Sonar, name: str) -> Limits:
    """The part of `limits` that holds the sonar's platform: few of the places that are drawn are then beside it."""
    slant, azimuth = np.linspace(*limits[:2], GRID), np.linspace(*limits[2:], GRID)
    assert sonar.floor is not None
    on = np.asarray(_is_on(sonar.floor, *floor_point(slant[:, None], azimuth, sonar)))
    if not on.any():
        left, right = np.degrees(limits[2:])
        raise SonarjaxError(
            f"{name}: floor: expected a platform in view, with places at ranges from {limits.near:.4g} to "
            f"{limits.far:.4g} m and azimuths from {left:.4g} to {right:.4g} deg"
        )
    ends = []
    for values, there in ((slant, on.any(axis=1)), (azimuth, on.any(axis=0))):
        first, last = np.flatnonzero(there)[[0, -1]]
        ends += [float(values[max(first - 1, 0)]), float(values[min(last + 1, GRID - 1)])]
    return Limits(*ends)


def _is_on(floor: FloorPatch, x: Any, y: Any) -> Any:
    """Whether points of the ground (x, y) [m] lie on a platform."""
    cos, sin = jnp.cos(jnp.asarray(floor.yaw)), jnp.sin(jnp.asarray(floor.yaw))
    along, across = cos * (x - floor.x) + sin * (y - floor.y), cos * (y - floor.y) - sin * (x - floor.x)
    return (jnp.abs(along) <= floor.length / 2) & (jnp.abs(across) <= floor.width / 2)


def touched_beams(meshes: Mesh, sonar: Sonar, limits: Limits) -> int | None:
    """Upper bound of the number of beams that one object of `meshes` (mesh, ...) touches at any place.

    Computed for a vertical cylinder that encloses any of the meshes, at a grid of places within the limits.

    Returns:
        The number of beams; None if all beams are needed.
    """
    if float(sonar.roll) != 0.0:
        return None
    slant, azimuth = np.meshgrid(np.linspace(*limits[:2], 9), np.linspace(*limits[2:], 9))
    x, y = (np.asarray(v)[..., None, None] for v in floor_point(slant, azimuth, sonar))
    around = np.linspace(0, 2 * math.pi, AROUND)
    # Enlarge the radius, so that the polygon through the points encloses the circle.
    radius = float(np.max(np.asarray(meshes.radius))) / math.cos(math.pi / AROUND)
    heights = np.array([[0.0], [max(0.0, float(np.max(np.asarray(meshes.top))))]])
    tilt = float(sonar.tilt)
    forward = math.cos(tilt) * (x + radius * np.cos(around)) + math.sin(tilt) * (float(sonar.height) - heights)
    if (forward <= 0).any():
        return None
    seen = np.arctan2(y + radius * np.sin(around), forward)
    width = np.ptp(seen.reshape(*seen.shape[:2], -1), axis=-1).max()
    beams = math.ceil(width / float(np.diff(np.asarray(sonar.azimuth)).min(initial=math.inf))) + SPARE_BEAMS
    return beams if beams < sonar.n_beams else None


def draw_layout(meshes: Mesh, sonar: Sonar, limits: Limits, scenes: int, *, key: Array) -> Layout:
    """Draw one to `scenes` objects of `meshes` (mesh, ...) at random places and yaws that do not overlap.

    The number of objects is drawn uniformly. An object is left out if none of `TRIES` places is free for it. Where the
    sonar has a platform, origins lie on it. The vertical cylinders around the objects' origins are kept apart, so that
    objects do not overlap at any yaw.
    """
    many = meshes.vertices.shape[0]
    # All numbers are drawn in one call, because each separate draw would add compile time.
    numbers = jax.random.uniform(key, (scenes + 1, 2 + 2 * TRIES))
    wanted = 1 + jnp.floor(scenes * numbers[-1, 0])
    objects: list[tuple[Array, ...]] = []
    for number in range(scenes):
        mesh = jnp.minimum(jnp.floor(many * numbers[number, 0]).astype(jnp.int32), many - 1)
        yaw = 2 * math.pi * numbers[number, 1]
        share = numbers[number, 2:].reshape(2, TRIES)
        slant = limits.near + (limits.far - limits.near) * share[0]
        azimuth = limits.left + (limits.right - limits.left) * share[1]
        x, y = floor_point(slant, azimuth, sonar)
        free = jnp.full(TRIES, number < wanted)
        if sonar.floor is not None:
            free &= _is_on(sonar.floor, x, y)
        for _, other_x, other_y, _, radius, there in objects:
            apart = jnp.hypot(x - other_x, y - other_y) > radius + meshes.radius[mesh] + GAP_M
            free &= apart | ~there
        best = jnp.argmax(free)
        objects.append((mesh, x[best], y[best], yaw, meshes.radius[mesh], free[best]))
    mesh, x, y, yaw, _, there = (jnp.stack(v) for v in zip(*objects, strict=True))
    order = jnp.argsort(~there)  # stable sort that puts existing objects first
    mesh, x, y, yaw, there = (v[order] for v in (mesh, x, y, yaw, there))
    return Layout(mesh, Pose(x, y, yaw), there)


def join_layout(meshes: Mesh, layout: Layout, room: int) -> tuple[Mesh, Objects]:
    """Join the objects into one mesh in the ground frame, and record which object each triangle belongs to.

    Objects that do not exist are shrunk to a point of the first object, where they are invisible. The mesh has capacity
    for `room` times as many triangles in a slice as one object can have there.
    """
    count = len(layout.there)
    picked = jax.tree.map(lambda v: v[layout.mesh], meshes)
    vertices = jax.vmap(lambda pose, own: pose.to_ground(own))(layout.pose, picked.vertices)
    vertices = jnp.where(layout.there[:, None, None], vertices, vertices[0, 0])
    offset = vertices.shape[1] * jnp.arange(count, dtype=jnp.int32)
    n_faces = picked.faces.shape[1]
    joined = replace(
        picked,
        vertices=vertices.reshape(-1, 3),
        faces=(picked.faces + offset[:, None, None]).reshape(-1, 3),
        crease=(picked.crease + offset[:, None]).reshape(-1),
        closed=picked.closed.all(),
        radius=picked.radius.max(),
        top=picked.top.max(),
        crossings=min(room * meshes.crossings, count * n_faces),
        front=min(room * count * meshes.front, count * n_faces),
        events=count * min(meshes.events, picked.crease.shape[1]),
        intersecting=meshes.intersecting,  # the objects stand apart
        reflectivity=None if picked.reflectivity is None else picked.reflectivity.reshape(-1),
    )
    return joined, Objects(jnp.repeat(jnp.arange(count), n_faces), count)
