"""Frames through tiles and closer looks, with a network that hands on what it is given; the shipped one elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from sonarjax.data import Box, crops
from sonarjax.segment import tiled
from sonarjax.segment.generator import Generator
from sonarjax.segment.tiled import box_around, pixels_inside, segment_frame
from sonarjax.segment.weights import GeneratorWeights

NO_WEIGHTS = GeneratorWeights(None, Generator(1))
TILES = 6  # of a frame of 512 × 96 pixels


@pytest.fixture
def handing_on(monkeypatch):
    """A network whose answer is its image; the patches that it was given, one a call."""
    given = []

    def through(weights, images, engine):
        given.extend(np.asarray(images))
        return images

    monkeypatch.setattr(tiled, "segment_patch", through)
    return given


def scene(shape=(512, 96)) -> np.ndarray:
    """A highlight in front of its shadow on background, all smooth: what survives resampling."""
    row, column = np.arange(shape[0])[:, None], np.arange(shape[1])

    def bump(center, width):
        return np.exp(-(((row - center[0]) / width[0]) ** 4) - ((column - center[1]) / width[1]) ** 4)

    near, beam = 0.4 * shape[0], 0.5 * shape[1]
    grey = 0.5 + 0.5 * bump((near, beam), (12, 6)) - 0.5 * bump((near + 28, beam), (20, 6))
    return grey.astype(np.float32)


def test_margins_are_a_quarter_of_the_largest_of_training():
    assert pytest.approx(crops.MARGIN[1] / 4) == tiled.MARGIN
    assert pytest.approx(crops.MARGIN_OF_FRAME[1] / 4) == tiled.MARGIN_OF_FRAME


@pytest.mark.parametrize(("shape", "tiles"), [((512, 96), TILES), ((256, 64), 1), ((100, 40), 1), ((700, 130), 20)])
def test_tiles_put_a_frame_together_again(handing_on, shape, tiles):
    image = scene(shape)
    np.testing.assert_allclose(segment_frame(NO_WEIGHTS, image, closer=False), image, atol=0.03)
    assert len(handing_on) == tiles


def test_a_closer_look_is_at_the_object(handing_on):
    image = scene()
    grey = segment_frame(NO_WEIGHTS, image)
    np.testing.assert_allclose(grey, image, atol=0.03)
    assert len(handing_on) == TILES + 2
    np.testing.assert_array_equal(handing_on[-1], handing_on[-2][:, ::-1])  # as it is, and mirrored
    (box,) = tiled._objects(image)
    rows, columns = pixels_inside(box)
    seen = np.abs(image - 0.5) > 0.05
    assert seen[rows, columns].sum() == seen.sum()
    assert box.rows < 0.5 * image.shape[0] and box.columns < 0.7 * image.shape[1]


def test_two_objects_and_an_empty_frame(handing_on):
    image = np.full((512, 96), 0.5, np.float32)
    assert tiled._objects(image) == []
    image[100:120, 10:20] = image[350:370, 60:75] = 1.0
    image[250:252, 40:41] = 1.0  # too little to be an object
    assert len(tiled._objects(image)) == 2
    segment_frame(NO_WEIGHTS, image)
    assert len(handing_on) == TILES + 2 * 2


def test_what_was_not_measured_is_floor_to_the_network_and_background_after_it(handing_on, monkeypatch):
    image, mask = scene(), np.ones((512, 96), bool)
    mask[:, :20] = False
    image[:, :20] = np.nan
    image[:, 20:] -= 0.2  # a darker floor
    through, seen = tiled._through_tiles, []
    monkeypatch.setattr(tiled, "_through_tiles", lambda *given: seen.append(given[1]) or through(*given))
    grey = segment_frame(NO_WEIGHTS, image, mask, closer=False)
    assert (grey[:, :20] == 0.5).all()
    np.testing.assert_allclose(grey[:, 24:], image[:, 24:], atol=0.05)
    np.testing.assert_allclose(np.asarray(seen[0])[:, :20], 0.3, atol=1e-6)
    assert (segment_frame(NO_WEIGHTS, image, np.zeros_like(mask)) == 0.5).all()


def test_box_around_stays_in_the_frame_and_is_never_thin():
    box = box_around((0, 90, 2, 96), (512, 96))
    assert box.top == 0 and box.left + box.columns == 96
    assert box.rows >= 20 and box.columns >= 6
    middle = box_around((200, 40, 201, 41), (512, 96))
    assert middle.rows >= tiled.LEAST[0] and middle.columns >= tiled.LEAST[1]


def test_pixels_inside_are_whole():
    assert pixels_inside(Box(1.2, 3.0, 4.0, 2.0)) == (slice(2, 5), slice(3, 5))
