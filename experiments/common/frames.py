"""The simulated frames of §4.1 as DESIGN.md sets them, shared by the experiments that need them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.progress import Progress
from sonarjax.data.tank_views import BEHIND_M, GROUND_RANGES_M, TRANSLATION_M
from sonarjax.scene.objects import TANK_M
from sonarjax.sensor import SensorModel, observe_scene

TILTS_DEG = (15.0, 20.0, 25.0)
VALIDATION_SEED = 1000
"""Added to a run's seed where something is fitted: test frames have seeds below it."""
STEP_DEG = 5
"""Yaw steps are a multiple of it. Numbers 1 to 3 of a seed's key are training's (`sonarjax.data.split_key`)."""
GROUND_RANGE_M = dict(zip(TILTS_DEG, GROUND_RANGES_M, strict=True))


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


@cache
def sonar_for(tilt_deg: float) -> sj.Sonar:
    """DIDSON high frequency in the tank, at one tilt [deg]: one object a tilt."""
    return sj.Sonar.preset("didson-hf", tilt=math.radians(tilt_deg))


def paper_frames(
    seed: int,
    *,
    yaw_offset_deg: float = 0.0,
    step_deg: int = 10,
    severity: float = 1.0,
    drawn: bool = False,
    other: sj.Mesh | None = None,
    model: SensorModel | None = None,
    tilts_deg: Sequence[float] = TILTS_DEG,
    tank: bool = False,
) -> list[TestFrame]:
    """Four sets (tilts 15, 20, 25° and one drawn of them) of target and non-target, yaw in steps of `step_deg`.

    With steps of 10° these are the 288 frames of §4.1. `yaw_offset_deg` adds a uniform offset within ± that to each.
    The sensor is the nominal DIDSON at `severity`, or with `drawn` another device of the family for every frame.
    `other` takes the non-target's place, `model` the sensor's, and `tilts_deg` that of the tilts. With `tank` the
    object stands in the tank of Table 1, moved by one of its translations.

    No key of a frame is one of training's pairs. Raises SonarjaxError for a tilt that is not one of §4.1, or a step
    that is no multiple of 5° or does not divide the circle.
    """
    if step_deg < STEP_DEG or step_deg % STEP_DEG or 360 % step_deg:
        raise sj.SonarjaxError(f"step_deg: expected a multiple of {STEP_DEG} that divides 360, got {step_deg}")
    for tilt in tilts_deg:
        if tilt not in GROUND_RANGE_M:
            raise sj.SonarjaxError(
                f"tilts_deg: expected some of {', '.join(f'{t:g}' for t in TILTS_DEG)}, got {tilt:g}"
            )
    key = jax.random.key(seed)
    tilt_drawn = tilts_deg[int(jax.random.randint(jax.random.fold_in(key, 10**6), (), 0, len(tilts_deg)))]
    meshes = sj.objects.target(), sj.objects.non_target() if other is None else other
    cases = [
        (number, tilt, is_target, yaw_deg)
        for number, tilt in enumerate((*tilts_deg, tilt_drawn))
        for is_target in (True, False)
        for yaw_deg in range(0, 360, step_deg)
    ]

    def simulate(case: tuple[int, float, bool, int]) -> TestFrame:
        number, tilt, is_target, yaw_deg = case
        part = jax.random.fold_in(key, (number * 2 + is_target) * 360 + yaw_deg)
        offset = float(jax.random.uniform(part, (), minval=-1.0, maxval=1.0)) * math.radians(yaw_offset_deg)
        yaw = math.radians(yaw_deg) + offset
        pose = sj.Pose(GROUND_RANGE_M[tilt], 0.0, yaw)
        sensor = _device(severity, drawn, key=jax.random.fold_in(part, 3)) if model is None else model
        mesh = meshes[0] if is_target else meshes[1]
        look = partial(observed_in_tank, place_key=jax.random.fold_in(part, 5)) if tank else observed
        image, clean = look(mesh, pose, sonar_for(tilt), sensor, key=jax.random.fold_in(part, 7))
        return TestFrame(np.asarray(image), np.asarray(clean), is_target, yaw, tilt)

    with Progress("simulating frames", len(cases), unit="frame", leave=False) as progress:

        def one(case: tuple[int, float, bool, int]) -> TestFrame:
            number, tilt, is_target, yaw_deg = case
            with progress.part(f"set {number}, {'target' if is_target else 'other'}, {tilt:g}°, yaw {yaw_deg}°"):
                return simulate(case)

        # The first of each mesh alone: else each thread would compile it.
        first = [cases[0], next(case for case in cases if not case[2])]
        done = dict(zip(first, map(one, first), strict=True))
        left = [case for case in cases if case not in done]
        done |= zip(left, engine().map(one, left), strict=True)
    return [done[case] for case in cases]


def _device(severity: float, drawn: bool, *, key: jax.Array) -> SensorModel:
    return SensorModel.draw(key=key, severity=severity) if drawn else SensorModel.nominal(severity)


def observed(
    mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, model: SensorModel, *, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """What a sonar sees of an object, and the true semantic image: both (range, beam) in [0, 1].

    The one compiled function that draws the experiments' frames: objects of about as many triangles share its code.
    """
    model = jax.tree.map(jnp.float32, model)  # whole or fractions, in the same compiled code
    return _observed(mesh, pose, sonar, model, key)


@jax.jit
def _observed(
    mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, model: SensorModel, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    image, frame = observe_scene(mesh, pose, sonar, model, key=key)
    return image, frame.semantic()


def observed_in_tank(
    mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, model: SensorModel, *, place_key: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The same in the tank of Table 1, where walls are seen too; the semantic image is that of the object alone.

    `place_key` draws one of Table 1's translations in x and in y, and how far behind the object the far wall is.
    """
    moved = jax.random.randint(place_key, (2,), -1, 2) * TRANSLATION_M
    pose = sj.Pose(pose.x + moved[0], pose.y + moved[1], pose.yaw)
    behind = jax.random.uniform(jax.random.fold_in(place_key, 1))
    length, width, _ = TANK_M
    far = pose.x + BEHIND_M + behind * (length - pose.x - BEHIND_M)
    middle = far - length / 2
    in_tank = sonar.replace(floor=sj.FloorPatch(middle, 0.0, length, width))
    clean = sj.render(mesh, pose, in_tank).semantic()
    walls = sj.Pose(middle, 0.0, 0.0)
    image, _ = observe_scene((mesh, _tank()), (pose, walls), in_tank, model, key=key)
    return image, clean


@cache
def _tank() -> sj.Mesh:
    return sj.objects.tank()
