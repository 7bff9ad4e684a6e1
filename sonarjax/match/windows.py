"""Mean and energy of every window of an image, without the cancellation of integral images.

Takes an image (range, beam) and a window shape, returns moments (row, col) for each top-left corner. Two neighbouring
windows are merged by Chan's update (Chan, Golub & LeVeque 1983), doubling their length: only differences are squared,
so float32 is enough and a constant window has energy exactly 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class WindowMoments(NamedTuple):
    """Moments of the pixels under a window, for every position of its top-left corner."""

    pixels: Any
    """Pixels that count: a number, or (row, col) where a mask hides some of them."""
    mean: Float[Array, "row col"]
    """Mean over those pixels, in the image's unit; 0 where none counts."""
    energy: Float[Array, "row col"]
    """Sum of squared deviations from that mean, in the image's unit squared."""


def window_moments(
    image: Float[Array, "range beam"], window: tuple[int, int], mask: Bool[Array, "range beam"] | None = None
) -> WindowMoments:
    """Moments of every `window` (height, width) [pixels] of `image`; only pixels where `mask` is true count.

    Returns arrays of shape (range - height + 1, beam - width + 1): the S̄ and the first root of eq. 4.
    """
    moments = WindowMoments(1.0 if mask is None else mask.astype(image.dtype), image, jnp.zeros_like(image))
    for axis, length in enumerate(window):
        moments = _lengthen(moments, length, axis)
    return moments


def _lengthen(unit: WindowMoments, length: int, axis: int) -> WindowMoments:
    """Windows `length` times as long along `axis` [pixels], by doubling: one merge or two for each binary digit."""
    moments, reached = unit, 1
    for digit in bin(length)[3:]:
        moments = _merge(moments, moments, reached, axis)
        reached *= 2
        if digit == "1":
            moments = _merge(moments, unit, reached, axis)
            reached += 1
    return moments


def _merge(near: WindowMoments, far: WindowMoments, shift: int, axis: int) -> WindowMoments:
    """Union of each `near` window and the `far` window that starts `shift` pixels behind it."""
    size = far.mean.shape[axis] - shift

    def cut(values: Any, start: int) -> Any:
        return values if isinstance(values, float) else jax.lax.slice_in_dim(values, start, start + size, axis=axis)

    near = WindowMoments(*(cut(v, 0) for v in near))
    far = WindowMoments(*(cut(v, shift) for v in far))
    count = near.pixels + far.pixels
    share = far.pixels / (count if isinstance(count, float) else jnp.maximum(count, 1.0))  # no pixel at all: 0 / 1
    step = far.mean - near.mean
    # mean + share · step, not a weighted sum of means: exact where both windows are the same constant
    return WindowMoments(
        count, near.mean + share * step, near.energy + far.energy + near.pixels * share * jnp.square(step)
    )
