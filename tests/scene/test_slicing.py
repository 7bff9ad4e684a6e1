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
