"""Validation frames: what thresholds and settings are chosen on. No object and no device of them is in any test.

Objects are piles of bricks of another size than the test's, and other bodies; each comes with one that is much like it,
and with its own mirror image. Devices are drawn from the widest family, the true tilt and height are a little off what
the recognizer is told, and so is what faces send back from what the template has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import jax
import numpy as np

import sonarjax as sj
from experiments.common.drawn_device import draw_device
from experiments.common.engine import engine
from experiments.common.frames import VALIDATION_SEED, observed
from experiments.common.progress import Progress
from experiments.common.sets import mirrored
from sonarjax.scene.objects import Arrays, box, cylinder_arrays, join

BRICK_M = (0.16, 0.10, 0.07)
"""Length, width and height of a validation brick [m]: not the test's."""
SYMMETRIC = ("mug", "spool", "low drum", "prism", "long box")
"""Objects that are their own mirror image: what is like them is shown twice as often instead."""
SYMMETRIC_FRAMES = 700
"""Added to the validation seed: the draws of the frames of symmetric objects are not those of the others."""
SEVERITIES = (0.7, 1.6)
"""Least and largest severity of the devices [1]."""
EMPTY = 200_000
"""Numbers of keys from here on are those of empty frames."""
FAR_AWAY_M = 60.0
"""Where the object of an empty frame stands: behind every range window [m]."""
ODD = 0.6
"""Share of the devices that are of the widest family [1]."""


@dataclass(frozen=True)
class Case:
    """One frame, what is sought in it, and its truth."""

    sought: str
    """Name of the object that is sought."""
    shown: str
    """`target` where that is the object shown, else `other`, `mirror` or `nothing`."""
    image: np.ndarray
    """Grey frame (range, beam) in [0, 1]."""
    clean: np.ndarray
    """Semantic image (range, beam) without noise."""
    yaw: float
    """True yaw [rad]."""
    tilt_deg: float
    """Tilt that the recognizer is told [deg]."""
    odd: bool
    """Whether the device is of the widest family."""

    @property
    def is_target(self) -> bool:
        """True where the object that is sought is shown."""
        return self.shown == "target"


def _bricks(*parts: tuple[float, float, float, float, int]) -> sj.Mesh:
    """A pile of bricks: x, y, z of the middle [m], yaw [deg] and posture (0 flat, 1 on edge, 2 on end) of each."""
    sides = [(0, 1, 2), (0, 2, 1), (2, 1, 0)]
    boxes = []
    for x, y, z, yaw, posture in parts:
        size = tuple(BRICK_M[k] for k in sides[posture])
        boxes.append(box(size, (float(x), float(y), z + size[2] / 2), math.radians(yaw)))
    return sj.Mesh.from_arrays(*join(*boxes), name="pile")


class Scene(NamedTuple):
    """What is shown where one object is sought; all meshes of all scenes are padded alike, and share compiled code."""

    target: sj.Mesh
    """What is sought."""
    other: sj.Mesh
    """An object much like it."""
    mirror: sj.Mesh
    """Its mirror image."""


@cache
def scenes() -> dict[str, Scene]:
    """The objects by name."""
    return padded_scenes(bare_objects())


def padded_scenes(objects: Mapping[str, tuple[sj.Mesh, sj.Mesh]]) -> dict[str, Scene]:
    """The scenes of objects, each with the other one that is much like it, all padded alike."""
    meshes = [mesh for target, other in objects.values() for mesh in (target, other, mirrored(target))]
    stacked = sj.stack_meshes(meshes)
    alike = [jax.tree.map(lambda v, k=k: v[k], stacked) for k in range(len(meshes))]
    return {name: Scene(*alike[3 * k : 3 * k + 3]) for k, name in enumerate(objects)}


def bare_objects() -> dict[str, tuple[sj.Mesh, sj.Mesh]]:
    """Each object by name, with another one much like it; nothing of them is padded."""
    low = BRICK_M[2] + 0.001
    mug = join(cylinder_arrays(0.06, 0.16, 24), box((0.09, 0.02, 0.10), (0.107, 0.0, 0.08)))
    jug = join(cylinder_arrays(0.06, 0.16, 24), box((0.05, 0.02, 0.16), (0.087, 0.0, 0.08)))
    return {
        "corner": (
            _bricks((0, -0.06, 0, 0, 0), (0.05, 0.08, 0, 80, 0), (0.02, -0.05, low, 30, 1)),
            _bricks((0, -0.06, 0, 0, 0), (0.05, 0.08, 0, 80, 0), (0.06, 0.06, low, 60, 0)),
        ),
        "stairs": (
            _bricks((0, -0.105, 0, 5, 0), (0, 0, 0, 0, 0), (0, 0.06, low, 90, 0), (0.06, 0.12, 0, -30, 0)),
            _bricks((0, -0.105, 0, 5, 0), (0, 0, 0, 0, 0), (0.02, -0.03, low, 20, 1), (0.06, 0.12, 0, -30, 0)),
        ),
        "tower": (
            _bricks((0, -0.055, 0, 0, 0), (0.04, 0.06, 0, 25, 2)),
            _bricks((0, -0.055, 0, 0, 0), (0.03, 0.06, 0, 40, 1)),
        ),
        "gate": (
            _bricks((-0.03, -0.12, 0, 0, 1), (0.03, 0.12, 0, 30, 2), (0.1, 0.0, 0, 90, 0)),
            _bricks((-0.03, -0.12, 0, 0, 1), (0.03, 0.12, 0, 30, 2), (-0.1, 0.02, 0, 90, 0)),
        ),
        "mug": (sj.Mesh.from_arrays(*mug, name="mug"), sj.Mesh.from_arrays(*jug, name="jug")),
    }


@cache
def symmetric_scenes() -> dict[str, Scene]:
    """Objects that look much the same at several or all yaws, each with another one of about its size."""
    objects = {
        "spool": (_two_cylinders((0.10, 0.06), (0.05, 0.14)), _two_cylinders((0.05, 0.14), (0.10, 0.06))),
        "low drum": (cylinder_arrays(0.12, 0.10, 24), _standing(0.21, 0.21, 0.10)),
        "prism": (_standing(0.13, 0.13, 0.24), _standing(0.13, 0.24, 0.13)),
        "long box": (_standing(0.24, 0.13, 0.10), _standing(0.24, 0.10, 0.13)),
    }
    made = {
        name: (sj.Mesh.from_arrays(*target, name=name), sj.Mesh.from_arrays(*other, name=f"not a {name}"))
        for name, (target, other) in objects.items()
    }
    return padded_scenes(made)


def _two_cylinders(low: tuple[float, float], high: tuple[float, float]) -> Arrays:
    """One upright cylinder on another, each given by radius and height [m]."""
    vertices, faces = cylinder_arrays(*high, 20)
    return join(cylinder_arrays(*low, 20), (vertices + [0, 0, low[1]], faces))


def _standing(length: float, width: float, height: float) -> Arrays:
    """A box on the floor: vertices and triangles."""
    return box((length, width, height), (0.0, 0.0, height / 2))


def symmetric_cases(seed: int, count: int, *, tilts_deg: Sequence[float] = (15.0, 20.0, 25.0)) -> list[Case]:
    """`count` frames as `validation_cases` draws them, of the objects of `symmetric_scenes`."""
    return validation_cases(seed + SYMMETRIC_FRAMES, count, tilts_deg=tilts_deg, of=symmetric_scenes())


def shown_in(name: str, turn: int) -> int:
    """Which mesh of its `Scene` (0 the target) is shown in frame number `turn` of an object: every other one is it."""
    return (0, 1, 0, 1 if name in SYMMETRIC else 2)[turn % 4]


def validation_cases(
    seed: int, count: int, *, tilts_deg: Sequence[float] = (15.0, 20.0, 25.0), of: Mapping[str, Scene] | None = None
) -> list[Case]:
    """`count` frames: of each object in turn, half of them show it, the others what is like it or its mirror image.

    Without `of`, the objects by name, they are those of `scenes`.
    """
    key = jax.random.key(VALIDATION_SEED + seed)
    of = scenes() if of is None else of
    names = list(of)

    def simulate(number: int) -> Case:
        part = jax.random.fold_in(key, number)
        name, rest = names[number % len(names)], number // len(names)
        shown = shown_in(name, rest)
        tilt = float(tilts_deg[rest // 4 % len(tilts_deg)])
        return _case(name, of[name][shown], Scene._fields[shown], tilt, key=part)

    with Progress("simulating validation frames", count, unit="frame", leave=False) as progress:

        def one(number: int) -> Case:
            with progress.part(f"frame {number}"):
                return simulate(number)

        return [one(0), *engine().map(one, range(1, count))] if count else []  # the first alone compiles


def empty_cases(seed: int, count: int, *, tilts_deg: Sequence[float] = (15.0, 20.0, 25.0)) -> list[Case]:
    """`count` frames of bare floor, in which each object in turn is sought; no yaw is true."""
    return [_empty_case(number, seed, tilts_deg) for number in range(count)]


def _empty_case(number: int, seed: int, tilts_deg: Sequence[float]) -> Case:
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), EMPTY + number)
    name, tilt = list(scenes())[number % len(scenes())], tilts_deg[number // len(scenes()) % len(tilts_deg)]
    device = draw_device(scenes()[name].target, tilt, SEVERITIES, wide=ODD, key=key)
    away = sj.Pose(x=FAR_AWAY_M, y=0.0, yaw=0.0)
    image, clean = observed(device.mesh, away, device.sonar, device.model, key=jax.random.fold_in(key, 5))
    return Case(name, "nothing", np.asarray(image), np.asarray(clean), math.nan, tilt, device.odd)


def _case(name: str, mesh: sj.Mesh, shown: str, tilt_deg: float, *, key: jax.Array) -> Case:
    device = draw_device(mesh, tilt_deg, SEVERITIES, wide=ODD, key=key)
    image, clean = observed(device.mesh, device.start, device.sonar, device.model, key=jax.random.fold_in(key, 5))
    yaw = float(device.start.yaw)
    return Case(name, shown, np.asarray(image), np.asarray(clean), yaw, tilt_deg, device.odd)
