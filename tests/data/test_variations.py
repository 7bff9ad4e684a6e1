"""Unusual objects of training pairs: they are what they are said to be, and keep what the renderer is promised."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.data.objects import draw_shape
from sonarjax.data.pairs import PairSettings, make_pairs, split_key
from sonarjax.data.shapes import BOXES, CROSSINGS, MOST_BOXES, N_VERTICES, RING_SIDES, RINGS, TUBE, shape_mesh
from sonarjax.data.variations import HANGING_M, PALE_DB, vary, without_floor
from sonarjax.scene import objects
from sonarjax.scene.slicing import has_crossing_triangles
from sonarjax.sonar import FloorPatch
from tests.data.test_objects import extent, front_crossings

DRAWS = 256


@pytest.fixture(scope="module")
def drawn():
    """Usual vertices (draw, vertex, 3); kinds (draw,), vertices and faces of the varied; how pale, and no floor."""

    def draw(key):
        usual = draw_shape(key=key)
        shape, variation = vary(usual, key=jax.random.fold_in(key, 1))
        mesh = shape_mesh(shape.kind, shape.vertices, jnp.zeros((8, 3)))
        faces = mesh.faces[: 2 * RINGS * RING_SIDES]
        return usual.vertices, shape.kind, shape.vertices, faces, variation.reflectivity, variation.no_floor

    return [np.asarray(v) for v in jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(8), DRAWS))]


def test_most_objects_stay_as_they_are_and_nothing_stays_nothing(drawn):
    usual, _, vertices, *_ = drawn
    same = np.isclose(usual, vertices, atol=1e-6).all((1, 2))
    absent = np.array([extent(v) == 0 for v in usual])
    assert 0.35 < same.mean() < 0.6
    assert absent.any() and same[absent].all()


def test_surfaces_look_outwards_and_hang_no_higher_than_stated(drawn):
    usual, _, vertices, faces, *_ = drawn
    lowest = vertices[..., 2].min(1)
    for before, points, triangles in zip(usual, vertices, faces, strict=True):
        if extent(before):
            assert np.linalg.det(points[triangles].astype(float)).sum() / 6 > 1e-7
    assert lowest.min() > -1e-4 and 0.3 < lowest.max() < 0.1 + HANGING_M[1]
    assert 0.05 < (lowest > 0.1).mean() < 0.2


def test_chains_are_long_and_thin(drawn):
    _, kinds, vertices, *_ = drawn
    rings = vertices[kinds == TUBE][:, :-2].reshape(-1, RINGS, RING_SIDES, 3)
    middles = rings.mean(2)
    thickness = np.linalg.norm(rings - middles[:, :, None], axis=3).max((1, 2))
    length = np.linalg.norm(np.diff(middles, axis=1), axis=2).sum(1)
    wound = length > 1.02 * np.linalg.norm(middles[:, -1] - middles[:, 0], axis=1)
    chains = (length > 8 * thickness) & wound & (thickness < 0.06)
    assert 15 <= chains.sum() <= 65


def test_bars_of_a_frame_do_not_pass_through_one_another(drawn):
    """Frames are known by four bars of one thickness, of which two are equally long."""
    usual, kinds, vertices, *_ = drawn
    changed = (kinds == BOXES) & (np.abs(np.ptp(usual, axis=1) - np.ptp(vertices, axis=1)) > 0.02).any(1)
    _, box_faces = objects.box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    faces = np.concatenate([box_faces + 8 * number for number in range(MOST_BOXES)])
    found = 0
    for points in vertices[changed]:
        corners = points[: 8 * MOST_BOXES].reshape(MOST_BOXES, 8, 3)
        sides = np.stack([np.linalg.norm(corners[:, k] - corners[:, 0], axis=-1) for k in (1, 2, 4)], 1)
        if np.ptp(sides[:, 2]) < 1e-4 and np.allclose(sides[0], sides[1], atol=1e-4) and sides[0, 0] > 0.1:
            found += 1
            assert not has_crossing_triangles(corners.reshape(-1, 3).astype(float), faces)
            assert np.linalg.norm(corners[0].mean(0) - corners[1].mean(0)) > 2 * sides[0, 2]
    assert 12 <= found <= 60


def test_slices_cross_no_more_triangles_than_promised(drawn):
    """But for a few through a chain or a bent tube, whose surplus triangles are left out of the pair."""
    crossings = []
    for points, faces in zip(drawn[2], drawn[3], strict=True):
        for turn in (0.3, 1.7, 3.9):
            head = np.array([-2.2 * math.cos(turn), -2.2 * math.sin(turn), 0.9])
            crossings.append(front_crossings(points[faces].astype(float), head, turn + np.linspace(-0.25, 0.25, 61)))
    beyond = np.stack(crossings) > CROSSINGS
    assert beyond.mean() < 1e-3 and beyond.any(1).mean() < 0.01, (beyond.mean(), beyond.any(1).mean())


def test_some_are_pale_and_some_stand_over_no_floor(drawn):
    *_, level, no_floor = drawn
    pale = level < 1
    assert level.max() == 1 and 0.16 < pale.mean() < 0.34
    db = -10 * np.log10(level[pale])
    assert PALE_DB[0] - 1e-3 <= db.min() and db.max() <= PALE_DB[1] + 1e-3
    assert 0.01 < no_floor.mean() < 0.12


def test_without_a_floor_no_bin_of_it_is_lit():
    sonar = sj.Sonar.preset("didson-hf", tilt=0.35, height=0.9, floor=FloorPatch(2.3, 0.0, 4.0, 4.0))
    nothing = sj.Mesh.from_arrays(*objects.box((0.1, 0.1, 0.1), (0.0, 0.0, 0.05)))
    far = sj.Pose(60.0, 0.0, 0.0)
    lit, dark = (sj.render(nothing, far, without_floor(sonar, jnp.asarray(gone))) for gone in (False, True))
    assert np.mean(lit.lit) > 0.3 and np.mean(dark.lit) < 1e-3


@pytest.mark.slow
def test_varied_pairs_have_longer_thin_objects():
    """The recipe's pairs: drawn from the same key, most are those of the usual settings."""
    settings = PairSettings(varied=True)
    assert N_VERTICES == RINGS * RING_SIDES + 2
    usual, varied = (make_pairs(16, one, key=split_key(0, "train")) for one in (PairSettings(), settings))
    same = np.array([np.array_equal(a, b) for a, b in zip(usual.labels, varied.labels, strict=True)])
    assert 1 <= same.sum() < 16
    assert set(np.unique(varied.labels)) == {0, 1, 2}
