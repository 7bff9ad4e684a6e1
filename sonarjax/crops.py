"""Resample a box of any size in a frame to the fixed shape of a crop that the network takes, and back.

Training and inference use the same functions, because a network only fits the resampling with which it was trained.
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
"""Smallest size (range, beam) of a crop in its frame, before resampling [pixels]."""


class Box(NamedTuple):
    """A rectangle in a frame. Its edges need not coincide with pixel edges."""

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
    """Resample a part of a frame to the shape of a crop.

    Interpolation is linear; where the image shrinks, pixels are averaged. Values outside the frame are zero. The
    function is differentiable in the image and in the box, and works under jit and vmap.

    Args:
        image: Frame (range, beam).
        box: The part to cut out.
        shape: Number of range bins and beams of the crop.

    Returns:
        Crop (patch_range, patch_beam).
    """
    scale = jnp.stack([shape[0] / jnp.asarray(box.rows), shape[1] / jnp.asarray(box.columns)])
    corner = jnp.stack([jnp.asarray(box.top, jnp.float32), jnp.asarray(box.left, jnp.float32)])
    return jax.image.scale_and_translate(image, shape, (0, 1), scale, -corner * scale, "linear", antialias=True)


def paste_patch(
    patch: Float[Array, "patch_range patch_beam"], box: Box, shape: tuple[int, int], outside: float = 0.5
) -> Float[Array, "range beam"]:
    """Put a crop back into a frame: the inverse of `cut_box`.

    Args:
        patch: Crop (patch_range, patch_beam).
        box: The part of the frame that the crop covers.
        shape: Number of range bins and beams of the frame.
        outside: Value of the pixels outside the box; the default is the grey of background.

    Returns:
        Frame (range, beam).
    """
    rows, columns = patch.shape
    scale = jnp.stack([jnp.asarray(box.rows) / rows, jnp.asarray(box.columns) / columns])
    corner = jnp.stack([jnp.asarray(box.top, jnp.float32), jnp.asarray(box.left, jnp.float32)])
    placed = jax.image.scale_and_translate(patch - outside, shape, (0, 1), scale, corner, "linear", antialias=True)
    return placed + outside
