"""Room for triangles where an object leans: enough for what a render of it there meets."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.render.candidates import front_faces
from sonarjax.render.room import _crossings, with_lean_room
from sonarjax.render.window import in_sonar_frame

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9, n_ranges=128)
LYING = sj.Pose(2.3, 0.1, 0.5, z=0.075, roll=math.pi / 2)


def tube():
    """An upright tube of many sides: a slice meets few of them, but nearly half if the tube lies along the beam."""
    return sj.objects.concrete_cylinder()


def left_out(mesh, pose):
    return int(jax.jit(lambda p: sj.render(mesh, p, SONAR).overflow)(pose))


def test_a_lying_tube_has_room():
    mesh = tube()
    roomy = with_lean_room(mesh, LYING, SONAR)
    assert left_out(mesh, LYING) > 0 and left_out(roomy, LYING) == 0
    assert roomy.crossings < mesh.n_faces


@pytest.mark.parametrize("mesh", [sj.objects.target(), tube()])
def test_triangles_are_counted_at_every_azimuth(mesh):
    """Between two neighbouring vertices the count does not change, so one azimuth there stands for all."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        yaw, roll, pitch = rng.uniform(-1.5, 1.5, 3)
        pose = sj.Pose(2.3, 0.1, yaw, 0.1, roll, pitch)
        vertices = in_sonar_frame(mesh, pose, SONAR).vertices
        seen = np.asarray(front_faces(vertices, mesh.faces, mesh.closed))
        azimuth = np.asarray(jnp.arctan2(vertices[:, 1], vertices[:, 0]))
        edges = np.unique(azimuth)
        corners = azimuth[np.asarray(mesh.faces)[seen]]
        counts = [((corners.min(1) < a) & (a < corners.max(1))).sum() for a in (edges[1:] + edges[:-1]) / 2]
        assert _crossings(mesh, pose, SONAR) == max(counts) > 0


def test_upright_objects_keep_their_room():
    mesh = tube()
    assert with_lean_room(mesh, sj.Pose(x=[2.0, 2.5], yaw=[0.1, 3.0]), SONAR) is mesh


@pytest.mark.slow
def test_a_lying_tube_is_refined():
    """Without room, part of the tube is left out of the template, and yaw is more than two degrees off."""
    mesh, sonar = tube(), SONAR.replace(n_ranges=512)
    image = np.asarray(sj.render(mesh, LYING, sonar).semantic())
    start = sj.Pose(2.3, 0.1, 0.56, z=0.075, roll=math.pi / 2)
    found = sj.refine_pose(image, mesh, sonar, start)
    assert bool(found.converged) and abs(math.degrees(float(found.pose.yaw) - 0.5)) < 0.4
