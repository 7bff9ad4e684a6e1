"""The simulated frames of §4.1 as DESIGN.md sets them, shared by the experiments that need them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj

TILTS_DEG = (15.0, 20.0, 25.0)
GROUND_RANGE_M = {15.0: 2.45, 20.0: 2.30, 25.0: 2.10}


@dataclass(frozen=True)
class TestFrame:
    """One frame and its truth."""

    __test__ = False  # not a test case, whatever pytest thinks of the name

    image: np.ndarray
    """Grey frame (range, beam) in [0, 1]."""
    clean: np.ndarray
    """Semantic image (range, beam) without noise."""
    is_target: bool
    """True for the target, False for the non-target."""
    yaw: float
    """True yaw [rad]."""
    tilt_deg: float
    """Tilt of the sonar [deg]."""


def sonar_for(tilt_deg: float) -> sj.Sonar:
    """DIDSON high frequency in the tank, at one tilt [deg]."""
    return sj.Sonar.preset("didson-hf", tilt=math.radians(tilt_deg))


def grey_frame(frame: sj.SonarFrame, sonar: sj.Sonar, *, key: jax.Array) -> jax.Array:
    """A plain grey picture (range, beam) of the energy: spreading undone, Rayleigh speckle, square root, 8 bits.

    A stand-in until the sensor model lands: no beam pattern, no crosstalk, no multipath.
    """
    ranges = (sonar.range_edges[1:] + sonar.range_edges[:-1])[:, None] / 2
    level = frame.intensity * ranges**3
    speckle = jax.random.exponential(key, level.shape)  # of the intensity: its square root is Rayleigh
    floor = 0.02 * jnp.quantile(level, 0.99) * jax.random.exponential(jax.random.fold_in(key, 1), level.shape)
    amplitude = jnp.sqrt(jnp.sqrt(level * speckle + floor))
    return jnp.round(255 * jnp.clip(amplitude / jnp.quantile(amplitude, 0.999), 0, 1)) / 255


def paper_frames(seed: int, *, yaw_offset_deg: float = 0.0, step_deg: int = 10) -> list[TestFrame]:
    """Four sets (tilts 15, 20, 25° and one drawn of them) of target and non-target, yaw in steps of `step_deg`.

    With steps of 10° these are the 288 frames of §4.1. `yaw_offset_deg` adds a uniform offset within ± that to each.
    """
    key = jax.random.key(seed)
    drawn = TILTS_DEG[int(jax.random.randint(jax.random.fold_in(key, 10**6), (), 0, 3))]
    frames = []

    @jax.jit
    def simulate(mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
        frame = sj.render(mesh, pose, sonar, sub_beams=2)
        return grey_frame(frame, sonar, key=noise), frame.semantic()

    for number, tilt in enumerate((*TILTS_DEG, drawn)):
        sonar = sonar_for(tilt)
        for is_target, mesh in ((True, sj.objects.target()), (False, sj.objects.non_target())):
            for yaw_deg in range(0, 360, step_deg):
                part = jax.random.fold_in(key, (number * 2 + is_target) * 360 + yaw_deg)
                offset = jax.random.uniform(part, (), minval=-1.0, maxval=1.0) * math.radians(yaw_offset_deg)
                yaw = math.radians(yaw_deg) + float(offset)
                pose = sj.Pose(x=jnp.float32(GROUND_RANGE_M[tilt]), y=jnp.float32(0.0), yaw=jnp.float32(yaw))
                image, clean = simulate(mesh, pose, sonar, jax.random.fold_in(part, 7))
                frames.append(TestFrame(np.asarray(image), np.asarray(clean), is_target, yaw, tilt))
    return frames
