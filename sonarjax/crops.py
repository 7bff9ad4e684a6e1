"""Crops: a box of any size in a frame, resampled to the one shape that the network sees, and back.

Training and inference share these functions, because a network knows only the resampling that it was trained with.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

PATCH = (128, 128)
"""Shape (range, beam) of a crop after resampling [pixels]."""
TRAINING_FRAME = (256, 64)
"""Shape (range, beam) of the frames that training crops are cut from [pixels]."""
LEAST = (40, 12)
"""Least extent (range, beam) of a crop in its frame [pixels]."""


class Box(NamedTuple):
    """A part of a frame; edges need not fall on pixels."""

    top: Float[Array, ""] | float
    """Near edge [range bins]."""
    left: Float[Array, ""] | float
    """Starboard edge [beams]."""
    rows: Float[Array, ""] | float
    """Extent in range [range bins]."""
    columns: Float[Array, ""] | float
    """Extent in azimuth [beams]."""


def cut_box(
    image: Float[Array, "range beam"], box: Box, shape: tuple[int, int] = PATCH
) -> Float[Array, "patch_range patch_beam"]:
    """A part of an image (range, beam) as one of `shape` (patch_range, patch_beam): linear, averaged where it shrinks.

    Zero beyond the frame. Differentiable, under jit and vmap, the box too.
    """
    scale = jnp.stack([shape[0] / jnp.asarray(box.rows), shape[1] / jnp.asarray(box.columns)])
    corner = jnp.stack([jnp.asarray(box.top, jnp.float32), jnp.asarray(box.left, jnp.float32)])
    return jax.image.scale_and_translate(image, shape, (0, 1), scale, -corner * scale, "linear", antialias=True)


def paste_patch(
    patch: Float[Array, "patch_range patch_beam"], box: Box, shape: tuple[int, int], outside: float = 0.5
) -> Float[Array, "range beam"]:
    """The inverse of `cut_box`: a patch (patch_range, patch_beam) on the pixels of a frame of `shape` (range, beam).

    Pixels outside the box are `outside`, by default the grey of background.
    """
    rows, columns = patch.shape
    scale = jnp.stack([jnp.asarray(box.rows) / rows, jnp.asarray(box.columns) / columns])
    corner = jnp.stack([jnp.asarray(box.top, jnp.float32), jnp.asarray(box.left, jnp.float32)])
    placed = jax.image.scale_and_translate(patch - outside, shape, (0, 1), scale, corner, "linear", antialias=True)
    return placed + outside
