"""Reduced meshes: how far they are from the surface, against a ball's closed form and trimesh's distances."""

import numpy as np
import pytest
import trimesh

from sonarjax import SonarjaxError
from sonarjax.scene import Mesh, reduce, reduce_mesh, stack_meshes, surface_distance

RADIUS = 0.2


@pytest.fixture(scope="module")
def ball():
    shape = trimesh.creation.icosphere(5, RADIUS)
    return Mesh.from_arrays(shape.vertices, shape.faces, name="ball")


@pytest.fixture(scope="module")
def reduced(ball):
    return reduce_mesh(ball, 0.002)


def test_fewer_triangles_within_the_tolerance_of_a_ball(ball, reduced):
    assert reduced.before == 20 * 4**5
    assert reduced.after < reduced.before / 4
    triangles = np.asarray(reduced.mesh.vertices, float)[np.asarray(reduced.mesh.faces)[: reduced.after]]
    corners = np.linalg.norm(triangles, axis=-1)
    middles = np.linalg.norm(triangles.mean(axis=1), axis=-1)
    assert np.abs(corners - RADIUS).max() <= 0.008 and np.median(np.abs(corners - RADIUS)) <= 0.002
    assert np.abs(middles - RADIUS).max() <= 0.008 and np.median(np.abs(middles - RADIUS)) <= 0.002
    assert reduced.error.usual <= 0.002 and reduced.error.largest <= 0.008
    assert f"{reduced.before} triangles reduced to {reduced.after}" in str(reduced)


def test_a_first_cut_that_goes_too_far_is_taken_back(ball, monkeypatch):
    """Within 0.35 mm the ball needs more triangles than the first cut leaves."""
    alone = reduce_mesh(ball, 3.5e-4)
    monkeypatch.setattr(reduce, "FIRST_CUT", 2000)
    found = reduce_mesh(ball, 3.5e-4)
    assert 2000 < alone.after < 0.8 * alone.before
    assert 2000 < found.after <= 1.1 * alone.after
    assert found.error.usual <= 3.5e-4


def test_the_stated_error_is_that_of_trimesh(ball, reduced):
    faces = np.asarray(reduced.mesh.faces)[: reduced.after]
    smaller = trimesh.Trimesh(np.asarray(reduced.mesh.vertices, float), faces, process=False)
    points, _ = trimesh.sample.sample_surface(trimesh.creation.icosphere(5, RADIUS), 2000, seed=1)
    _, away, _ = trimesh.proximity.closest_point_naive(smaller, points)
    assert abs(np.quantile(away, 0.99) - reduced.error.usual) <= 0.25 * reduced.error.usual


def test_distance_of_balls_one_inside_the_other():
    shapes = [trimesh.creation.icosphere(4, radius) for radius in (0.2, 0.21)]
    found = surface_distance(*(Mesh.from_arrays(v.vertices, v.faces, name="ball") for v in shapes))
    assert found.rms == pytest.approx(0.01, rel=0.05)
    assert found.largest == pytest.approx(0.01, rel=0.1)


def test_distance_is_that_of_two_single_meshes(ball):
    with pytest.raises(SonarjaxError, match="second: expected one mesh, got a batch"):
        surface_distance(ball, stack_meshes([ball, ball]))


def test_no_fewer_triangles_than_stated():
    """Whatever the tolerance, and though steps of `STEP` from 324 triangles do not end at `FEWEST`."""
    shape = trimesh.creation.icosphere(1, RADIUS).subdivide().subdivide()
    kept = shape.submesh([np.arange(324)], append=True)
    found = reduce_mesh(Mesh.from_arrays(kept.vertices, kept.faces), 10.0)
    assert reduce.FEWEST <= found.after <= 324


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_that_is_no_length(ball, tolerance):
    with pytest.raises(SonarjaxError, match="tolerance"):
        reduce_mesh(ball, tolerance)
