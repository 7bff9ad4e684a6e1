"""Validation frames with walls in view: the objects of `validation` in drawn tanks, which are not that of Table 1."""

from __future__ import annotations

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.drawn_device import draw_device
from experiments.common.frames import TILTS_DEG, VALIDATION_SEED
from experiments.common.validation import FAR_AWAY_M, ODD, SEVERITIES, Case, Scene, scenes, shown_in
from sonarjax.sensor import SensorModel, observe_scene

SIZES_M = (2.5, 1.2, 1.0), (6.0, 3.5, 2.5)
"""Least and largest length, width and height of a tank [m]."""
BEHIND_M = 0.3, 2.0
"""Least and largest distance of the far wall behind the object [m]."""
APART = 100_000
"""Numbers of keys from here on: no frame of `validation_cases` has them."""
TURN_STD = math.radians(3.0)
"""Standard deviation of the angle between sonar and tank [rad]."""


def walled_cases(seed: int, count: int, *, empty: bool = False) -> list[Case]:
    """`count` frames as `validation_cases` draws them, but in a tank; they have no clean image.

    If `empty`, the same tanks without an object; then no yaw is true.
    """
    return [_case(number, seed, empty) for number in range(count)]


def _case(number: int, seed: int, empty: bool) -> Case:
    names = list(scenes())
    name, rest = names[number % len(names)], number // len(names)
    shown, tilt = shown_in(name, rest), TILTS_DEG[rest // 4 % len(TILTS_DEG)]
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), APART + number)
    device = draw_device(scenes()[name][shown], tilt, SEVERITIES, wide=ODD, key=key)
    rng = np.random.default_rng([VALIDATION_SEED + seed, number])
    size = tuple(float(v) for v in rng.uniform(*SIZES_M))
    middle = float(device.start.x) + rng.uniform(*BEHIND_M) - size[0] / 2
    walls = sj.Pose(middle, 0.0, rng.normal() * TURN_STD)
    sonar = device.sonar.replace(floor=sj.FloorPatch(middle, 0.0, size[0], size[1], walls.yaw))
    model = jax.tree.map(jnp.float32, device.model)
    tank = sj.objects.tank((size[0], size[1], size[2]))
    place = sj.Pose(x=FAR_AWAY_M, y=0.0, yaw=0.0) if empty else device.start
    image = _seen()(device.mesh, place, tank, walls, sonar, model, jax.random.fold_in(key, 5))
    what, yaw = ("nothing", math.nan) if empty else (Scene._fields[shown], float(device.start.yaw))
    return Case(name, what, np.asarray(image), np.zeros((0, 0)), yaw, tilt, device.odd)


@cache
def _seen() -> jax.stages.Wrapped:
    def seen(
        mesh: sj.Mesh, pose: sj.Pose, tank: sj.Mesh, walls: sj.Pose, sonar: sj.Sonar, model: SensorModel, key: jax.Array
    ) -> jax.Array:
        return observe_scene((mesh, tank), (pose, walls), sonar, model, key=key)[0]

    return jax.jit(seen)
