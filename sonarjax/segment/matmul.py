"""The stride-2 4 × 4 layers as one matrix product each, for CPUs: the faster scheme for thin or tiny maps.

The steps have the same names as those of `winograd`, so that `products` can use either: they pass lists of matrices,
here lists of one.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array


def gather(x: Array) -> list[Array]:
    """Large map (n, 2h, 2w, c) -> the 4 × 4 window of each pixel of the small map (pixel, 16c)."""
    n, h, w, c = x.shape
    pairs = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0))).reshape(n, h + 2, w // 2 + 1, 2 * c)
    fours = jnp.concatenate([pairs[:, :, :-1], pairs[:, :, 1:]], -1)
    windows = jnp.concatenate([fours[:, a : a + h : 2] for a in range(4)], -1)
    return [windows.reshape(-1, 16 * c)]


def scatter(one: list[Array], small: tuple[int, int, int]) -> Array:
    """Transpose of `gather`: (pixel, 16c) -> large map (n, 2h, 2w, c), summed where windows overlap."""
    n, h, w = small
    windows = one[0].reshape(n, h, w, 4, 4, -1)
    rows = jnp.stack(_overlap([windows[:, :, :, a] for a in range(4)], 1), 2)  # (n, h, 2, w, 4, c)
    columns = jnp.stack(_overlap([rows[:, :, :, :, b] for b in range(4)], 3), 4)
    return columns.reshape(n, 2 * h, 2 * w, -1)


def _overlap(taps: list[Array], axis: int) -> list[Array]:
    """Even and odd pixels along an axis: each sums one tap of its own window and one of the window beside it."""
    return [taps[1] + shifted(taps[3], axis, 1), taps[2] + shifted(taps[0], axis, -1)]


def shifted(v: Array, axis: int, by: int) -> Array:
    """Shift `v` (any shape) by `by` places along an axis, filling with zeros."""
    config = [(0, 0, 0)] * v.ndim
    config[axis] = (by, -by, 0)
    return lax.pad(v, jnp.zeros((), v.dtype), config)


def split(y: Array) -> list[Array]:
    """Small map (n, h, w, f) -> (pixel, f)."""
    return [y.reshape(-1, y.shape[-1])]


def join(one: list[Array], small: tuple[int, int, int]) -> Array:
    """Transpose of `split`."""
    return one[0].reshape(*small, -1)


def spread_kernel(kernel: Array) -> list[Array]:
    """Kernel (4, 4, c, f) -> matrix (16c, f)."""
    return [kernel.reshape(-1, kernel.shape[-1])]


def join_kernel(one: list[Array], shape: tuple[int, ...]) -> Array:
    """Transpose of `spread_kernel`."""
    return one[0].reshape(shape)
