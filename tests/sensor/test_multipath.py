"""Multipath: where mirrored echoes arrive, against the closed-form path length, and what they do to an image."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io import SonarjaxError
from sonarjax.render import RenderQuality, SonarFrame
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sensor import SensorModel, bounce_mesh, bounce_points, observe_scene, render_bounces
from sonarjax.sonar import Sonar

TILT = math.radians(20.0)
SONAR = Sonar.preset("didson-hf", tilt=TILT, n_ranges=256, azimuth=np.radians(np.arange(-8, 8) * 0.3))
SILENT = replace(SensorModel(), floor_bounce=0.0, surface_bounce=0.0)
PEBBLE = objects.brick(0.02, 0.02, 0.02)
X, Z = 2.2, 0.25

echoes = jax.jit(render_bounces)


def bounces(mesh: Mesh, pose: Pose, **fields: float) -> SonarFrame:
    return echoes(mesh, pose, SONAR, replace(SILENT, **fields))


def mean_range(frame: SonarFrame) -> float:
    energy = np.asarray(frame.intensity, np.float64).sum(axis=1)
    middles = np.asarray((SONAR.range_edges[1:] + SONAR.range_edges[:-1]) / 2, np.float64)
    return float((energy * middles).sum() / energy.sum())


@pytest.mark.parametrize(
    ("fields", "plane", "path"),
    [
        ({"floor_bounce": 1.0, "floor_path": 1.0}, 0.0, 1.0),
        ({"floor_bounce": 1.0, "floor_path": 0.5}, 0.0, 0.5),
        ({"floor_bounce_once": 1.0}, 0.0, 0.5),
        ({"surface_bounce": 1.0, "surface_path": 1.0, "water_depth": 1.6}, 1.6, 1.0),
        ({"surface_bounce": 1.0, "surface_path": 0.5, "water_depth": 1.6}, 1.6, 0.5),
    ],
)
def test_echo_arrives_after_its_path(fields: dict[str, float], plane: float, path: float) -> None:
    """A pebble in mid-water: half of there by one way and back by the other."""
    middle = Z + 0.01
    direct, mirrored = (math.hypot(X, float(SONAR.height) - z) for z in (middle, 2 * plane - middle))
    expected = (1 - path) * direct + path * mirrored
    found = mean_range(bounces(PEBBLE, Pose(x=X, z=Z), **fields))
    assert found == pytest.approx(expected, abs=0.012)  # the pebble's half length: only its near side is seen


def test_points_keep_the_azimuth_of_the_mirror_image(rng: np.random.Generator) -> None:
    points = rng.uniform([1.5, -0.5, 0.0], [3.0, 0.5, 0.5], (40, 3)).astype(np.float32)
    head = np.array([0.0, 0.0, float(SONAR.height)])
    seen = np.asarray(bounce_points(jnp.asarray(points), SONAR, 1.7, 0.5), np.float64)
    image = points * [1, 1, -1] + [0, 0, 3.4]
    direct, mirrored = np.linalg.norm(points - head, axis=1), np.linalg.norm(image - head, axis=1)
    assert np.linalg.norm(seen - head, axis=1) == pytest.approx((direct + mirrored) / 2, rel=1e-5)
    unit = (image - head) / mirrored[:, None]
    assert (seen - head) / np.linalg.norm(seen - head, axis=1)[:, None] == pytest.approx(unit, abs=1e-5)


def test_mirrored_faces_still_look_outwards() -> None:
    mirrored = bounce_mesh(PEBBLE, Pose(x=X, z=Z, yaw=0.4), SONAR, 0.0, 1.0)
    corners = np.asarray(mirrored.vertices, np.float64)[np.asarray(mirrored.faces)]
    # the divergence theorem: outward triangles give the volume with a plus
    volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(0.02**3, rel=1e-2)
    assert corners[..., 2].mean() == pytest.approx(-Z - 0.01, abs=2e-3)


def test_faces_on_the_mirror_are_dropped() -> None:
    mirrored = bounce_mesh(PEBBLE, Pose(x=X), SONAR, 0.0, 1.0)
    real = np.asarray([len(set(face)) == 3 for face in np.asarray(mirrored.faces).tolist()])
    assert real.sum() == 10  # of a brick's twelve triangles two lie on the floor


def test_energy_is_linear_in_the_coefficients_and_silence_is_dark() -> None:
    pose = Pose(x=X, z=Z)
    floor, surface = bounces(PEBBLE, pose, floor_bounce=0.2), bounces(PEBBLE, pose, surface_bounce=0.1)
    both = bounces(PEBBLE, pose, floor_bounce=0.4, surface_bounce=0.1)
    total = 2 * np.asarray(floor.intensity) + np.asarray(surface.intensity)
    assert np.asarray(both.intensity) == pytest.approx(total, rel=1e-4, abs=1e-9)
    assert not np.asarray(bounces(PEBBLE, pose).intensity).any()


@pytest.mark.slow
def test_bars_appear_inside_the_shadow(key: jax.Array) -> None:
    brick = PEBBLE.with_vertices(PEBBLE.vertices * jnp.array([9.5, 4.5, 2.9]))
    see = jax.jit(partial(observe_scene, quality=RenderQuality(1, 32)))
    clean = replace(SensorModel.nominal(0.0), automatic_gain=0.0)
    pose = Pose(x=X, yaw=0.5)
    quiet, frame = see(brick, pose, SONAR, clean, key=key)
    loud, same = see(brick, pose, SONAR, replace(clean, floor_bounce=0.5), key=key)
    assert quiet.shape == loud.shape == SONAR.shape
    assert np.array_equal(np.asarray(frame.shadow), np.asarray(same.shadow))
    added = (np.asarray(loud) - np.asarray(quiet))[np.asarray(frame.shadow) > 0.9]
    assert added.min() >= 0 and added.max() > 0.2
    assert 0.02 < (added > 0.05).mean() < 0.9  # bars, not all of it


def test_a_bounce_differentiates() -> None:
    def total(z: jax.Array) -> jax.Array:
        points = bounce_points(jnp.array([[X, 0.1, 0.2]]) + jnp.array([0.0, 0.0, 1.0]) * z, SONAR, 1.7, 0.5)
        return jnp.square(points).sum()

    step = 1e-2
    slope = float(total(jnp.float32(step)) - total(jnp.float32(-step))) / (2 * step)
    assert float(jax.grad(total)(jnp.float32(0.0))) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("pose", [Pose(x=math.nan), [Pose(x=2.0), Pose(yaw=math.inf)]])
def test_a_pose_that_is_not_finite_is_refused(pose: Pose | list[Pose], key: jax.Array) -> None:
    sonar, model = Sonar.preset("didson-hf"), SensorModel.nominal()
    mesh = objects.brick() if isinstance(pose, Pose) else [objects.brick()] * 2
    for render in (render_bounces, partial(observe_scene, key=key)):
        with pytest.raises(SonarjaxError, match="pose: (x|yaw): expected a number from"):
            render(mesh, pose, sonar, model)
