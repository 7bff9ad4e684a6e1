"""The judge's frames of objects that lean and float a little above the floor, seen once or from two sides."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.judge.device import Device
from experiments.judge.frames import (
    BEARING_SLACK_DEG,
    GROUND_RANGE_M,
    HEIGHT_M,
    HEIGHT_SLACK_M,
    RANGE_SLACK_M,
    TILT_SLACK_DEG,
    Triangles,
    surface,
)
from experiments.judge.raycast import cast
from experiments.judge.sensor import store
from experiments.judge.view import View
from sonarjax.scene import objects
from sonarjax.sonar import Sonar

LEAN_DEG, LIFT_M = 15.0, 0.05
"""Largest roll and pitch [°], and largest height of the lowest point above the floor [m]."""
TURN = math.pi / 2
"""By how much the second view's sonar is turned about the vertical [rad]."""
STREAM = 7_000_000
"""Random streams of these frames: apart from those of `frames`."""


@dataclass(frozen=True)
class LeaningFrame:
    """One object and the frames of it."""

    images: np.ndarray
    """Grey frames (view, range, beam), float32 in [0, 1]; 8 bits deep."""
    pose: np.ndarray
    """True x, y, z [m], yaw, roll and pitch [rad] in the first sonar's ground frame."""
    sonars: np.ndarray
    """x, y [m] and heading [rad] (view, 3) of each sonar in the first one's ground frame."""
    sonar: Sonar
    """The nominal sonar, as the estimator is told."""


def leaning_frames(seed: int, count: int, tilt_deg: float, geometry_known: bool) -> Iterator[LeaningFrame]:
    """`count` leaning targets, each seen from two sides 90° apart; the same for the same seed.

    Yaw is uniform, roll and pitch within 15°, the lowest point up to 5 cm above the floor. Every other device is a
    nominal one with a drawn display law, the rest are drawn. Tilt and height are a little off unless `geometry_known`.
    """
    shape = surface(objects.target())
    for number in range(count):
        rng = np.random.Generator(np.random.Philox(key=[seed, STREAM + number]))
        device = Device.nominal().with_drawn_law(rng) if number % 2 == 0 else Device.draw(rng)
        yield _frame(shape, device, tilt_deg, geometry_known, rng)


def rotation(yaw: float, roll: float, pitch: float) -> np.ndarray:
    """Rotation (3, 3): roll about the object's x axis, then pitch about y, then yaw about the vertical [rad]."""
    (cy, sy), (cr, sr), (cp, sp) = ((math.cos(a), math.sin(a)) for a in (yaw, roll, pitch))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return about_z @ about_y @ about_x


def _frame(
    shape: Triangles, device: Device, tilt_deg: float, geometry_known: bool, rng: np.random.Generator
) -> LeaningFrame:
    yaw = rng.uniform(0, 2 * math.pi)
    roll, pitch = np.radians(LEAN_DEG) * rng.uniform(-1, 1, 2)
    lowest = (shape[0] @ rotation(yaw, roll, pitch).T)[:, 2].min()
    z = rng.uniform(0, LIFT_M) - lowest
    off = 0.0 if geometry_known else 1.0
    tilt = math.radians(tilt_deg + off * TILT_SLACK_DEG * rng.uniform(-1, 1))
    height = HEIGHT_M + off * HEIGHT_SLACK_M * rng.uniform(-1, 1)
    sonar = Sonar.preset(
        "didson-hf", range_min=1.5, range_max=4.0, n_ranges=512, tilt=math.radians(tilt_deg), height=HEIGHT_M
    )
    view = View.of(sonar, tilt, height, device.sound_speed_ratio, device.conical)
    images, seen = [], []
    for turned in (0.0, TURN):
        away = GROUND_RANGE_M[tilt_deg] + RANGE_SLACK_M * rng.uniform(-1, 1)
        bearing = math.radians(BEARING_SLACK_DEG * rng.uniform(-1, 1))
        x, y = away * math.cos(bearing), away * math.sin(bearing)
        placed = shape[0] @ rotation(yaw - turned, roll, pitch).T + [x, y, z]
        images.append(store(cast(placed[shape[1]], view), device, rng).astype(np.float32) / 255)
        seen.append((x, y, turned))
    (x, y, _), second = seen
    c, s = math.cos(TURN), math.sin(TURN)
    beside = x - (c * second[0] - s * second[1]), y - (s * second[0] + c * second[1]), TURN
    pose = np.array([x, y, z, yaw, roll, pitch])
    return LeaningFrame(np.stack(images), pose, np.array([(0.0, 0.0, 0.0), beside]), sonar)
