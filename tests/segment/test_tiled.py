"""Frames through tiles and closer looks, with a network that hands on what it is given; the shipped one elsewhere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skimage.measure import label, regionprops
from skimage.morphology import closing

from sonarjax.data import Box, crops
from sonarjax.segment import objects, tiled
from sonarjax.segment.generator import Generator
from sonarjax.segment.objects import connected_parts, find_objects
from sonarjax.segment.tiled import box_around, pixels_inside, segment
from sonarjax.segment.weights import GeneratorWeights

GIVEN: list[np.ndarray] = []
TILES = 6  # of a frame of 512 × 96 pixels


class HandingOn(Generator):
    """A network whose answer is its image; it notes in GIVEN what it was given."""

    def __call__(self, x: Any, train: bool = False) -> Any:
        jax.debug.callback(lambda image: GIVEN.append((np.asarray(image)[0, ..., 0] + 1) / 2), x, ordered=True)
        return x


class Shaded(Generator):
    """A network whose answer is its image, duller to the right: it depends on where a patch lies in the frame."""

    def __call__(self, x: Any, train: bool = False) -> Any:
        return x * jnp.linspace(1.0, 0.8, x.shape[2])[:, None]


class Rim(Generator):
    """Sees highlight along both sides of whatever patch it gets."""

    def __call__(self, x: Any, train: bool = False) -> Any:
        at, width = jnp.arange(x.shape[2]), x.shape[2]
        return jnp.zeros_like(x) + jnp.where((at < width // 8) | (at >= width - width // 8), 1.0, 0.0)[:, None]


NO_WEIGHTS = GeneratorWeights({}, HandingOn(1))


def through(image: np.ndarray, mask: np.ndarray | None = None, **settings: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """The map of an image, and the patches that the network was given."""
    GIVEN.clear()
    grey = np.asarray(segment(image, NO_WEIGHTS, mask, **settings))
    jax.effects_barrier()
    return grey, list(GIVEN)


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
def test_tiles_put_a_frame_together_again(shape, tiles):
    image = scene(shape)
    grey, given = through(image, closer=0)
    np.testing.assert_allclose(grey, image, atol=0.03)
    assert len(given) == tiles


def test_a_closer_look_is_at_the_object():
    image = scene()
    grey, given = through(image)
    np.testing.assert_allclose(grey, image, atol=0.03)
    assert len(given) == TILES + 2  # nothing is computed for objects that are not there
    np.testing.assert_allclose(given[-1], given[-2][:, ::-1], atol=1e-6)  # as it is, and mirrored
    found = find_objects(jnp.asarray(image), 3)
    assert found.found.tolist() == [True, False, False]
    box = box_around(found.bounds[0], image.shape)
    seen = np.abs(image - 0.5) > 0.05
    assert seen[np.asarray(pixels_inside(box, image.shape))].sum() == seen.sum()
    assert box.rows < 0.5 * image.shape[0] and box.columns < 0.7 * image.shape[1]


def test_two_objects_and_an_empty_frame():
    image = np.full((512, 96), 0.5, np.float32)
    assert not find_objects(jnp.asarray(image), 3).found.any()
    assert len(through(image)[1]) == TILES
    image[100:120, 10:20] = image[350:370, 60:75] = 1.0
    image[250:252, 40:41] = 1.0  # too little to be an object
    found = find_objects(jnp.asarray(image), 3)
    assert found.found.tolist() == [True, True, False]
    assert found.bounds[:2].tolist() == [[350, 60, 370, 75], [100, 10, 120, 20]]
    assert len(through(image)[1]) == TILES + 2 * 2


def test_objects_are_those_of_scikit_image():
    """On smoothed noise, whose parts wind and touch the frame's edges."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        rough = np.asarray(rng.random((80, 48)), np.float32)
        smooth = (rough + np.roll(rough, 1, 0) + np.roll(rough, 1, 1) + np.roll(rough, (1, 1), (0, 1))) / 4
        grey = np.clip(0.5 + 2.2 * (smooth - 0.5), 0, 1).astype(np.float32)
        evidence = np.abs(grey - 0.5)
        parts = label(evidence > objects.LEAST_EVIDENCE)
        ours = np.asarray(connected_parts(jnp.asarray(evidence > objects.LEAST_EVIDENCE)))
        assert len({*zip(ours.ravel().tolist(), parts.ravel().tolist(), strict=True)}) == parts.max() + 1
        assert len(np.unique(ours)) == parts.max() + 1
        closed = label(closing(evidence > objects.LEAST_EVIDENCE, np.ones(objects.CLOSING, bool)))
        wanted = sorted(regionprops(closed, evidence), key=lambda part: -part.image_intensity.sum())[:3]
        found = find_objects(jnp.asarray(grey), 3)
        for k, part in enumerate(wanted):
            counts = part.image_intensity.sum() >= objects.LEAST_SHARE * wanted[0].image_intensity.sum()
            assert bool(found.found[k]) == counts
            if counts:
                assert tuple(found.bounds[k].tolist()) == part.bbox


@pytest.mark.parametrize(
    "shape", [(1, 1), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((1, 4), (2, 2), (5, 1)))]
)
def test_a_frame_of_fewer_pixels_than_closer_looks(shape):
    np.testing.assert_allclose(through(np.full(shape, 0.5, np.float32))[0], 0.5, atol=1e-6)
    found = find_objects(jnp.ones(shape), tiled.CLOSER)
    assert found.found.tolist() == [True] + (tiled.CLOSER - 1) * [False]
    assert found.bounds[0].tolist() == [0, 0, *shape]


def test_a_long_winding_part_is_one():
    mask = np.zeros((65, 64), bool)
    mask[::2] = True
    mask[1::4, -1] = mask[3::4, 0] = True
    found = np.asarray(connected_parts(jnp.asarray(mask)))
    assert len(np.unique(found[mask])) == 1 and (found[~mask] == 0).all()


def test_what_was_not_measured_is_floor_to_the_network_and_background_after_it():
    image, mask = scene(), np.ones((512, 96), bool)
    mask[:, :20] = False
    image[:, :20] = np.nan
    image[:, 20:] -= 0.2  # a darker floor
    grey, given = through(image, mask, closer=0)
    assert (grey[:, :20] == 0.5).all()
    np.testing.assert_allclose(grey[:, 24:], image[:, 24:], atol=0.05)
    np.testing.assert_allclose(given[0][:, :20], 0.3, atol=1e-6)
    assert (through(image, np.zeros_like(mask))[0] == 0.5).all()


def test_a_batch_is_as_its_frames():
    images = jnp.stack([scene((256, 64)), scene((256, 64))[::-1]])
    weights = GeneratorWeights({}, Shaded(1))
    found = jax.vmap(lambda image: segment(image, weights, closer=1))(images)
    for k in range(2):
        np.testing.assert_allclose(found[k], segment(images[k], weights, closer=1), atol=1e-5)


def test_box_around_stays_in_the_frame_and_is_never_thin():
    box = box_around(jnp.array([0, 90, 2, 96]), (512, 96))
    assert box.top == 0 and box.left + box.columns == 96
    assert box.rows >= 20 and box.columns >= 6
    middle = box_around(jnp.array([200, 40, 201, 41]), (512, 96))
    assert middle.rows >= tiled.LEAST[0] and middle.columns >= tiled.LEAST[1]


def test_pixels_inside_are_whole():
    rows, columns = np.nonzero(pixels_inside(Box(1.2, 3.0, 4.0, 2.0), (8, 8)))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (2, 4, 3, 4)


def test_a_tile_counts_most_in_its_middle() -> None:
    grey = np.asarray(segment(np.full((256, 96), 0.5, np.float32), GeneratorWeights({}, Rim(1)), closer=0))
    assert grey[:, [33, 62]].max() < 0.6  # at the side of one tile, in the middle of the other
    assert grey[:, 0].min() > 0.9


def test_where_a_closer_look_is_less_sure_their_mean_is_used() -> None:
    box = jnp.array([4.0, 4.0, 40.0, 20.0])
    state = tiled._Seen(jnp.zeros((2, 64, 32)), jnp.full((64, 32), 0.9), box[None], jnp.array([True]))
    for answer, expected in ((0.5, 0.7), (0.6, 0.75), (1.0, 1.0), (0.0, 0.0)):
        grey = tiled._paste(state, jnp.full(tiled.PATCH, answer), Box(*box), jnp.array(True)).grey
        np.testing.assert_allclose(grey[10:30, 8:20], expected, atol=1e-5)
        np.testing.assert_allclose(grey[50:], 0.9)
