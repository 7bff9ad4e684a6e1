"""Devices that are drawn for validation: their geometry is a little off what the recognizer is told."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, sonar_for
from sonarjax.data.materials import draw_reflectivity
from sonarjax.sensor import SensorModel

TILT_STD, HEIGHT_STD = math.radians(0.6), 0.006
"""Standard deviations of the true tilt [rad] and height [m] from what the recognizer is told."""
ASIDE_M, AHEAD_M = 0.12, 0.1
"""Largest distance of an object from the middle of the view, to the side and ahead [m]."""


class DrawnDevice(NamedTuple):
    """A device, its true geometry, and the object that it sees."""

    sonar: sj.Sonar
    """The true sonar: its tilt and height are a little off what the recognizer is told."""
    model: SensorModel
    """How it makes an image."""
    mesh: sj.Mesh
    """What is shown, as bright as it is."""
    start: sj.Pose
    """Where it stands first [m, rad]."""
    odd: bool
    """Whether the device is of the widest family, and faces of the object are unevenly bright."""


def draw_device(
    mesh: sj.Mesh, tilt_deg: float, severities: tuple[float, float], *, wide: float = 0.0, key: jax.Array
) -> DrawnDevice:
    """A device of a severity between two, told to be tilted by `tilt_deg` [deg], and the object at any yaw.

    The object stands near the middle of the view. A share `wide` of the devices is odd.
    """
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 1), (6,)), float)
    normal = np.asarray(jax.random.normal(jax.random.fold_in(key, 2), (2,)), float)
    nominal = sonar_for(tilt_deg)
    sonar = nominal.replace(
        tilt=jnp.float32(math.radians(tilt_deg) + TILT_STD * normal[0]),
        height=jnp.float32(float(nominal.height) + HEIGHT_STD * normal[1]),
    )
    ahead, aside = (2 * draws[0] - 1) * AHEAD_M, (2 * draws[1] - 1) * ASIDE_M
    start = sj.Pose(GROUND_RANGE_M[tilt_deg] + ahead, aside, 2 * math.pi * draws[2])
    severity = severities[0] + (severities[1] - severities[0]) * draws[3]
    odd = bool(draws[4] < wide)
    model = (SensorModel.draw_wide if odd else SensorModel.draw)(key=jax.random.fold_in(key, 3), severity=severity)
    ground = replace(mesh, vertices=start.to_ground(mesh.vertices))
    painted = draw_reflectivity(ground, sonar.height, mesh.n_faces, key=jax.random.fold_in(key, 4))
    mesh = replace(mesh, reflectivity=painted if odd else jnp.ones(mesh.n_faces))
    return DrawnDevice(sonar, model, mesh, start, odd)
