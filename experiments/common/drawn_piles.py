"""Drawn piles of bricks and posts for validation, each with another that differs in one part, and its mirror image.

A rule that is fitted to a few objects depends on them; these are many. None of them is the test's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

import sonarjax as sj
from experiments.common.frames import VALIDATION_SEED
from experiments.common.validation import Scene, padded_scenes
from sonarjax.scene.objects import Arrays, box, cylinder_arrays, join

COUNT = 10
"""Piles."""
SIZES_M = (0.13, 0.08, 0.05), (0.20, 0.12, 0.09)
"""Least and largest length, width and height of a pile's bricks [m]; all bricks of a pile are alike."""
PARTS = 3, 4
"""Least and largest number of parts of a pile. The first is a brick: two posts would be their own mirror image."""
ASIDE_M = 0.07, 0.15
"""How far a part on the floor is from the first, middle to middle [m]."""
ABOVE_M = 0.04
"""Largest distance of a part that lies on the first one from its middle [m]."""
ON_TOP, POSTS = 0.35, 0.25
"""Shares of the other parts that lie on the first one, and that are upright cylinders [1]."""
POST_M = (0.03, 0.10), (0.06, 0.20)
"""Least and largest radius and height of a post [m]."""
SIDES = 16
"""Sides of a post."""
POSTURES = [(0, 1, 2), (0, 2, 1), (2, 1, 0)]
"""Which of a brick's sides are its length, width and height: flat, on edge, on end."""


class Part(NamedTuple):
    """A brick or a post, standing on the floor or on the pile's first part."""

    size: tuple[float, float, float]
    """Length, width and height [m]; of a post, twice the radius two times."""
    post: bool
    """Whether it is an upright cylinder."""
    place: tuple[float, float]
    """x and y of its middle [m]."""
    yaw: float
    """Its yaw [rad]."""
    on_top: bool
    """Whether it lies on the first part."""


@cache
def pile_scenes() -> dict[str, Scene]:
    """The piles by name; all of their meshes are padded alike, and share compiled code."""
    return padded_scenes({f"pile {number + 1}": _pile(number) for number in range(COUNT)})


def _pile(number: int) -> tuple[sj.Mesh, sj.Mesh]:
    """A drawn pile, and the same one but for its last part."""
    rng = np.random.default_rng([VALIDATION_SEED, number])
    size = tuple(float(v) for v in rng.uniform(*SIZES_M))
    count = int(rng.integers(PARTS[0], PARTS[1] + 1))
    parts = [_part(size, k > 0, rng) for k in range(count)]
    return _mesh(parts), _mesh([*parts[:-1], _part(size, True, rng)])


def _part(brick: tuple[float, ...], beside: bool, rng: np.random.Generator) -> Part:
    post, on_top = beside and rng.random() < POSTS, beside and rng.random() < ON_TOP
    radius, height = rng.uniform(*POST_M)
    sides = POSTURES[rng.integers(len(POSTURES))]
    size = (2 * radius, 2 * radius, height) if post else tuple(brick[k] for k in sides)
    away = rng.uniform(0, ABOVE_M) if on_top else rng.uniform(*ASIDE_M) if beside else 0.0
    angle, yaw = rng.uniform(0, 2 * math.pi, 2)
    place = away * math.cos(angle), away * math.sin(angle)
    return Part((size[0], size[1], size[2]), bool(post), place, float(yaw), bool(on_top))


def _mesh(parts: Sequence[Part]) -> sj.Mesh:
    return sj.Mesh.from_arrays(*join(*(_solid(part, parts[0].size[2]) for part in parts)), name="pile")


def _solid(part: Part, floor: float) -> Arrays:
    """Vertices and faces of a part, `floor` [m] being the height of the first one."""
    x, y = part.place
    bottom = floor + 0.001 if part.on_top else 0.0
    if not part.post:
        return box(part.size, (x, y, bottom + part.size[2] / 2), part.yaw)
    vertices, faces = cylinder_arrays(part.size[0] / 2, part.size[2], SIDES)
    return vertices + np.array([x, y, bottom]), faces
