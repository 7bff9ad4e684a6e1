"""The judge's frame of any object: a device of its own, yaw anywhere, tilt and height a little off."""

from __future__ import annotations

import math

import numpy as np

from experiments.judge.device import Device
from experiments.judge.frames import HEIGHT_M, JudgeFrame, Setup, frame_of, surface
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar

STREAM = 8_000_000
"""Random streams of these frames: apart from those of `frames` and `leaning`."""


def shown(mesh: Mesh, tilt_deg: float, *, seed: int, number: int) -> JudgeFrame:
    """Frame `number` of a `seed`: the object on the floor, seen by a sonar told to be tilted by `tilt_deg` [deg].

    Half of the devices are the nominal one with a drawn display law, the others are drawn.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, STREAM + number]))
    device = Device.nominal().with_drawn_law(rng) if rng.random() < 0.5 else Device.draw(rng)
    hung = {"tilt": math.radians(tilt_deg), "height": HEIGHT_M}
    sonar = Sonar.preset("didson-hf", range_min=1.5, range_max=4.0, n_ranges=512, **hung)
    setup = Setup(0, tilt_deg, sonar, device, False)
    return frame_of(setup, surface(mesh), True, float(rng.uniform(0, 360)), rng)
