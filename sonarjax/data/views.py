"""From where a pair is seen: a sonar of the family around DIDSON, ARIS and Oculus, the object's place, the tank's
walls.

Image sizes are fixed. Everything that varies between devices is a traced float: beam azimuths, evenly spaced or not,
range window, tilt, height and aperture. So one compiled function draws them all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sonarjax.data.draws import Stream
from sonarjax.data.shapes import wall_vertices
from sonarjax.scene import Pose
from sonarjax.scene.objects import TANK_M
from sonarjax.sonar import FloorPatch, Sonar

TILTS = (math.radians(15.0), math.radians(20.0), math.radians(25.0))
"""Tilts of Table 1 [rad]; a quarter of the views has another tilt between 12° and 36°."""
TABLE_SHARE = 0.75
"""Probability that the tilt is one of Table 1's, give or take 1.5°."""
DIDSON_SHARE = 0.4
"""Probability that beams and range bins are those of §4.1."""
DIDSON_SPACING, DIDSON_BIN_M = math.radians(29.0 / 96), 2.5 / 512
WALLS_SHARE, PLATFORM_SHARE = 0.4, 0.1
"""Probability that there are tank walls, and that the floor is a platform slightly larger than the object."""
FREQUENCIES = (1.1e6, 1.8e6, 2.1e6, 3.0e6)
"""Frequencies of other devices [Hz]."""
NO_END_M = 1e3
"""Side of a floor that is endless for practical purposes [m]."""


class View(NamedTuple):
    """One view of an object."""

    sonar: Sonar
    """The sonar; its floor is a tank's, a platform, or very large."""
    pose: Pose
    """The object's pose."""
    walls: Float[Array, "wall 3"]
    """Corners of the tank [m], even if there are no walls."""
    has_walls: Bool[Array, ""]
    """True if there are walls."""


def draw_view(n_ranges: int, n_beams: int, *, key: Array) -> View:
    """Draw a random view for images (n_ranges, n_beams), with the object's origin somewhere in it, on lit floor."""
    stream = Stream(48, key=key)
    didson = stream.happens(DIDSON_SHARE)
    azimuth = _azimuths(n_beams, didson, stream)
    table = jnp.array(TILTS)[stream.pick((1.0, 1.0, 1.0))] + stream.between(-0.026, 0.026)
    tilt = stream.sometimes(TABLE_SHARE, table, stream.between(math.radians(12.0), math.radians(36.0)))
    height = stream.sometimes(0.6, 0.9 + 0.03 * stream.normal(), stream.between(0.6, 1.5))
    aperture = jnp.radians(stream.sometimes(0.6, 14.0, stream.between(11.0, 18.0)))
    pose, slant = _pose(azimuth, tilt, height, aperture, stream)
    length = n_ranges * jnp.where(didson, DIDSON_BIN_M, stream.log_between(0.0025, 0.009))
    near = jnp.maximum(slant - length * stream.between(0.12, 0.6), 0.4)
    walls, has_walls, floor = _surroundings(pose, stream)
    sonar = Sonar(
        azimuth=azimuth,
        range_min=near,
        range_max=near + length,
        elevation_aperture=aperture,
        tilt=tilt,
        height=height,
        roll=stream.sometimes(0.2, 0.03 * stream.normal(), 0.0),
        frequency=jnp.where(didson, 1.8e6, jnp.array(FREQUENCIES)[stream.pick((1.0, 1.0, 1.0, 1.0))]),
        floor=floor,
        n_ranges=n_ranges,
    )
    return View(sonar, pose, walls, has_walls)


def _azimuths(n_beams: int, didson: Array, stream: Stream) -> Float[Array, "beam"]:
    """Beam centres (beam,) [rad]: evenly spaced, closer at the edges as in an ARIS, or wider there as in a flat
    array.
    """
    spacing = jnp.where(didson, DIDSON_SPACING, stream.log_between(math.radians(0.2), math.radians(0.5)))
    bends = jnp.stack([jnp.zeros(()), stream.between(0.0, 0.15), stream.between(-0.06, 0.0)])
    bend = jnp.where(didson, 0.0, bends[stream.pick((0.3, 0.4, 0.3))])
    place = 2 * (jnp.arange(n_beams) + 0.5) / n_beams - 1
    return spacing * n_beams / 2 * (place + bend * (place - place**3))


def _pose(azimuth: Array, tilt: Array, height: Array, aperture: Array, stream: Stream) -> tuple[Pose, Array]:
    """The object's pose, anywhere on lit floor, and the slant range [m] of its place."""
    down = tilt + aperture * stream.between(-0.38, 0.42)
    ground = height / jnp.tan(jnp.clip(down, 0.2, 1.1))
    bearing = azimuth[-1] * stream.sometimes(0.5, stream.between(-0.3, 0.3), stream.between(-0.9, 0.9))
    yaw = stream.between(0.0, 2 * math.pi)
    return Pose(ground * jnp.cos(bearing), ground * jnp.sin(bearing), yaw), jnp.hypot(ground, height)


def _surroundings(pose: Pose, stream: Stream) -> tuple[Array, Array, FloorPatch]:
    """Corners of the walls (wall, 3) [m], whether they exist, and the floor."""
    has_walls = stream.happens(WALLS_SHARE)
    platform = stream.happens(PLATFORM_SHARE) & ~has_walls
    length, width = (side * jnp.exp(stream.between(-0.1, 0.9)) for side in TANK_M[:2])
    turned = 0.08 * stream.normal()
    # The far wall is at least 0.3 m behind the object. The tank is shifted sideways while the side walls keep as far.
    far = pose.x + stream.between(0.3, 1.6)
    aside = stream.between(-0.5, 0.5) * jnp.maximum(width - 2 * (jnp.abs(pose.y) + 0.3), 0.0)
    center = jnp.stack([far - length / 2, aside])
    walls = wall_vertices(jnp.stack([length, width, jnp.float32(TANK_M[2])]), center, turned)
    side = jnp.where(platform, stream.log_between(0.35, 1.0), NO_END_M)
    tank = (center[0], center[1], length, width, turned)
    usual = (pose.x, pose.y, side, side, pose.yaw)
    floor = FloorPatch(*(jnp.where(has_walls, a, b) for a, b in zip(tank, usual, strict=True)))
    return walls, has_walls, floor
