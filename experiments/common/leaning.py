"""Frames of objects that lean and float a little, each seen once or from two sides, drawn by the package itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from scipy.spatial.transform import Rotation

import sonarjax as sj
from experiments.common.drawn_device import draw_device
from experiments.common.frames import GROUND_RANGE_M, VALIDATION_SEED, observed, sonar_for
from experiments.common.sets import target
from experiments.common.validation import ODD, SEVERITIES, scenes
from sonarjax.refine import in_view
from sonarjax.refine.free import NUMBERS
from sonarjax.sensor import SensorModel

AHEAD_M, BEARING_DEG = 0.1, 4.0
"""Largest distance from the middle of the view, ahead [m] and aside [deg]."""


@dataclass(frozen=True)
class Case:
    """One object and its frames."""

    name: str
    """Which object it is."""
    images: np.ndarray
    """Grey frames (view, range, beam)."""
    pose: sj.Pose
    """The truth, in the first sonar's ground frame."""
    sonar_poses: sj.Pose
    """(view,) where the sonars are, in that frame."""
    sonar: sj.Sonar
    """As the estimator is told."""


@dataclass(frozen=True)
class Leaning:
    """How far objects lean, and where they are drawn."""

    tilt_deg: float = 20.0
    """Tilt of the sonar [deg], one of those of §4.1."""
    lean_deg: float = 15.0
    """Largest roll and pitch [deg]."""
    lift_m: float = 0.05
    """Largest height of the lowest point above the floor [m]."""


def target_cases(seed: int, count: int, how: Leaning) -> Iterator[Case]:
    """The paper's target `count` times, seen by drawn and nominal devices in turn; keys are no test's."""
    key = jax.random.key(VALIDATION_SEED + seed)
    for number in range(count):
        truth, sonars = _placed(target(), how, np.random.default_rng([VALIDATION_SEED + seed, number]))
        model = SensorModel.draw(key=jax.random.fold_in(key, number)) if number % 2 else SensorModel.nominal()
        sonar = sonar_for(how.tilt_deg)
        keys = [jax.random.fold_in(key, k) for k in range(10_000 + 2 * number, 10_000 + 2 * number + len(sonars))]
        yield Case("target", _seen(target(), sonar, model, truth, sonars, keys), truth, _poses(sonars), sonar)


def validation_leaning_cases(seed: int, numbers: Sequence[int], how: Leaning) -> Iterator[Case]:
    """Validation objects in turn, one for each of `numbers`, seen by drawn devices whose geometry is a little off."""
    key, names = jax.random.key(VALIDATION_SEED + seed), list(scenes())
    for number in numbers:
        name = names[number % len(names)]
        mesh, part = scenes()[name].target, jax.random.fold_in(key, 50_000 + number)
        truth, sonars = _placed(mesh, how, np.random.default_rng([VALIDATION_SEED + seed, 50_000 + number]))
        device = draw_device(mesh, how.tilt_deg, SEVERITIES, wide=ODD, key=part)
        keys = [jax.random.fold_in(part, 10 + k) for k in range(len(sonars))]
        images = _seen(device.mesh, device.sonar, device.model, truth, sonars, keys)
        yield Case(name, images, truth, _poses(sonars), sonar_for(how.tilt_deg))


def rotation(pose: sj.Pose) -> Rotation:
    """The rotation of one pose: roll, then pitch, then yaw."""
    return Rotation.from_euler("ZYX", [float(pose.yaw), float(pose.pitch), float(pose.roll)])


def errors(truth: sj.Pose, found: sj.PoseEstimate) -> np.ndarray:
    """Errors (free,) of one estimated pose [m, rad], angles within ± π."""
    away = np.array([float(getattr(found.pose, name)) - float(getattr(truth, name)) for name in found.free])
    angles = is_angle(found.free)
    return np.where(angles, (away + math.pi) % (2 * math.pi) - math.pi, away)


def is_angle(free: Sequence[str]) -> np.ndarray:
    """Which of the free numbers (free,) are angles."""
    return np.array([NUMBERS[name].unit == "rad" for name in free])


def _placed(mesh: sj.Mesh, how: Leaning, rng: np.random.Generator) -> tuple[sj.Pose, np.ndarray]:
    """A drawn pose, and x, y [m] and heading [rad] of two sonars (2, 3) that see it from 90° apart."""
    yaw, lift = rng.uniform(0, 2 * math.pi), rng.uniform(0, how.lift_m)
    roll, pitch = np.radians(how.lean_deg) * rng.uniform(-1, 1, 2)
    leaning = rotation(sj.Pose(yaw=yaw, roll=roll, pitch=pitch))
    z = lift - leaning.apply(np.asarray(mesh.vertices, float))[:, 2].min()
    away = GROUND_RANGE_M[how.tilt_deg] + AHEAD_M * rng.uniform(-1, 1, 2)
    bearing = np.radians(BEARING_DEG) * rng.uniform(-1, 1, 2)
    x, y = away * np.cos(bearing), away * np.sin(bearing)
    # The second sonar looks along y, from where it has the object in its view.
    sonars = np.array([(0.0, 0.0, 0.0), (x[0] + y[1], y[0] - x[1], math.pi / 2)])
    return sj.Pose(x[0], y[0], yaw, z, roll, pitch), sonars


def _seen(
    mesh: sj.Mesh, sonar: sj.Sonar, model: SensorModel, pose: sj.Pose, sonars: np.ndarray, keys: Sequence[jax.Array]
) -> np.ndarray:
    """The frame (range, beam) of each of the sonars (view, 3)."""
    views = zip(sonars, keys, strict=True)
    return np.stack([np.asarray(observed(mesh, in_view(pose, one), sonar, model, key=key)[0]) for one, key in views])


def sonar_rows(poses: sj.Pose) -> np.ndarray:
    """x, y [m] and heading [rad] (view, 3) of sonars."""
    return np.stack([np.asarray(v, float) for v in (poses.x, poses.y, poses.yaw)], axis=-1)


def _poses(sonars: np.ndarray) -> sj.Pose:
    return sj.Pose(sonars[:, 0], sonars[:, 1], sonars[:, 2])
