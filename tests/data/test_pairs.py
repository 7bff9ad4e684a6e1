"""Pairs: the same for the same key whatever is made beside them, labelled as a plain render is, splits disjoint."""

from __future__ import annotations

import itertools

import jax
import numpy as np
import pytest

from sonarjax.data import pairs as module
from sonarjax.data.crops import cut_labels, draw_box
from sonarjax.data.objects import draw_shape
from sonarjax.data.pairs import CHUNK, PairSettings, make_pairs, paper_pairs, split_key
from sonarjax.data.shapes import N_VERTICES, shape_mesh
from sonarjax.data.views import draw_view
from sonarjax.io import SonarjaxError
from sonarjax.render import RenderQuality, render
from sonarjax.scene import Mesh, Pose

COUNT = 3 * CHUNK


@pytest.fixture(scope="module")
def pairs():
    return make_pairs(COUNT, key=split_key(0, "train"))


def test_shapes_and_values(pairs):
    image, labels = np.asarray(pairs.image), np.asarray(pairs.labels)
    assert image.shape == labels.shape == (COUNT, 128, 128) and labels.dtype == np.uint8
    assert image.min() >= 0 and image.max() <= 1
    np.testing.assert_allclose(image * 255, np.rint(image * 255), atol=1e-4)
    shares = np.bincount(labels.ravel(), minlength=3) / labels.size
    assert len(shares) == 3 and shares[0] > 0.5 and shares[1] > 0.01 and shares[2] > 0.05


def test_highlight_is_brighter_than_shadow(pairs):
    """Over all pairs, whatever the device: what the labels call highlight echoes, and shadow does not."""
    image, labels = np.asarray(pairs.image), np.asarray(pairs.labels)
    means = [
        [im[lb == k].mean() for k in (1, 2)] for im, lb in zip(image, labels, strict=True) if set(lb.ravel()) >= {1, 2}
    ]
    brighter = np.array([highlight > shadow for highlight, shadow in means])
    assert len(brighter) > COUNT // 2 and brighter.mean() > 0.9


@pytest.mark.slow
def test_pair_depends_on_its_key_and_number_only(pairs):
    again = make_pairs(5, key=split_key(0, "train"), first=CHUNK - 2)
    np.testing.assert_array_equal(again.image, pairs.image[CHUNK - 2 : CHUNK + 3])
    np.testing.assert_array_equal(again.labels, pairs.labels[CHUNK - 2 : CHUNK + 3])
    other = make_pairs(2, key=split_key(0, "test"))
    assert (np.asarray(other.image) != np.asarray(pairs.image[:2])).any(axis=(1, 2)).all()


@pytest.mark.slow
def test_paper_pairs_are_the_first_of_training(pairs, monkeypatch):
    assert module.PAPER_PAIRS == 6780
    monkeypatch.setattr(module, "PAPER_PAIRS", 4)
    made = paper_pairs(0, PairSettings())  # as the fixture's: the paper's own settings are another compiled function
    np.testing.assert_array_equal(made.image, pairs.image[:4])


def test_splits_share_no_key():
    keys = [
        tuple(np.asarray(jax.random.key_data(jax.random.fold_in(split_key(run_seed, split), number))).tolist())
        for run_seed, split, number in itertools.product((0, 1, 2), ("train", "validation", "test"), range(100))
    ]
    assert len(set(keys)) == len(keys)
    with pytest.raises(SonarjaxError, match="train, validation, test"):
        split_key(0, "tset")


def test_count_must_be_positive():
    with pytest.raises(SonarjaxError, match="1 or more"):
        make_pairs(0, key=jax.random.key(0))


@pytest.mark.slow
def test_labels_are_those_of_a_plain_render(pairs):
    """The object of a pair read from arrays and rendered alone, with the bounds measured there."""
    vertices, faces, sonar, box_key = _drawn(jax.random.fold_in(split_key(0, "train"), 1))
    faces = np.asarray(faces)
    read = Mesh.from_arrays(np.asarray(vertices), faces[faces.max(axis=1) < N_VERTICES])
    highlight, shadow, labels = _layers(read, sonar)
    box = draw_box(labels, key=box_key)
    wanted, found = np.asarray(cut_labels(highlight, shadow, box)), np.asarray(pairs.labels[1])
    touched = (wanted > 0) | (found > 0)
    print(f"{(wanted == found).mean():.4f} of all, {(wanted == found)[touched].mean():.4f} of the object's pixels")
    assert touched.sum() > 1000 and (wanted == found)[touched].mean() > 0.98


@jax.jit
def _drawn(key):
    shape_key, view_key, *_, box_key = jax.random.split(key, 6)
    shape = draw_shape(key=shape_key)
    view = draw_view(PairSettings().n_ranges, PairSettings().n_beams, key=view_key)
    mesh = shape_mesh(shape.kind, view.pose.to_ground(shape.vertices), view.walls)
    return mesh.vertices, mesh.faces, view.sonar, box_key


@jax.jit
def _layers(mesh, sonar):
    frame = render(mesh, Pose(), sonar, quality=RenderQuality(1))
    return frame.highlight, frame.shadow, frame.labels()
