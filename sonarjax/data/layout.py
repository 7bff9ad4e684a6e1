"""Where the objects of a data set's frame stand: places in the sonar's view, none of which overlap.

`placement_limits` looks at the sonar on the host, `draw_layout` draws under jit, `join_layout` makes one mesh of it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.records import record
from sonarjax.render import floor_point
from sonarjax.render.window import Objects
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

TRIES = 64
"""Places that are drawn for an object; it is left out where all of them are taken."""
SPARE_BEAMS = 4
"""Beams on top of what an object touches: for the places between those that were looked at, and cut beams."""
GAP_M = 0.02
"""Least distance between the circles around two objects [m]."""
OUTERMOST = 0.9
"""Share of the field of view, and of the lit ranges, in which the objects' origins lie."""
AROUND = 64
"""Points of a circle, by which its azimuths are found."""


class Limits(NamedTuple):
    """Where objects may stand."""

    near: float
    """Least slant range of an origin [m]."""
    far: float
    """Largest slant range [m]."""
    left: float
    """Starboard-most azimuth of an origin [rad]."""
    right: float
    """Port-most azimuth [rad]."""


@record
class Layout:
    """The objects of a frame; what is not there comes last."""

    mesh: Int[Array, "object"]
    """Number of each object's mesh."""
    pose: Pose
    """Where each stands: fields (object,)."""
    there: Bool[Array, "object"]
    """Whether there is such an object."""


def placement_limits(sonar: Sonar, name: str = "sonar") -> Limits:
    """Where on lit floor in the window of `sonar` objects can stand; `name` opens the message.

    Raises SonarjaxError when the sonar sees no floor.
    """
    height, tilt, half = (float(v) for v in (sonar.height, sonar.tilt, sonar.elevation_aperture / 2))
    steep, flat = tilt + half, tilt - half
    low, high = float(sonar.range_min), float(sonar.range_max)
    near = max(low, height / math.sin(min(steep, math.pi / 2))) if steep > 0 else math.inf
    far = min(high, height / math.sin(flat)) if flat > 0 else high
    if not near < far:
        raise SonarjaxError(
            f"{name}: the sonar sees no floor: expected tilt_deg, height_m and elevation_aperture_deg that light floor "
            f"at ranges from {low:g} to {high:g} m"
        )
    margin = (1 - OUTERMOST) / 2 * (far - near)
    azimuth = OUTERMOST * np.asarray(sonar.azimuth)
    return Limits(near + margin, far - margin, float(azimuth.min()), float(azimuth.max()))


def touched_beams(meshes: Mesh, sonar: Sonar, limits: Limits) -> int | None:
    """Upper bound of the beams that one object of `meshes` (mesh, ...) touches anywhere; None for all of them.

    Of the cylinders around the objects' origins, at places all over the limits.
    """
    if float(sonar.roll) != 0.0:
        return None
    slant, azimuth = np.meshgrid(np.linspace(*limits[:2], 9), np.linspace(*limits[2:], 9))
    x, y = (np.asarray(v)[..., None, None] for v in floor_point(slant, azimuth, sonar))
    around = np.linspace(0, 2 * math.pi, AROUND)
    radius = float(np.max(np.asarray(meshes.radius))) / math.cos(math.pi / AROUND)  # the circle is inside its polygon
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
    """One to `scenes` objects of `meshes` (mesh, ...) at random places and yaws; none overlaps another.

    How many is drawn evenly. An object that finds no place in `TRIES` is left out. Overlap is judged by the vertical
    cylinders around the objects' origins, so that it is ruled out whatever their yaw.
    """
    many = meshes.vertices.shape[0]
    numbers = jax.random.uniform(key, (scenes + 1, 2 + 2 * TRIES))  # at once: each draw of its own compiles for long
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
        for _, other_x, other_y, _, radius, there in objects:
            apart = jnp.hypot(x - other_x, y - other_y) > radius + meshes.radius[mesh] + GAP_M
            free &= apart | ~there
        best = jnp.argmax(free)
        objects.append((mesh, x[best], y[best], yaw, meshes.radius[mesh], free[best]))
    mesh, x, y, yaw, _, there = (jnp.stack(v) for v in zip(*objects, strict=True))
    order = jnp.argsort(~there)  # stable: what is there first
    mesh, x, y, yaw, there = (v[order] for v in (mesh, x, y, yaw, there))
    return Layout(mesh, Pose(x, y, yaw), there)


def join_layout(meshes: Mesh, layout: Layout, room: int) -> tuple[Mesh, Objects]:
    """One mesh in the ground frame of the objects that are there, and which triangle is whose.

    What is not there shrinks to a point of the first object, where nothing sees it. There is room for `room` times as
    many triangles in a slice as one object can have there.
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
        reflectivity=None,
    )
    return joined, Objects(jnp.repeat(jnp.arange(count), n_faces), count)
