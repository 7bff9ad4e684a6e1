"""The paper's objects: sizes and volumes against closed forms, no symmetry where there must be none."""

import math
from itertools import combinations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from sonarjax.scene import objects

BRICK = 0.190 * 0.090 * 0.057
OBJECTS = {
    "brick": objects.brick,
    "target": objects.target,
    "non-target": objects.non_target,
    "cylinder": objects.concrete_cylinder,
    "ball": objects.ball,
}


def surface(mesh):
    """The mesh in trimesh, without its padding."""
    faces = np.asarray(mesh.faces)
    faces = faces[(faces != faces[:, :1]).any(axis=1)]
    return trimesh.Trimesh(np.asarray(mesh.vertices, np.float64), faces, process=False)


def cylinder_volume(radius, height, sides):
    return sides / 2 * radius**2 * math.sin(2 * math.pi / sides) * height


@pytest.mark.parametrize(
    ("name", "volume", "rel"),
    [
        ("brick", BRICK, 1e-5),
        ("target", 3 * BRICK, 1e-5),
        ("non-target", 3 * BRICK, 1e-5),
        ("cylinder", cylinder_volume(0.075, 0.15, 48), 1e-5),
        ("ball", 4 / 3 * math.pi * 0.11**3, 0.01),  # 24 × 48 facets lie inside the sphere
    ],
)
def test_volume_is_positive_so_normals_point_out(name, volume, rel):
    mesh = OBJECTS[name]()
    assert mesh.closed
    assert surface(mesh).volume == pytest.approx(volume, rel=rel)
    for body in surface(mesh).split():
        assert body.volume > 0


@pytest.mark.parametrize(
    ("name", "extents"),
    [
        ("brick", (0.190, 0.090, 0.057)),
        ("cylinder", (0.15, 0.15, 0.15)),
        ("ball", (0.22, 0.22, 0.22)),
    ],
)
def test_extents(name, extents):
    np.testing.assert_allclose(surface(OBJECTS[name]()).extents, extents, rtol=1e-5)


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_stand_on_the_floor_within_their_bounds(name):
    mesh = OBJECTS[name]()
    body = surface(mesh)
    low, high = body.bounds
    assert low[2] == pytest.approx(0.0, abs=1e-7)
    assert high[2] <= mesh.top + 1e-6 < high[2] + 0.051
    reach = np.hypot(*body.vertices[:, :2].T).max()
    assert reach <= mesh.radius + 1e-6 < reach + 0.051


@pytest.mark.parametrize("name", ["target", "non-target"])
def test_bricks_of_a_pile_do_not_overlap(name):
    rng = np.random.default_rng(0)
    bodies = surface(OBJECTS[name]()).split()
    assert len(bodies) == 3
    for one, other in combinations(bodies, 2):
        inside = rng.dirichlet(np.full(8, 0.3), 5000) @ one.vertices
        planes = ConvexHull(other.vertices).equations  # normal · x + offset < 0 inside
        deepest = (inside @ planes[:, :3].T + planes[:, 3]).max(axis=1).min()
        assert deepest > -1e-6


def turned_distance(mesh, degrees):
    """Largest distance [m] of a corner to the nearest one of the same body turned about its centroid."""
    body = surface(mesh)
    corners = body.vertices - [*body.centroid[:2], 0]
    turn = trimesh.transformations.rotation_matrix(math.radians(degrees), [0, 0, 1])[:3, :3]
    distances = cdist(corners, corners @ turn.T)
    return max(distances.min(axis=0).max(), distances.min(axis=1).max())


@pytest.mark.parametrize("name", ["target", "non-target"])
@pytest.mark.parametrize("degrees", range(30, 360, 30))
def test_piles_have_no_symmetry_in_yaw(name, degrees):
    assert turned_distance(OBJECTS[name](), degrees) > 0.02


def test_that_measure_finds_the_symmetries_there_are():
    assert turned_distance(objects.brick(), 180) < 1e-6
    assert turned_distance(objects.brick(), 90) > 0.02
    assert turned_distance(objects.concrete_cylinder(), 90) < 1e-6


def test_tank_is_four_open_walls():
    tank = objects.tank()
    length, width, height = objects.TANK_M
    body = surface(tank)
    assert not tank.closed
    assert body.area == pytest.approx(2 * (length + width) * height, rel=1e-5)
    np.testing.assert_allclose(body.extents, objects.TANK_M, rtol=1e-6)
    assert np.abs(body.face_normals[:, 2]).max() < 1e-6


def test_sizes_are_arguments():
    assert surface(objects.brick(0.2, 0.1, 0.05)).volume == pytest.approx(1e-3, rel=1e-5)
    assert surface(objects.ball(0.2, 48, 96)).volume == pytest.approx(4 / 3 * math.pi * 0.008, rel=3e-3)
    assert surface(objects.concrete_cylinder(0.1, 0.3, 12)).volume == pytest.approx(
        cylinder_volume(0.1, 0.3, 12), rel=1e-5
    )
