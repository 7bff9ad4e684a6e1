"""The judge's frames of given objects at any yaw, each by a device of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from experiments.judge.device import Device
from experiments.judge.frames import (
    BEARING_SLACK_DEG,
    GROUND_RANGE_M,
    HEIGHT_SLACK_M,
    RANGE_SLACK_M,
    TILT_SLACK_DEG,
    surface,
)
from experiments.judge.raycast import cast, place
from experiments.judge.sensor import store
from experiments.judge.view import View
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar

STREAM = 8_000_000
"""Random streams of these frames: apart from those of `frames` and `leaning`."""


class TurnedFrame(NamedTuple):
    """One frame and its truth."""

    image: np.ndarray
    """Grey frame (range, beam), float32 in [0, 1]; 8 bits deep."""
    yaw: float
    """True yaw [rad], in [0, 2π)."""
    exact: bool
    """Whether the nominal tilt and height are the true ones."""


def turned_frames(seed: int, meshes: Sequence[Mesh], sonar: Sonar, tilt_deg: float) -> Iterator[TurnedFrame]:
    """A frame of each mesh in turn, at a uniform yaw; the same for the same seed.

    Devices are drawn. Tilt and height are those of the nominal `sonar` in every other frame, else a little off.
    """
    shapes = {id(mesh): surface(mesh) for mesh in meshes}
    for number, mesh in enumerate(meshes):
        rng = np.random.Generator(np.random.Philox(key=[seed, STREAM + number]))
        device, yaw, exact = Device.draw(rng), rng.uniform(0, 2 * math.pi), number % 2 == 0
        slack = rng.uniform(-1, 1, 4) * [1.0, 1.0, 0.0 if exact else 1.0, 0.0 if exact else 1.0]
        tilt = math.radians(tilt_deg + TILT_SLACK_DEG * slack[2])
        height = float(sonar.height) + HEIGHT_SLACK_M * slack[3]
        away = GROUND_RANGE_M[tilt_deg] + RANGE_SLACK_M * slack[0]
        bearing = math.radians(BEARING_SLACK_DEG * slack[1])
        view = View.of(sonar, tilt, height, device.sound_speed_ratio, device.conical)
        placed = place(*shapes[id(mesh)], away * math.cos(bearing), away * math.sin(bearing), yaw)
        yield TurnedFrame(store(cast(placed, view), device, rng).astype(np.float32) / 255, yaw, exact)
