"""Pairs as files: what is written comes back unchanged, what cannot be used says why in one line."""

from __future__ import annotations

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from sonarjax.data import Pairs, PairSettings, export_pairs, import_pairs
from sonarjax.io import SonarjaxError


@pytest.fixture
def pairs(rng):
    image = rng.integers(0, 256, (3, 128, 128)).astype(np.float32) / 255
    return Pairs(jnp.asarray(image), jnp.asarray(rng.integers(0, 3, (3, 128, 128)), jnp.uint8))


@pytest.fixture
def folder(pairs, tmp_path):
    export_pairs(pairs, tmp_path / "pairs", key=jax.random.key(7), settings=PairSettings(), first=40)
    return tmp_path / "pairs"


def test_round_trip(pairs, folder):
    back = import_pairs(folder)
    np.testing.assert_allclose(back.image, pairs.image, atol=1e-7)
    np.testing.assert_array_equal(back.labels, pairs.labels)


def test_rounding_beyond_the_range_is_taken_and_more_is_not(pairs, tmp_path):
    """`cut_box` may leave [0, 1] by a few units in the last place."""
    image = np.asarray(pairs.image).copy()
    image[0, :2, 0] = np.float32(1.0000002), np.float32(-1e-7)
    export_pairs(replace(pairs, image=jnp.asarray(image)), tmp_path / "rounded")
    np.testing.assert_array_equal(import_pairs(tmp_path / "rounded").image[0, :2, 0], [1.0, 0.0])
    with pytest.raises(SonarjaxError, match=r"image: expected values in \[0, 1\]"):
        export_pairs(replace(pairs, image=jnp.asarray(image + 0.001)), tmp_path / "more")


def test_other_tools_find_names_numbers_and_settings(pairs, folder):
    entries = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    assert [e["number"] for e in entries] == [40, 41, 42]
    assert entries[0]["key"] == [0, 7] and entries[0]["settings"]["n_beams"] == PairSettings().n_beams
    with Image.open(folder / entries[1]["labels"]) as picture:
        np.testing.assert_array_equal(np.asarray(picture) == 255, np.asarray(pairs.labels[1]) == 1)


def test_other_sizes_are_resampled(folder):
    image = np.full((64, 32), 200, np.uint8)
    labels = np.full((64, 32), 128, np.uint8)
    labels[:32] = 255
    Image.fromarray(image).save(folder / "a.png")
    Image.fromarray(labels).save(folder / "b.png")
    (folder / "manifest.jsonl").write_text('{"image": "a.png", "labels": "b.png"}\n')
    back = import_pairs(folder)
    np.testing.assert_allclose(back.image, 200 / 255, atol=1e-6)
    assert (np.asarray(back.labels[0, :64]) == 1).all() and (np.asarray(back.labels[0, 64:]) == 0).all()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "none"),
        ("not json", "manifest.jsonl:1: expected a JSON object"),
        ("[1]", "got list"),
        ("[" * 100_000, "manifest.jsonl:1: expected a JSON object: maximum recursion"),
        ('{"image": "image_00000.png"}', "labels: expected a file name"),
        ('{"image": "../x.png", "labels": "labels_00000.png"}', "inside the folder"),
        ('{"image": "missing.png", "labels": "labels_00000.png"}', "missing.png: no such file"),
        ('{"image": "image_00000.png", "labels": "image_00001.png"}', "0, 128 and 255"),
        ('{"image": "image_00000.png", "labels": "small.png"}', "differ in shape"),
        ('{"image": "manifest.jsonl", "labels": "labels_00000.png"}', "expected a PNG"),
    ],
)
def test_what_cannot_be_used(folder, line, complaint):
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "small.png")
    (folder / "manifest.jsonl").write_text(line + "\n")
    with pytest.raises(SonarjaxError, match=complaint) as caught:
        import_pairs(folder)
    assert "\n" not in str(caught.value)


def test_no_folder(tmp_path):
    with pytest.raises(SonarjaxError, match="no such file"):
        import_pairs(tmp_path / "nowhere")
    (tmp_path / "file").write_text("x")
    with pytest.raises(SonarjaxError, match="is a file"):
        import_pairs(tmp_path / "file")
    with pytest.raises(SonarjaxError, match="folder"):
        export_pairs(Pairs(jnp.zeros((1, 128, 128)), jnp.zeros((1, 128, 128), jnp.uint8)), tmp_path / "file")
