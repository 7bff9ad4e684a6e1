"""Views as in §3.1: a DIDSON at a tilt of Table 1, in the tank of Table 1, with the object near its usual place.

Table 1 puts the object 1.6 m ahead, which at 15° and 20° lies outside the aperture. Here it stands where the floor is
lit, as in the test frames, and is displaced by the translations of Table 1.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.data.draws import Stream
from sonarjax.data.shapes import wall_vertices
from sonarjax.data.views import DIDSON_BIN_M, DIDSON_SPACING, TILTS, View
from sonarjax.scene import Pose
from sonarjax.scene.objects import TANK_M
from sonarjax.sonar import FloorPatch, Sonar
from sonarjax.sonar.presets import HEIGHT_M

GROUND_RANGES_M = (2.45, 2.30, 2.10)
"""Ground range of the object at each tilt of Table 1 [m]."""
TRANSLATION_M = 0.15
"""Largest translation in x and y (Table 1) [m]."""
BEHIND_M = 0.3
"""Least distance of the far wall behind the object's origin [m]."""
MOUNT_RAD, MOUNT_M, TURN_RAD = math.radians(0.5), 0.01, math.radians(1.0)
"""Standard deviations of the mounting: tilt [rad] and height [m] of the head, and its angle to the walls [rad]."""


def draw_tank_view(n_ranges: int, n_beams: int, *, key: Array) -> View:
    """Draw a random view of §3.1 for images (n_ranges, n_beams): tilt, place, yaw, and the position of the walls."""
    stream = Stream(16, key=key)
    chosen = stream.pick((1.0, 1.0, 1.0))
    tilt = jnp.array(TILTS)[chosen] + MOUNT_RAD * stream.normal()
    height = HEIGHT_M + MOUNT_M * stream.normal()
    aside = stream.between(-TRANSLATION_M, TRANSLATION_M)
    ahead = jnp.array(GROUND_RANGES_M)[chosen] + stream.between(-TRANSLATION_M, TRANSLATION_M)
    pose = Pose(ahead, aside, stream.between(0.0, 2 * math.pi))
    window = n_ranges * DIDSON_BIN_M
    near = jnp.hypot(ahead, height) - window * stream.between(0.2, 0.6)
    length, width, depth = TANK_M
    far = stream.between(ahead + BEHIND_M, length)  # the head is inside the tank, somewhere before its near wall
    turned = TURN_RAD * stream.normal()
    walls = wall_vertices(jnp.array([length, width, depth]), jnp.stack([far - length / 2, jnp.zeros(())]), turned)
    place = 2 * (jnp.arange(n_beams) + 0.5) / n_beams - 1
    sonar = Sonar(
        azimuth=DIDSON_SPACING * n_beams / 2 * place,
        range_min=near,
        range_max=near + window,
        elevation_aperture=jnp.float32(math.radians(14.0)),
        tilt=tilt,
        height=height,
        roll=jnp.zeros(()),
        frequency=jnp.float32(1.8e6),
        floor=FloorPatch(far - length / 2, jnp.zeros(()), jnp.float32(length), jnp.float32(width), turned),
        n_ranges=n_ranges,
    )
    return View(sonar, pose, walls, jnp.array(True))
