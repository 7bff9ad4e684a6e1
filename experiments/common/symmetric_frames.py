"""Drawn frames of symmetric, nearly symmetric and plain objects, which a set of yaws is fitted to and judged on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import jax
import numpy as np

import sonarjax as sj
from experiments.common.drawn_device import draw_device
from experiments.common.engine import engine
from experiments.common.frames import VALIDATION_SEED, observed, sonar_for
from experiments.common.launch import Skipped
from experiments.common.validation import BRICK_M, ODD, SEVERITIES, bare_objects
from sonarjax.scene.objects import box, join

TILT_DEG = 20.0
"""Tilt that the recognizer is told [deg]."""
YAW_FRAMES = 500
"""Added to the validation seed: these frames are neither those of the rule nor those of `track`."""


PLAIN = ("corner", "gate")
"""Piles of the validation that look the same at no two yaws."""


class Turned(NamedTuple):
    """An object that looks the same every `period_deg` of yaw [deg]."""

    mesh: sj.Mesh
    """The object."""
    period_deg: float
    """360 where no other yaw looks the same."""


@dataclass(frozen=True)
class YawFrame:
    """One frame of an object that is there, and its truth."""

    name: str
    """Which object."""
    image: np.ndarray
    """Grey frame (range, beam) in [0, 1]."""
    yaw: float
    """True yaw [rad]."""
    exact: bool
    """Whether the recognizer is told the true tilt and height."""


def two_fold_pile(off_m: float = 0.0) -> sj.Mesh:
    """Two of the validation's bricks side by side, shifted, and a third across: the same after half a turn.

    But for the third one, where that is `off_m` [m] from the middle.
    """
    length, width, height = BRICK_M
    beside = [box(BRICK_M, (side * 0.04, side * (width / 2 + 0.003), height / 2)) for side in (-1, 1)]
    across = box((length, width, height), (off_m, 0.0, 1.5 * height), math.radians(50))
    return sj.Mesh.from_arrays(*join(*beside, across), name="two-fold pile")


def long_box() -> sj.Mesh:
    """A box longer than wide: the same after half a turn, and not much else after a quarter."""
    return sj.Mesh.from_arrays(*box((0.24, 0.13, 0.10), (0.0, 0.0, 0.05)), name="long box")


def low_box() -> sj.Mesh:
    """A box with a square floor plan: the same every 90°."""
    return sj.Mesh.from_arrays(*box((0.17, 0.17, 0.10), (0.0, 0.0, 0.05)), name="low box")


@cache
def turned_objects() -> dict[str, Turned]:
    """The objects by name, none of them in any test; padded alike, to share compiled code."""
    made = {name: Turned(bare_objects()[name][0], 360.0) for name in PLAIN}
    made |= {
        "two-fold pile": Turned(two_fold_pile(), 180.0),
        "pile, 1 cm off two-fold": Turned(two_fold_pile(0.01), 360.0),
        "pile, 3 cm off two-fold": Turned(two_fold_pile(0.03), 360.0),
        "long box": Turned(long_box(), 180.0),
        "low box": Turned(low_box(), 90.0),
    }
    stacked = sj.stack_meshes([one.mesh for one in made.values()])
    return {
        name: one._replace(mesh=jax.tree.map(lambda v, k=k: v[k], stacked))
        for k, (name, one) in enumerate(made.items())
    }


def yaw_frames(seed: int, count: int, names: Sequence[str] | None = None) -> list[YawFrame]:
    """`count` frames, of each object in turn; of every other frame the recognizer knows the geometry exactly."""
    key = jax.random.key(VALIDATION_SEED + YAW_FRAMES + seed)
    chosen = list(turned_objects() if names is None else names)

    def drawn(number: int) -> YawFrame:
        name, exact = chosen[number % len(chosen)], number // len(chosen) % 2 == 0
        part = jax.random.fold_in(key, number)
        device = draw_device(turned_objects()[name].mesh, TILT_DEG, SEVERITIES, wide=ODD, key=part)
        sonar = sonar_for(TILT_DEG) if exact else device.sonar
        image, _ = observed(device.mesh, device.start, sonar, device.model, key=jax.random.fold_in(part, 5))
        return YawFrame(name, np.asarray(image), float(device.start.yaw), exact)

    return [drawn(0), *engine().map(drawn, range(1, count))]  # the first alone compiles


def judge_yaw_frames(seed: int, count: int, names: Sequence[str] | None = None) -> list[YawFrame]:
    """The same of the independent judge, who draws the frames with nothing of ours. Raises Skipped without Embree."""
    try:
        from experiments.judge.turned import turned_frames
    except ImportError as error:
        raise Skipped(f"the judge needs the extra `bench`: {error}") from error
    chosen = list(turned_objects() if names is None else names)
    shown = [chosen[(number // 2) % len(chosen)] for number in range(count)]
    meshes = [turned_objects()[name].mesh for name in shown]
    drawn = turned_frames(VALIDATION_SEED + seed, meshes, sonar_for(TILT_DEG), TILT_DEG)
    return [YawFrame(name, frame.image, frame.yaw, frame.exact) for name, frame in zip(shown, drawn, strict=True)]
