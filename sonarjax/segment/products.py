"""The stride-2 4 × 4 layers as matrix products, down and up, with their gradients, in one of two schemes.

`winograd` multiplies less, `matmul` moves less data. Both consist of a linear step on the large map (`gather`), one on
the small map (`split`), one on the kernel (`spread_kernel`), and matrix products. Each layer and each gradient
multiplies the outputs of two steps, then applies the transpose of the third.
"""

from __future__ import annotations

from functools import partial
from types import ModuleType

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.segment import matmul, winograd

THIN = 8
"""With fewer channels in the large map, transforming its tiles does not pay."""
TILES = 24
"""With fewer tiles in the batch, transforming the kernel costs more than the products that it saves."""


def down(x: Array, kernel: Array) -> Array:
    """Convolution (n, h, w, c) -> (n, h/2, w/2, f) with stride 2, padding 1 and kernel (4, 4, c, f)."""
    n, h, w, c = x.shape
    return _down(scheme(n, h // 2, w // 2, c), x, kernel)


def up(x: Array, kernel: Array) -> Array:
    """Transpose of `down`: (n, h, w, f) -> (n, 2h, 2w, c) with the same kernel (4, 4, c, f)."""
    n, h, w, _ = x.shape
    return _up(scheme(n, h, w, kernel.shape[2]), x, kernel)


def scheme(n: int, h: int, w: int, channels: int) -> ModuleType:
    """Choose `winograd` or `matmul` for a small map of (n, h, w) pixels and a large one of `channels`."""
    even = h % 2 == 0 and w % 2 == 0
    return winograd if even and channels >= THIN and n * h * w >= 4 * TILES else matmul


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _down(by: ModuleType, x: Array, kernel: Array) -> Array:
    n, h, w, _ = x.shape
    return by.join(_products(by.gather(x), by.spread_kernel(kernel)), (n, h // 2, w // 2))


def _down_forward(by: ModuleType, x: Array, kernel: Array) -> tuple[Array, tuple[Array, Array]]:
    return _down(by, x, kernel), (x, kernel)


def _down_backward(by: ModuleType, saved: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    x, kernel = saved
    at_kernel = by.join_kernel(_correlations(by.gather(x), by.split(slope)), kernel.shape)
    return _up(by, slope, kernel), at_kernel


_down.defvjp(_down_forward, _down_backward)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _up(by: ModuleType, x: Array, kernel: Array) -> Array:
    matrices = [matrix.T for matrix in by.spread_kernel(kernel)]
    return by.scatter(_products(by.split(x), matrices), x.shape[:3])


def _up_forward(by: ModuleType, x: Array, kernel: Array) -> tuple[Array, tuple[Array, Array]]:
    return _up(by, x, kernel), (x, kernel)


def _up_backward(by: ModuleType, saved: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    x, kernel = saved
    at_kernel = by.join_kernel(_correlations(by.gather(slope), by.split(x)), kernel.shape)
    return _down(by, slope, kernel), at_kernel


_up.defvjp(_up_forward, _up_backward)


@jax.custom_vjp
def product(a: Array, b: Array) -> Array:
    """a · b with a gradient by `b` that XLA computes fast on a CPU; JAX's own multiplies two transposed matrices."""
    return a @ b


def _product_forward(a: Array, b: Array) -> tuple[Array, tuple[Array, Array]]:
    return a @ b, (a, b)


def _product_backward(saved: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    a, b = saved
    return slope @ b.T, _correlation(a, slope)


product.defvjp(_product_forward, _product_backward)


def _products(left: list[Array], right: list[Array]) -> list[Array]:
    return [a @ b for a, b in zip(left, right, strict=True)]


def _correlations(left: list[Array], right: list[Array]) -> list[Array]:
    return [_correlation(a, b) for a, b in zip(left, right, strict=True)]


def _correlation(a: Array, b: Array) -> Array:
    """aᵀ · b: a sum over tiles or pixels."""
    return jnp.einsum("tc,tf->cf", a, b)
