"""Stride-2 4 × 4 convolutions, down and up: plain functions with two backends, and the flax modules made of them.

`convolution` is `lax.conv_general_dilated`, for GPUs and TPUs. XLA's CPU runs that slowly (its gradients and the
transposed one most of all), so there `product` writes the same layer as matrix products. Maps are channels-last.
"""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import lax
from jaxtyping import Array, Float

Backend = Literal["auto", "convolution", "product"]
_LAYOUT = ("NHWC", "HWIO", "NHWC")


def down(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 channel feature"],
    backend: Backend = "auto",
) -> Float[Array, "batch halfheight halfwidth feature"]:
    """Convolution of maps (batch, height, width, channel), stride 2, padding 1, with `kernel` (4, 4, channel, feature).

    Returns (batch, halfheight, halfwidth, feature); height and width are even. Both backends give the same numbers.
    """
    if _use_product(backend):
        return _down_product(x, kernel)
    return lax.conv_general_dilated(x, kernel, (2, 2), ((1, 1), (1, 1)), dimension_numbers=_LAYOUT)


def up(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 channel feature"],
    backend: Backend = "auto",
) -> Float[Array, "batch twiceheight twicewidth feature"]:
    """Transposed convolution, stride 2, of maps (batch, height, width, channel): each pixel spreads over 4 × 4 pixels.

    `kernel` is (4, 4, channel, feature): out[2i + a − 1, 2j + b − 1] sums x[i, j] · kernel[a, b]. Returns
    (batch, twiceheight, twicewidth, feature). Both backends give the same numbers.
    """
    if _use_product(backend):
        return _up_product(x, kernel)
    flipped = kernel[::-1, ::-1]
    return lax.conv_general_dilated(
        x, flipped, (1, 1), ((2, 2), (2, 2)), lhs_dilation=(2, 2), dimension_numbers=_LAYOUT
    )


def patch(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 channel feature"],
    backend: Backend = "auto",
) -> Float[Array, "batch lessheight lesswidth feature"]:
    """Convolution of maps (batch, height, width, channel), stride 1, padding 1, with `kernel` (4, 4, channel, feature).

    Returns (batch, lessheight, lesswidth, feature), one pixel less each way. The product suits few features only.
    """
    if not _use_product(backend):
        return lax.conv_general_dilated(x, kernel, (1, 1), ((1, 1), (1, 1)), dimension_numbers=_LAYOUT)
    n, h, w, c = x.shape
    features = kernel.shape[-1]
    # The sixteen products of every pixel first, then sums of shifted maps, which are thin.
    products = (x @ kernel.transpose(2, 0, 1, 3).reshape(c, -1)).reshape(n, h, w, 4, 4, features)
    products = jnp.pad(products, ((0, 0), (1, 1), (1, 1), (0, 0), (0, 0), (0, 0)))
    return jnp.asarray(sum(products[:, a : a + h - 1, b : b + w - 1, a, b] for a in range(4) for b in range(4)))


def _use_product(backend: Backend) -> bool:
    return jax.default_backend() == "cpu" if backend == "auto" else backend == "product"


def _down_product(x: Array, kernel: Array) -> Array:
    _, h, w, c = x.shape
    phases = _to_depth(jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0))))  # (n, h/2 + 1, w/2 + 1, 4c)
    windows = jnp.concatenate([phases[:, a : a + h // 2, b : b + w // 2] for a in (0, 1) for b in (0, 1)], -1)
    # Rows of the matrix in the order of the windows: block (2 × 2) first, place in the block (2 × 2) second.
    matrix = kernel.reshape(2, 2, 2, 2, c, -1).transpose(0, 2, 1, 3, 4, 5).reshape(16 * c, -1)
    return windows @ matrix


def _up_product(x: Array, kernel: Array) -> Array:
    n, h, w, c = x.shape
    features = kernel.shape[-1]
    matrix = kernel.reshape(2, 2, 2, 2, c, features).transpose(4, 0, 2, 1, 3, 5).reshape(c, -1)
    spread = (x @ matrix).reshape(n, h, w, 2, 2, 4 * features)
    total = sum(
        jnp.pad(spread[:, :, :, a, b], ((0, 0), (a, 1 - a), (b, 1 - b), (0, 0))) for a in (0, 1) for b in (0, 1)
    )
    return _from_depth(jnp.asarray(total))[:, 1:-1, 1:-1]


def _to_depth(x: Array) -> Array:
    n, h, w, c = x.shape
    return x.reshape(n, h // 2, 2, w // 2, 2, c).transpose(0, 1, 3, 2, 4, 5).reshape(n, h // 2, w // 2, 4 * c)


def _from_depth(x: Array) -> Array:
    n, h, w, c = x.shape
    return x.reshape(n, h, w, 2, 2, c // 4).transpose(0, 1, 3, 2, 4, 5).reshape(n, 2 * h, 2 * w, c // 4)


class Down(nn.Module):
    """`down` with a kernel and, where wanted, a bias (feature,): halves height and width."""

    features: int
    use_bias: bool = True
    dtype: Any = jnp.float32
    backend: Backend = "auto"

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"]
    ) -> Float[Array, "batch halfheight halfwidth feature"]:
        """Maps (batch, height, width, channel) to (batch, halfheight, halfwidth, feature)."""
        kernel = _kernel(self, x.shape[-1], self.features).astype(self.dtype)
        return _biased(self, down(x.astype(self.dtype), kernel, self.backend))


class Up(nn.Module):
    """`up` with a kernel and, where wanted, a bias (feature,): doubles height and width."""

    features: int
    use_bias: bool = True
    dtype: Any = jnp.float32
    backend: Backend = "auto"

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"]
    ) -> Float[Array, "batch twiceheight twicewidth feature"]:
        """Maps (batch, height, width, channel) to (batch, twiceheight, twicewidth, feature)."""
        kernel = _kernel(self, x.shape[-1], self.features).astype(self.dtype)
        return _biased(self, up(x.astype(self.dtype), kernel, self.backend))


class Patch(nn.Module):
    """`patch` with a kernel and, where wanted, a bias (feature,): one pixel less each way."""

    features: int
    use_bias: bool = True
    dtype: Any = jnp.float32
    backend: Backend = "auto"

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"]
    ) -> Float[Array, "batch lessheight lesswidth feature"]:
        """Maps (batch, height, width, channel) to (batch, lessheight, lesswidth, feature)."""
        kernel = _kernel(self, x.shape[-1], self.features).astype(self.dtype)
        return _biased(self, patch(x.astype(self.dtype), kernel, self.backend))


def _kernel(module: nn.Module, channels: int, features: int) -> Array:
    # pix2pix draws weights from N(0, 0.02²), and Adam's step suits that size.
    return module.param("kernel", nn.initializers.normal(0.02), (4, 4, channels, features))


def _biased(module: Down | Up | Patch, y: Array) -> Array:
    if not module.use_bias:
        return y
    return y + module.param("bias", nn.initializers.zeros, (module.features,)).astype(module.dtype)
