"""Cutting patches: Pillow resamples the same way, pasting undoes cutting, labels follow the frame's own."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from sonarjax.crops import LEAST, PATCH, Box, cut_box, paste_patch
from sonarjax.data.crops import cut_labels, draw_box
from sonarjax.render import SonarFrame
from sonarjax.sonar import Sonar

cut = jax.jit(cut_box, static_argnums=2)  # one compilation for all boxes
paste = jax.jit(paste_patch, static_argnums=2)


@pytest.mark.parametrize("box", [Box(0.0, 0.0, 96.0, 40.0), Box(10.0, 4.0, 64.0, 16.0), Box(3.5, 2.25, 31.0, 20.5)])
def test_cut_as_pillow_does(rng, box):
    """Pillow averages with the same triangle when it shrinks, and interpolates when it stretches."""
    image = rng.random((96, 40), np.float32)
    corners = (box.left, box.top, box.left + box.columns, box.top + box.rows)
    wanted = Image.fromarray(image).resize((48, 64), Image.Resampling.BILINEAR, box=corners)
    found = np.asarray(cut(jnp.asarray(image), box, (64, 48)))
    # Pillow knows no pixels outside the box, ours looks at the neighbours: they differ at the border only.
    inner = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(found[inner], np.asarray(wanted)[inner], atol=2e-3)


def test_paste_undoes_cut():
    rows, columns = np.mgrid[0:96, 0:40]
    image = jnp.asarray(0.5 + 0.3 * np.sin(rows / 15) * np.cos(columns / 9), jnp.float32)
    box = Box(12.0, 6.0, 60.0, 24.0)
    back = np.asarray(paste(cut(image, box, PATCH), box, image.shape))
    np.testing.assert_allclose(back[15:69, 9:27], np.asarray(image)[15:69, 9:27], atol=5e-3)
    assert (back[:11] == 0.5).all() and (back[:, 31:] == 0.5).all()


def test_labels_of_the_whole_frame_are_the_frames(rng):
    highlight, shadow = (jnp.asarray(rng.random((128, 128)), jnp.float32) for _ in range(2))
    sonar = Sonar.preset("didson-hf")  # plays no part in labels
    frame = SonarFrame(highlight, highlight, shadow, highlight > 0, jnp.zeros((), jnp.int32), sonar)
    found = cut_labels(highlight, shadow, Box(0, 0, 128, 128))
    np.testing.assert_array_equal(found, frame.labels())


def test_thin_highlight_survives_stretching():
    highlight = jnp.zeros((64, 32)).at[20].set(1.0)
    labels = np.asarray(cut_labels(highlight, jnp.zeros((64, 32)), Box(0, 0, 64, 32)))
    assert (labels == 1).sum(axis=0).tolist() == [2] * 128  # one bin of 64 is two rows of 128


def test_boxes_lie_in_the_frame_and_mostly_hold_the_object():
    labels = jnp.zeros((256, 64), jnp.uint8).at[90:130, 20:36].set(2)
    draw = jax.jit(jax.vmap(lambda key: draw_box(labels, key=key)))
    top, left, height, width = (np.asarray(v) for v in draw(jax.random.split(jax.random.key(0), 500)))
    assert (top >= 0).all() and (left >= 0).all()
    assert (top + height <= 256 + 1e-3).all() and (left + width <= 64 + 1e-3).all()
    assert height.min() >= LEAST[0] - 1e-3 and width.min() >= LEAST[1] - 1e-3
    whole = (top <= 90) & (top + height >= 130) & (left <= 20) & (left + width >= 36)
    assert 0.7 < whole.mean() < 0.95


def test_boxes_of_short_frames_lie_within_them() -> None:
    labels = jnp.zeros((32, 64), jnp.uint8).at[5:12, 20:30].set(1).at[12:28, 20:30].set(2)
    boxes = jax.jit(jax.vmap(lambda key: draw_box(labels, key=key)))(jax.random.split(jax.random.key(0), 200))
    for start, length, most in ((boxes.top, boxes.rows, 32), (boxes.left, boxes.columns, 64)):
        assert (np.asarray(start) >= 0).all() and (np.asarray(start + length) <= most + 1e-3).all()
