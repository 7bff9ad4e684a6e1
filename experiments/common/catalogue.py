"""The catalogue of experiments.catalog: 24 objects, near-duplicates among them, and others that are not in it.

The list was written before the first run and is kept. None of it is among the validation objects, but for the paper's
own two they are nowhere else in the project.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

import sonarjax as sj
from experiments.common.validation import SYMMETRIC, bare_objects
from sonarjax.scene.objects import BRICK_M, Arrays, box, cylinder_arrays, join, sphere_arrays

L, W, H = BRICK_M
FEW_FACES = 128
"""Meshes of up to so many triangles are padded alike, and so are all larger ones: each group shares compiled code."""
Box = tuple[tuple[float, float, float], tuple[float, float, float], float]


class Entry(NamedTuple):
    """An object."""

    mesh: sj.Mesh
    """Its surface."""
    folds: int
    """Turns about the vertical that leave it as it is, in a full circle; 0 for a body of revolution."""
    like: str
    """The object of which it is a near-duplicate; empty for none."""


def catalogue() -> dict[str, Entry]:
    """The 24 objects by name."""
    target, other = _arrays(sj.objects.target()), _arrays(sj.objects.non_target())
    entries: dict[str, tuple[Arrays, int, str]] = {
        "target": (target, 1, ""),
        "non-target": (other, 1, ""),
        "target, mirror image": (_mirrored(target), 1, "target"),
        "target, top brick turned": (_three(100.0, -0.03, 0.0), 1, "target"),
        "target, top brick moved": (_three(60.0, 0.03, -0.05), 1, "target"),
        "brick": (_boxes(((L, W, H), (0, 0, 0), 0)), 2, ""),
        "brick, a fifth longer": (_boxes(((1.2 * L, W, H), (0, 0, 0), 0)), 2, "brick"),
        "brick on edge": (_boxes(((L, H, W), (0, 0, 0), 0)), 2, ""),
        "two bricks, T": (_boxes(((L, W, H), (0, 0, 0), 0), ((L, W, H), (0.141, 0, 0), 90)), 1, ""),
        "two bricks, L": (_boxes(((L, W, H), (0, 0, 0), 0), ((L, W, H), (0.141, 0.049, 0), 90)), 1, "two bricks, T"),
        "column": (_boxes(((W, H, L), (0, 0, 0), 0), ((W, H, L), (0, 0, L + 0.001), 40)), 2, ""),
        "cube": (_boxes(((0.2, 0.2, 0.2), (0, 0, 0), 0)), 4, ""),
        "steps": (_boxes(((0.3, 0.2, 0.08), (0, 0, 0), 0), ((0.15, 0.2, 0.08), (0.075, 0, 0.081), 0)), 1, ""),
        "cross": (_boxes(((0.4, 0.06, 0.1), (0, 0, 0), 0), ((0.06, 0.36, 0.1), (0, 0, 0.101), 0)), 2, ""),
        "table": (_boxes(((0.3, 0.2, 0.03), (0, 0, 0.2), 0), ((0.03, 0.18, 0.199), (0.12, 0, 0), 0),
                         ((0.03, 0.18, 0.199), (-0.12, 0, 0), 0)), 2, ""),
        "wedge": (_wedge(0.3, 0.2, 0.15), 1, ""),
        "drum": (cylinder_arrays(0.075, 0.15, 24), 0, ""),
        "drum, a fifth larger": (cylinder_arrays(0.09, 0.18, 24), 0, "drum"),
        "pipe": (_lying(0.05, 0.4), 2, ""),
        "pipe, a quarter longer": (_lying(0.05, 0.5), 2, "pipe"),
        "cone": (_profile([(0.2, 0.0), (0.08, 0.2)], 24), 0, ""),
        "bottle": (_profile([(0.07, 0.0), (0.07, 0.22), (0.025, 0.3), (0.025, 0.38)], 16), 0, ""),
        "ball": (sphere_arrays(0.11, 10, 20), 0, ""),
        "ball, a fifth larger": (sphere_arrays(0.13, 10, 20), 0, "ball"),
    }  # fmt: skip
    return _padded_alike(entries)


def strangers() -> dict[str, Entry]:
    """Objects that are not in the catalogue, some much like one that is."""
    entries: dict[str, tuple[Arrays, int, str]] = {
        "slab": (_boxes(((0.35, 0.25, 0.06), (0, 0, 0), 0)), 2, ""),
        "two bricks, apart": (_boxes(((L, W, H), (0, -0.1, 0), 0), ((L, W, H), (0, 0.1, 0), 30)), 1, ""),
        "three bricks, U": (_boxes(((L, W, H), (0, 0, 0), 0), ((L, W, H), (0.05, 0.141, 0), 90),
                                   ((L, W, H), (0.05, -0.141, 0), 90)), 1, ""),
        "non-target, mirror image": (_mirrored(_arrays(sj.objects.non_target())), 1, "non-target"),
        "post": (cylinder_arrays(0.04, 0.35, 16), 0, ""),
        "pipe, half as long": (_lying(0.05, 0.2), 2, "pipe"),
        "dome": (_profile([(0.15, 0.0), (0.13, 0.075), (0.075, 0.13), (0.02, 0.149)], 16), 0, ""),
        "chair": (_boxes(((0.2, 0.2, 0.12), (0, 0, 0), 0), ((0.04, 0.2, 0.18), (-0.08, 0, 0.121), 0)), 1, ""),
    }  # fmt: skip
    return _padded_alike(entries)


def validation_catalogue() -> dict[str, Entry]:
    """What the comparison of candidates was fitted on: validation's objects and plain bodies, none of the catalogue's.

    `like` is the group of each.
    """
    entries: dict[str, tuple[Arrays, int, str]] = {}
    for name, (target, other) in bare_objects().items():
        entries |= {name: (_arrays(target), 1, name), f"{name}, other": (_arrays(other), 1, name)}
        if name not in SYMMETRIC:
            entries[f"{name}, mirror image"] = (_mirrored(_arrays(target)), 1, name)
    entries |= {
        "tin": (cylinder_arrays(0.06, 0.2, 24), 0, "tin"),
        "tin, wider": (cylinder_arrays(0.075, 0.2, 24), 0, "tin"),
        "cheese": (cylinder_arrays(0.12, 0.1, 24), 0, "cheese"),
        "globe": (sphere_arrays(0.095, 10, 12), 0, "globe"),
        "globe, smaller": (sphere_arrays(0.08, 10, 12), 0, "globe"),
        "hat": (_profile([(0.15, 0.0), (0.05, 0.25)], 24), 0, "hat"),
        "block": (_boxes(((0.26, 0.13, 0.11), (0, 0, 0), 0)), 2, "block"),
        "block, longer": (_boxes(((0.31, 0.13, 0.11), (0, 0, 0), 0)), 2, "block"),
        "block on end": (_boxes(((0.13, 0.11, 0.26), (0, 0, 0), 0)), 2, "block"),
        "tube": (_lying(0.04, 0.3), 2, "tube"),
        "tube, longer": (_lying(0.04, 0.37), 2, "tube"),
        "stair": (_boxes(((0.24, 0.16, 0.1), (0, 0, 0), 0), ((0.1, 0.16, 0.1), (0.07, 0, 0.101), 0)), 1, "stair"),
    }
    return _padded_alike(entries)


def _padded_alike(entries: dict[str, tuple[Arrays, int, str]]) -> dict[str, Entry]:
    meshes = {name: sj.Mesh.from_arrays(*arrays, name=name) for name, (arrays, _, _) in entries.items()}
    groups = [[n for n, m in meshes.items() if (m.n_faces <= FEW_FACES) == few] for few in (True, False)]
    for names in filter(None, groups):
        stacked = sj.stack_meshes([meshes[name] for name in names])
        meshes |= {name: jax.tree.map(lambda v, k=k: v[k], stacked) for k, name in enumerate(names)}
    return {name: Entry(meshes[name], folds, like) for name, (_, folds, like) in entries.items()}


def _arrays(mesh: sj.Mesh) -> Arrays:
    faces = np.asarray(mesh.faces)
    return np.asarray(mesh.vertices, float), faces[faces[:, 0] != faces[:, 1]]


def _mirrored(arrays: Arrays) -> Arrays:
    return arrays[0] * (1.0, -1.0, 1.0), arrays[1][:, ::-1]


def _boxes(*parts: Box) -> Arrays:
    """Boxes by size [m], place of the middle of the underside [m] and yaw [deg]."""
    raised = [(size, (float(x), float(y), z + size[2] / 2), math.radians(yaw)) for size, (x, y, z), yaw in parts]
    return join(*(box(*one) for one in raised))


def _three(yaw_deg: float, x: float, y: float) -> Arrays:
    """The target's three bricks, the upper one at (x, y) [m], turned by `yaw_deg` [deg]."""
    brick = (L, W, H)
    return _boxes((brick, (0, -0.05, 0), 0), (brick, (-0.05, 0.091, 0), 90), (brick, (x, y, H), yaw_deg))


def _lying(radius: float, length: float, sides: int = 24) -> Arrays:
    """A cylinder lying along x on z = 0; lengths [m]."""
    vertices, faces = cylinder_arrays(radius, length, sides)
    x, y, z = vertices.T
    return np.stack([z - length / 2, y, radius - x], axis=1), faces


def _wedge(length: float, width: float, height: float) -> Arrays:
    """A ramp that rises along x; lengths [m]."""
    x, y = length / 2, width / 2
    points = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0), (x, -y, height), (x, y, height)]
    faces = [(0, 2, 1), (0, 3, 2), (1, 2, 5), (1, 5, 4), (0, 4, 5), (0, 5, 3), (0, 1, 4), (3, 5, 2)]
    return np.array(points, float), np.array(faces)


def _profile(rings: Sequence[tuple[float, float]], sides: int) -> Arrays:
    """A body of revolution about the vertical through rings of (radius, height) [m], from the floor up."""
    angle = 2 * math.pi * np.arange(sides) / sides
    circles = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)], axis=1) for r, z in rings]
    last = len(rings) * sides
    vertices = np.concatenate([*circles, [[0, 0, rings[0][1]], [0, 0, rings[-1][1]]]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = [np.stack([j, i, np.full(sides, last)], 1)]
    for k in range(len(rings) - 1):
        low, high = k * sides, (k + 1) * sides
        faces += [np.stack([low + i, low + j, high + j], 1), np.stack([low + i, high + j, high + i], 1)]
    top = last - sides
    faces.append(np.stack([top + i, top + j, np.full(sides, last + 1)], 1))
    return vertices, np.concatenate(faces)
