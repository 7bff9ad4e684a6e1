"""Mean and energy of every window of an image, without the cancellation errors of integral images.

Takes an image (range, beam) and a window shape, and returns moments (row, col) for each top-left corner. Two
neighbouring windows are merged by Chan's update (Chan, Golub and LeVeque 1983), which doubles their length. Only
differences are squared, so float32 suffices, and a constant window has an energy of exactly 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class WindowMoments(NamedTuple):
    """Moments of the pixels under a window, for every position of its top-left corner."""

    pixels: Any
    """Number of pixels that count: one number, or (row, col) if a mask hides some of them."""
    mean: Float[Array, "row col"]
    """Mean over those pixels, in the image's unit; 0 if there are none."""
    energy: Float[Array, "row col"]
    """Sum of squared deviations from that mean, in the image's unit squared."""


def window_moments(
    image: Float[Array, "range beam"], window: tuple[int, int], mask: Bool[Array, "range beam"] | None = None
) -> WindowMoments:
    """Moments of every `window` (height, width) [pixels] of `image`; only pixels where `mask` is true count.

    Returns:
        Arrays of shape (range - height + 1, beam - width + 1): S̄ and the first root of eq. 4.
    """
    moments = WindowMoments(1.0 if mask is None else mask.astype(image.dtype), image, jnp.zeros_like(image))
    for axis, length in enumerate(window):
        moments = _lengthen(moments, length, axis)
    return moments


def _lengthen(unit: WindowMoments, length: int, axis: int) -> WindowMoments:
    """Make windows `length` times as long along `axis` [pixels] by doubling: one or two merges per binary digit."""
    moments, reached = unit, 1
    for digit in bin(length)[3:]:
        moments = _merge(moments, moments, reached, axis)
        reached *= 2
        if digit == "1":
            moments = _merge(moments, unit, reached, axis)
            reached += 1
    return moments


def _merge(near: WindowMoments, far: WindowMoments, shift: int, axis: int) -> WindowMoments:
    """Union of each `near` window with the `far` window that starts `shift` pixels behind it."""
    size = far.mean.shape[axis] - shift

    def cut(values: Any, start: int) -> Any:
        return values if isinstance(values, float) else jax.lax.slice_in_dim(values, start, start + size, axis=axis)

    near = WindowMoments(*(cut(v, 0) for v in near))
    far = WindowMoments(*(cut(v, shift) for v in far))
    count = near.pixels + far.pixels
    share = far.pixels / (count if isinstance(count, float) else jnp.maximum(count, 1.0))  # 0 / 1 if there is no pixel
    step = far.mean - near.mean
    # mean + share · step is exact if both windows are the same constant; a weighted sum of means is not.
    return WindowMoments(
        count, near.mean + share * step, near.energy + far.energy + near.pixels * share * jnp.square(step)
    )
