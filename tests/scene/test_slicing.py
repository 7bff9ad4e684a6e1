"""What is found out about a mesh when it is read: triangles a slice crosses, triangles in view, bodies that cross."""

import numpy as np
import pytest
import trimesh
import trimesh.ray.ray_pyembree
from trimesh.transformations import rotation_matrix

from sonarjax.scene import objects, slicing
from sonarjax.scene.slicing import has_crossing_triangles, most_crossings, most_front


def two_boxes(offset, turn=0.0):
    first, second = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    second.apply_transform(rotation_matrix(turn, (1, 1, 0)))
    second.apply_translation(offset)
    both = trimesh.util.concatenate([first, second])
    return np.asarray(both.vertices), np.asarray(both.faces)


@pytest.mark.parametrize(
    ("offset", "turn", "cross"),
    [
        ((0.5, 0.3, 0.2), 0.0, True),
        ((0.5, 0.5, 0.5), 0.3, True),
        ((0.2, 0.1, 0.99), 0.0, True),
        ((1, 0, 0), 0.0, False),  # one face in common
        ((0, 0.3, 1), 0.0, False),  # one rests on the other
        ((3, 0, 0), 0.4, False),
    ],
)
def test_bodies_cross_or_only_touch(offset, turn, cross):
    assert has_crossing_triangles(*two_boxes(offset, turn)) is cross


def plate(tilted, width, aside=0.0):
    """A plate (0.3 × width m) that leans forwards or backwards by the same slope."""
    x, y = (-0.15 if tilted else 0.15), width / 2
    corners = [[x, aside - y, 0.0], [x, aside + y, 0.0], [-x, aside + y, 0.4], [-x, aside - y, 0.4]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


@pytest.mark.parametrize(("width", "aside"), [(0.6, 0.0), (0.5, 0.02), (0.6, 0.1)])
def test_plates_in_an_x_cross(width, aside):
    """Equal plates meet only at edges of their triangles: the side edges, and the diagonals of both."""
    both = trimesh.util.concatenate([plate(True, 0.6), plate(False, width, aside)])
    assert has_crossing_triangles(np.asarray(both.vertices), np.asarray(both.faces))
    apart = trimesh.util.concatenate([plate(True, 0.6), plate(False, width, aside + 1.0)])
    assert not has_crossing_triangles(np.asarray(apart.vertices), np.asarray(apart.faces))


def test_bricks_of_a_turned_pile_only_touch():
    """In single precision the faces of a pile that lies at an angle are not quite coplanar."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        pile = []
        for level in range(3):
            brick = trimesh.creation.box((0.19, 0.09, 0.057))
            brick.apply_transform(rotation_matrix(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)]), (0, 0, 1)))
            brick.apply_translation((*rng.choice([0.0, 0.03, 0.05], 2), 0.057 * level))
            pile.append(brick)
        pile = trimesh.util.concatenate(pile)
        pile.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        assert not has_crossing_triangles(np.asarray(pile.vertices, np.float32), np.asarray(pile.faces))


def test_random_triangles_cross_where_a_ray_along_an_edge_hits():
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(60):
        vertices = rng.uniform(-1, 1, (6, 3))
        faces = np.array([[0, 1, 2], [3, 4, 5]])
        hit = False
        for own, other in ((faces[0], faces[1]), (faces[1], faces[0])):
            caster = trimesh.ray.ray_pyembree.RayMeshIntersector(trimesh.Trimesh(vertices[own], [[0, 1, 2]]))
            for k in range(3):
                start, end = vertices[other[k]], vertices[other[(k + 1) % 3]]
                places, _, _ = caster.intersects_location([start], [end - start])
                hit |= any(np.linalg.norm(p - start) < np.linalg.norm(end - start) for p in places)
        assert has_crossing_triangles(vertices, faces) == hit
        found += hit
    assert 10 < found < 50


def test_bounds_of_a_box():
    box = trimesh.creation.box((1, 2, 0.5))
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    assert 6 <= most_front(vertices, faces) <= 7  # three of its sides are seen at once
    assert 4 <= most_crossings(vertices, faces, closed=True) <= 6
    assert most_crossings(vertices, faces, closed=False) >= most_crossings(vertices, faces, closed=True)


def test_meshes_know_what_slices_will_meet():
    assert not objects.target().intersecting
    assert objects.target().front <= 20
    ball = objects.ball()
    seen = np.asarray(ball.vertices)[np.asarray(ball.faces)]
    normal = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    for direction in np.random.default_rng(1).normal(size=(20, 3)):
        assert (normal @ direction > 0).sum() <= ball.front


def overlap_by_points(starts, ends):
    """At every middle between two neighbouring ends, how many open intervals hold it."""
    places = np.unique(np.concatenate([starts, ends]))
    middles = (places[1:] + places[:-1]) / 2
    return int(((starts[:, None] < middles) & (middles < ends[:, None])).sum(axis=0).max())


def test_overlaps_are_those_of_every_place():
    rng = np.random.default_rng(0)
    for count in (1, 7, 300):
        starts = rng.uniform(-1, 1, count).round(2)  # some of them touch
        ends = starts + rng.uniform(0.01, 0.3, count).round(2)
        exact = overlap_by_points(starts, ends)
        assert slicing.deepest_overlap(starts, ends) == exact
        by_bins = slicing._overlap_by_bins(starts, ends)
        assert exact <= by_bins <= exact + count // 4  # what only touches counts too, and nothing is lost
    assert slicing._overlap_by_bins(np.zeros(0), np.zeros(0)) == 0


def test_fine_meshes_are_counted_as_others_are(monkeypatch):
    ball = trimesh.creation.icosphere(5)
    arrays = np.asarray(ball.vertices), np.asarray(ball.faces)
    exact = most_crossings(*arrays, True), most_front(*arrays)
    monkeypatch.setattr(slicing, "FINE", 2000)
    crossings, front = most_crossings(*arrays, True), most_front(*arrays)
    assert 0.95 * exact[0] <= crossings <= 1.1 * exact[0]
    assert exact[1] <= front <= 1.1 * exact[1]  # the largest of many drawn counts, so never too little
