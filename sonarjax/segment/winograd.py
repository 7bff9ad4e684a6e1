"""The stride-2 4 × 4 layers as matrix products with fewer multiplications, for CPUs (Winograd 1980, minimal filtering).

A stride-2 convolution by 4 × 4 is a stride-1 convolution by 2 × 2 on blocks of 2 × 2 pixels. Along one axis, two
outputs of the latter take three products instead of four: y₀ = d₀g₀ + d₁g₁ = (d₀ − d₁)g₀ + d₁(g₀ + g₁) and y₁ = d₁g₀ +
d₂g₁ = d₁(g₀ + g₁) + (d₂ − d₁)g₁. Along both axes this leaves nine matrix products over the channels, 9/16 of the work.
They read 9/4 times the data of the map, while plain windows would copy it four times. Only sums and differences are
added, so rounding errors stay those of plain products. The transposed layer is the transpose of this.

A *tile* is 2 × 2 pixels of the small map and 4 × 4 pixels of the large one. `products` composes the steps.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.segment.matmul import shifted

Nine = list[Array]


def gather(x: Array) -> Nine:
    """Large map (n, 4t, 4u, c) -> nine of (tile, 4c): each tile's 6 × 6 pixels as 3 × 3 blocks, then differences."""
    n, h, w, c = x.shape
    pairs = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0))).reshape(n, h + 2, w // 2 + 1, 2 * c)
    # Pairs of columns are adjacent in memory already. Concatenation joins pairs of rows, as fast as memory allows.
    blocks = jnp.concatenate([pairs[:, ::2], pairs[:, 1::2]], -1)  # (n, block row, block column, 4c)
    rows = _differences(blocks[:, :-1:2], blocks[:, 1::2], blocks[:, 2::2])
    nine = [v for r in rows for v in _differences(r[:, :, :-1:2], r[:, :, 1::2], r[:, :, 2::2])]
    return [v.reshape(-1, 4 * c) for v in nine]


def _differences(first: Array, middle: Array, last: Array) -> Nine:
    return [first - middle, middle, last - middle]


def scatter(nine: Nine, small: tuple[int, int, int]) -> Array:
    """Transpose of `gather`: nine of (tile, 4c) -> large map (n, 4t, 4u, c), summed where tiles overlap."""
    n, t, u = small[0], small[1] // 2, small[2] // 2
    c = nine[0].shape[-1] // 4
    maps = [v.reshape(n, t, u, 2, 2, c) for v in nine]
    rows = [_overlap(maps[i], maps[3 + i], maps[6 + i], 1) for i in range(3)]  # [column tap][pixel row]
    pixels = [jnp.stack(_overlap(rows[0][i], rows[1][i], rows[2][i], 2), 3) for i in range(4)]  # (n, t, u, 4, c) each
    return jnp.stack(pixels, 2).reshape(n, 4 * t, 4 * u, c)


def _overlap(first: Array, middle: Array, last: Array, axis: int) -> Nine:
    """The four pixels of a tile along an axis. The outer two also receive a part from the neighbouring tile."""
    inner = middle - first - last

    def pixel(v: Array, k: int) -> Array:
        return v[:, :, :, k]  # of the two in a block

    before, after = shifted(pixel(last, 1), axis, 1), shifted(pixel(first, 0), axis, -1)
    return [pixel(first, 1) + before, pixel(inner, 0), pixel(inner, 1), pixel(last, 0) + after]


def join(nine: Nine, small: tuple[int, int, int]) -> Array:
    """Nine products (tile, f) -> small map (n, 2t, 2u, f)."""
    n, t, u = small[0], small[1] // 2, small[2] // 2
    f = nine[0].shape[-1]
    maps = [v.reshape(n, t, u, f) for v in nine]
    rows = [(maps[i] + maps[3 + i], maps[3 + i] + maps[6 + i]) for i in range(3)]
    pixels = [jnp.stack([rows[0][i] + rows[1][i], rows[1][i] + rows[2][i]], 3) for i in range(2)]
    return jnp.stack(pixels, 2).reshape(n, 2 * t, 2 * u, f)


def split(y: Array) -> Nine:
    """Transpose of `join`: small map (n, 2t, 2u, f) -> nine of (tile, f)."""
    rows = _sums(y[:, ::2], y[:, 1::2])
    return [v.reshape(-1, y.shape[-1]) for r in rows for v in _sums(r[:, :, ::2], r[:, :, 1::2])]


def _sums(first: Array, second: Array) -> Nine:
    return [first, first + second, second]


def spread_kernel(kernel: Array) -> Nine:
    """Kernel (4, 4, c, f) -> nine matrices (4c, f)."""
    rows = _sums(kernel[:2], kernel[2:])
    return [v.reshape(-1, kernel.shape[-1]) for r in rows for v in _sums(r[:, :2], r[:, 2:])]


def join_kernel(nine: Nine, shape: tuple[int, ...]) -> Array:
    """Transpose of `spread_kernel`: nine matrices (4c, f) -> kernel (4, 4, c, f)."""
    maps = [v.reshape(2, 2, *shape[2:]) for v in nine]
    rows = [jnp.concatenate([maps[i] + maps[3 + i], maps[3 + i] + maps[6 + i]]) for i in range(3)]
    return jnp.concatenate([rows[0] + rows[1], rows[1] + rows[2]], 1)
