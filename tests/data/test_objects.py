"""The objects of training pairs: what the renderer is promised about them holds, and none is a pile of the test."""

from __future__ import annotations

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.data.objects import draw_shape
from sonarjax.data.shapes import BOXES, CROSSINGS, MOST_BOXES, N_VERTICES, shape_mesh, wall_vertices
from sonarjax.scene import Mesh, objects
from sonarjax.scene.slicing import has_crossing_triangles

DRAWS = 192


@pytest.fixture(scope="module")
def shapes():
    """Kinds (draw,), vertices (draw, vertex, 3), faces (draw, face, 3) of random objects with a tank around them."""
    walls = wall_vertices(jnp.array([3.0, 1.35, 1.7]), jnp.array([0.1, 0.05]), jnp.float32(0.1))

    def draw(key):
        shape = draw_shape(key=key)
        mesh = shape_mesh(shape.kind, shape.vertices, walls)
        return shape.kind, mesh.vertices, mesh.faces

    return [np.asarray(v) for v in jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(5), DRAWS))]


@pytest.fixture(scope="module")
def piles(shapes):
    """Corners (draw, box, 8, 3) of the piles among them, on the floor."""
    kinds, vertices, _ = shapes
    corners = vertices[kinds == BOXES, : 8 * MOST_BOXES].reshape(-1, MOST_BOXES, 8, 3)
    corners = np.stack([pile for pile in corners if extent(pile) > 0])
    return corners - corners[..., 2].min((1, 2))[:, None, None, None] * [0, 0, 1]


def extent(points):
    """Largest side [m] of the bounds of points (point, 3): 0 for what is not there."""
    return np.ptp(points.reshape(-1, 3), axis=0).max()


def front_crossings(triangles, head, azimuths):
    """Triangles that look at `head` and are cut by the upright half-plane at each of `azimuths` [rad]."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    seen = triangles[((normals * (triangles[:, 0] - head)).sum(1) < 0)] - head
    azimuth = azimuths[:, None, None]
    port = np.cos(azimuth) * seen[..., 1] - np.sin(azimuth) * seen[..., 0] > 0
    return (port.any(-1) & ~port.all(-1)).sum(1)


def test_slices_cross_no_more_triangles_than_promised(shapes):
    """A slice through the end of a bent tube may: its surplus triangles are left out of a training pair."""
    crossings = []
    for _, vertices, faces in zip(*shapes, strict=True):
        for turn in (0.3, 1.7, 3.9, 5.2):
            head = np.array([-2.2 * math.cos(turn), -2.2 * math.sin(turn), 0.9])
            azimuths = turn + np.linspace(-0.25, 0.25, 81)
            crossings.append(front_crossings(vertices[faces].astype(float), head, azimuths))
    beyond = np.stack(crossings) > CROSSINGS
    assert np.max(crossings) >= 12
    assert beyond.mean() < 1e-3 and beyond.any(1).mean() < 0.01, (beyond.mean(), beyond.any(1).mean())


def test_boxes_do_not_pass_through_one_another(piles):
    _, box_faces = objects.box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    for pile in piles:
        there = np.stack([box for box in pile if extent(box) > 0])
        faces = np.concatenate([box_faces + 8 * number for number in range(len(there))])
        assert not has_crossing_triangles(there.reshape(-1, 3), faces)


def test_objects_stand_on_the_floor_and_look_outwards(shapes):
    for kind, vertices, faces in zip(*shapes, strict=True):
        own, triangles = vertices[:N_VERTICES], vertices[faces[faces.max(1) < N_VERTICES]].astype(float)
        volume = np.linalg.det(triangles).sum() / 6  # of the closed surfaces, positive if faces look outwards
        if extent(own):
            assert -1e-4 < own[:, 2].min() < 0.05 and volume > 1e-5
            assert np.hypot(own[:, 0], own[:, 1]).max() < 1.1, kind
        else:
            assert volume == 0  # nothing


def test_same_surface_as_read_from_arrays(shapes):
    """trimesh finds every kind watertight once degenerate triangles are gone: nothing of a shape is missing."""
    for kind in range(3):
        number = next(n for n, k in enumerate(shapes[0]) if k == kind and extent(shapes[1][n][:N_VERTICES]) > 0)
        vertices, faces = shapes[1][number], shapes[2][number]
        assert Mesh.from_arrays(vertices, faces[faces.max(1) < N_VERTICES]).closed


def inside(points, corners):
    """Which points (point, 3) are in one of the boxes given by corners (box, 8, 3) in the order of `objects.box`."""
    found = np.zeros(len(points), bool)
    for box in corners:
        edges = np.stack([box[4] - box[0], box[2] - box[0], box[1] - box[0]])
        lengths = (edges**2).sum(1)
        if lengths.min() > 1e-8:
            found |= (np.abs((points - box.mean(0)) @ edges.T / lengths) <= 0.5).all(1)
    return found


def overlap(one, other):
    """Largest intersection over union (volumes) of two piles of boxes, over turns and with middles together."""
    steps = np.linspace(-0.28, 0.28, 29)
    points = np.array(list(itertools.product(steps, steps, np.linspace(0.005, 0.245, 13))))
    first = inside(points, one)
    best = 0.0
    for angle in np.arange(0, 2 * math.pi, math.radians(7.5)):
        c, s = math.cos(angle), math.sin(angle)
        turned = other @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        middle = (turned.min((0, 1)) + turned.max((0, 1))) / 2
        second = inside(points, turned - [middle[0], middle[1], 0])
        best = max(best, (first & second).sum() / max((first | second).sum(), 1))
    return best


@pytest.mark.slow
def test_no_pile_is_one_of_the_test(piles):
    height, (length, width, _) = objects.BRICK_M[2], objects.BRICK_M
    target = [((0.0, -0.05, height / 2), 0), ((-0.05, 0.091, height / 2), 90), ((-0.03, 0.0, 1.5 * height), 60)]
    other = [((0.0, 0.055, height / 2), 0), ((0.06, -0.055, height / 2), 20), ((-0.02, 0.05, height + width / 2), -15)]
    sizes = {"target": [objects.BRICK_M] * 3, "other": [objects.BRICK_M] * 2 + [(length, height, width)]}
    for name, parts in (("target", target), ("other", other)):
        boxes = [objects.box(s, c, math.radians(a))[0] for s, (c, a) in zip(sizes[name], parts, strict=True)]
        pile = np.stack(boxes)
        middle = (pile.min((0, 1)) + pile.max((0, 1))) / 2
        pile = pile - [middle[0], middle[1], 0]
        assert overlap(pile, pile @ np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])) > 0.85  # it finds itself
        overlaps = [overlap(pile, drawn) for drawn in piles[:40]]
        print(f"{name}: largest overlap {max(overlaps):.2f}")
        assert max(overlaps) < 0.7


def test_three_are_never_two_below_and_one_above(piles):
    counts = 0
    for pile in piles:
        there = [box for box in pile if extent(box) > 0]
        if len(there) == 3:
            counts += 1
            assert sum(box[:, 2].min() < 1e-4 for box in there) != 2
    assert counts > 15
