"""Bodies whose shape is sought, frames of them by our simulator and by the judge, and distances between surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import numpy as np
from scipy.spatial import cKDTree

import sonarjax as sj
from experiments.common.frames import observed
from experiments.common.launch import Skipped
from sonarjax.scene.objects import box, sphere_arrays
from sonarjax.sensor import SensorModel

BODY_M = 0.1
"""Radius of the smooth bodies, about [m]."""
POINTS, DENSE = 4000, 400_000
"""Points on one surface from which the distance to the other is taken, and points that stand for that other one."""


def brick(size: Sequence[float]) -> sj.Mesh:
    """A brick of `size` = length, width, height [m] that stands on z = 0."""
    length, width, height = (float(v) for v in size)
    return sj.Mesh.from_arrays(*box((length, width, height), (0.0, 0.0, height / 2)), name="brick")


def ball() -> sj.Mesh:
    """A ball of the smooth bodies' size and 422 vertices: what the search begins with."""
    vertices, faces = sphere_arrays(BODY_M, rings=15, sectors=30)
    return sj.Mesh.from_arrays(vertices, faces, name="ball")


def smooth_body(rng: np.random.Generator, rings: int = 36, sectors: int = 72) -> sj.Mesh:
    """A ball whose points are moved along their radius by smooth random waves, up to some 40 %; it stands on z = 0."""
    vertices, faces = sphere_arrays(1.0, rings=rings, sectors=sectors)
    x, y, z = (vertices - [0, 0, 1]).T
    waves = np.stack([x, y, x * x - y * y, x * y, x * z, y * z, np.sin(3 * y + z), np.cos(3 * x - z)])
    weights = rng.normal(0, 0.12, len(waves))
    radius = BODY_M * np.clip(1 + weights @ waves, 0.55, 1.6)
    body = radius[:, None] * np.stack([x, y, z], axis=1)
    return sj.Mesh.from_arrays(body - [0, 0, body[:, 2].min()], faces, name="smooth body")


def our_frames(mesh: sj.Mesh, poses: sj.Pose, sonar: sj.Sonar, *, key: jax.Array) -> np.ndarray:
    """Frames (frame, range, beam) of the nominal device at severity 1, by our own simulator."""
    model = SensorModel.nominal(1.0)
    one = [sj.Pose(x, y, yaw) for x, y, yaw in zip(poses.x, poses.y, poses.yaw, strict=True)]
    seen = [observed(mesh, pose, sonar, model, key=jax.random.fold_in(key, k))[0] for k, pose in enumerate(one)]
    return np.stack([np.asarray(image) for image in seen])


def judge_frames(mesh: sj.Mesh, poses: sj.Pose, sonar: sj.Sonar, *, seed: int) -> np.ndarray:
    """The same by the judge's ray caster and sensor model. Raises Skipped where Embree is not installed."""
    try:
        from experiments.judge.device import Device
        from experiments.judge.frames import surface
        from experiments.judge.raycast import cast, place
        from experiments.judge.sensor import store
        from experiments.judge.view import View
    except ImportError as error:
        raise Skipped(f"the judge needs Embree: pip install 'sonarjax[bench]' ({error})") from error
    rng, device = np.random.default_rng(seed), Device()
    view = View.of(sonar, float(sonar.tilt), float(sonar.height), device.sound_speed_ratio, device.conical)
    shape, seen = surface(mesh), []
    for x, y, yaw in zip(poses.x, poses.y, poses.yaw, strict=True):
        hits = cast(place(*shape, float(x), float(y), float(yaw)), view)
        seen.append(store(hits, device, rng).astype(np.float32) / 255)
    return np.stack(seen)


def views_around(count: int, rng: np.random.Generator, ground_range: float, turn: float = 0.0) -> sj.Pose:
    """Poses (frame,) of an object seen from `count` sides, evenly but for a few degrees, near `ground_range` [m]."""
    yaw = turn + 2 * math.pi * np.arange(count) / count + rng.uniform(-0.1, 0.1, count)
    return sj.Pose(ground_range + rng.uniform(-0.1, 0.1, count), rng.uniform(-0.15, 0.15, count), yaw)


def chamfer(first: sj.Mesh, second: sj.Mesh) -> float:
    """Mean distance from each surface to the other [m], of both ways the mean; from points spread evenly over both.

    The points that stand for the other surface lie close together, since their spacing adds to the distance.
    """
    ways = ((first, second), (second, first))
    found = [cKDTree(_points(other, DENSE, 1)).query(_points(one, POINTS, 0))[0].mean() for one, other in ways]
    return float(np.mean(found))


def _points(mesh: sj.Mesh, count: int, seed: int) -> np.ndarray:
    """Points (point, 3) [m], evenly spread over the surface."""
    vertices, faces, rng = np.asarray(mesh.vertices, float), np.asarray(mesh.faces), np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    low, high = np.sort(rng.random((2, count)), axis=0)
    return sum(v[chosen] * w[:, None] for v, w in ((a, low), (b, high - low), (c, 1 - high)))  # type: ignore[return-value]
