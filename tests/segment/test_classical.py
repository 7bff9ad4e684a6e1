"""Classical segmentation on frames whose classes are known, and against scikit-image's thresholds."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.filters import threshold_multiotsu, threshold_otsu

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment import SEGMENTERS, load_segmenter
from sonarjax.segment.classical import CLASSICAL, MEDIANS


def segment(image: np.ndarray, name: str, mask: np.ndarray | None = None) -> np.ndarray:
    return load_segmenter(name).labels(image, mask)


def scene(rng: np.random.Generator, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A grey frame with a highlight and a shadow in noise, and its labels."""
    labels = np.zeros((60, 40), np.uint8)
    labels[10:25, 10:30], labels[25:50, 10:30] = 1, 2
    grey = np.array([0.4, 0.9, 0.1])[labels] + rng.normal(0, noise, labels.shape)
    return np.clip(grey, 0, 1).astype(np.float32), labels


def test_three_levels_are_found(rng: np.random.Generator) -> None:
    image, labels = scene(rng, 0.02)
    assert (segment(image, "otsu3") == labels).all()
    for name in MEDIANS:  # a median rounds the corners of the squares off
        assert (segment(image, name) != labels).mean() < 0.02


def test_medians_take_noise_away(rng: np.random.Generator) -> None:
    image, labels = scene(rng, 0.2)
    wrong = {name: (segment(image, name) != labels).mean() for name in ("otsu3", "otsu", "median-otsu")}
    assert wrong["median-otsu"] < wrong["otsu"] < wrong["otsu3"]


def test_thresholds_are_otsus(rng: np.random.Generator) -> None:
    image, _ = scene(rng, 0.1)
    np.testing.assert_array_equal(segment(image, "otsu1"), image > threshold_otsu(image))
    low, high = threshold_multiotsu(image)
    np.testing.assert_array_equal(segment(image, "otsu3"), np.where(image > high, 1, np.where(image <= low, 2, 0)))


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_constant_frame_and_what_was_not_measured(name: str, rng: np.random.Generator) -> None:
    assert not segment(np.full((8, 8), 0.5, np.float32), name).any()
    image, _ = scene(rng, 0.1)
    mask = np.ones(image.shape, bool)
    mask[:30] = False
    assert not segment(image, name, mask)[:30].any()


@pytest.mark.parametrize("name", CLASSICAL)
def test_what_was_not_measured_may_hold_anything(name: str, rng: np.random.Generator) -> None:
    image, _ = scene(rng, 0.1)
    mask = np.ones(image.shape, bool)
    assert (segment(image, name, mask) == segment(image, name)).all()
    mask[:12], mask[:, 25:27] = False, False
    first, *others = (segment(np.where(mask, image, np.float32(v)), name, mask) for v in (0, 1, 255, np.nan, np.inf))
    assert (first == 1).any() and all((labels == first).all() for labels in others)


def test_a_dark_floor_stays_background_beside_what_was_not_measured(rng: np.random.Generator) -> None:
    """At a corner most of what the median filter sees was not measured."""
    image, mask = scene(rng, 0.02)[0] * np.float32(0.5), np.zeros((60, 40), bool)
    mask[4:, 4:] = True
    for name in MEDIANS:
        assert not segment(np.where(mask, image, np.nan), name, mask)[4:8, 4:8].any()


def test_the_map_of_none_is_a_new_array(rng: np.random.Generator) -> None:
    for image in (rng.random((6, 5), np.float32), rng.random((6, 5))):
        found = load_segmenter("none").semantic(image)
        assert found.dtype == np.float32 and not np.shares_memory(found, image)
        np.testing.assert_array_equal(found, image.astype(np.float32))


@pytest.mark.parametrize(
    "levels", [(0, 30000, 65535), (10, 11, 40000), (10, 39999, 40000), (0, 1, 65535), (65533, 65534, 65535)]
)
@pytest.mark.parametrize("name", ["otsu", "otsu3", "median-otsu"])
def test_three_levels_of_16_bits_are_the_three_classes(name: str, levels: tuple[int, ...]) -> None:
    shares = np.full((30, 30), levels[1], np.float32)
    shares[:, :10], shares[:, 20:] = levels[0], levels[2]
    labels = segment(shares / np.float32(65535), name)
    assert (labels[:, 0] == 2).all() and (labels[:, 15] == 0).all() and (labels[:, -1] == 1).all()


@pytest.mark.parametrize("offsets", [(0, 1, 2, 40000), (0, 39998, 39999, 40000)])
def test_levels_in_two_narrow_groups(offsets: tuple[int, ...]) -> None:
    """Multi-Otsu's histogram sees two values there; the thresholds are still those of largest variance."""
    image = np.repeat(np.array(offsets, np.float32), 25).reshape(10, 10) / np.float32(65535)
    found = [int(segment(image, "otsu3")[image == level][0]) for level in np.unique(image)]
    assert found in ([[2, 0, 0, 1], [2, 2, 0, 1]] if offsets[1] == 1 else [[2, 0, 0, 1], [2, 0, 1, 1]])


def test_values_one_rounding_apart_are_told_apart() -> None:
    near = np.float32(0.5)
    image = np.tile(np.array([near, np.nextafter(near, np.float32(1))], np.float32), (8, 4))
    np.testing.assert_array_equal(segment(image, "otsu1"), image > near)


@pytest.mark.parametrize("name", CLASSICAL)
def test_nothing_measured_is_background(name: str, rng: np.random.Generator) -> None:
    image = rng.random((6, 5), np.float32)
    assert not load_segmenter(name).labels(image, np.zeros((6, 5), bool)).any()


def test_unknown_name() -> None:
    with pytest.raises(SonarjaxError, match="otsu3"):
        load_segmenter("otsu2")


def test_every_segmenter_has_a_threshold():
    assert [name for name in SEGMENTERS if load_segmenter(name).threshold is None] == []
