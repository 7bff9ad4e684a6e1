"""Stride-2 4 × 4 convolutions, down and up: plain functions with two backends, and flax modules that use them.

The backend `convolution` is `lax.conv_general_dilated`, for GPUs and TPUs. On CPUs XLA runs it slowly, its gradients
and the transposed convolution most of all. There the backend `product` computes the same layer as matrix products. Maps
are channels-last.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any, Literal

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import lax
from jaxtyping import Array, Float

from sonarjax.segment import products

Backend = Literal["auto", "convolution", "product"]
_LAYOUT = ("NHWC", "HWIO", "NHWC")


def down(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 channel feature"],
    backend: Backend = "auto",
) -> Float[Array, "batch halfheight halfwidth feature"]:
    """Convolve maps (batch, height, width, channel) with `kernel` (4, 4, channel, feature): stride 2, padding 1.

    Height and width are even. Both backends give the same numbers.

    Returns:
        Maps (batch, halfheight, halfwidth, feature).
    """
    if _use_product(backend):
        return products.down(x, kernel)
    return lax.conv_general_dilated(x, kernel, (2, 2), ((1, 1), (1, 1)), dimension_numbers=_LAYOUT)


def up(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 feature channel"],
    backend: Backend = "auto",
) -> Float[Array, "batch twiceheight twicewidth feature"]:
    """Transposed convolution of maps (batch, height, width, channel) with stride 2: each pixel spreads over 4 × 4
    pixels.

    `kernel` (4, 4, feature, channel) is that of the `down` whose transpose this is: out[2i + a − 1, 2j + b − 1] sums
    kernel[a, b] · x[i, j]. Both backends give the same numbers.

    Returns:
        Maps (batch, twiceheight, twicewidth, feature).
    """
    if _use_product(backend):
        return products.up(x, kernel)
    flipped = kernel[::-1, ::-1].transpose(0, 1, 3, 2)
    return lax.conv_general_dilated(
        x, flipped, (1, 1), ((2, 2), (2, 2)), lhs_dilation=(2, 2), dimension_numbers=_LAYOUT
    )


def down_two(
    x: Float[Array, "batch height width channel"], kernel: Float[Array, "2 2 channel feature"]
) -> Float[Array, "batch halfheight halfwidth feature"]:
    """Convolve maps (batch, height, width, channel) with `kernel` (2, 2, channel, feature): stride 2, no padding.

    On a 2 × 2 map it equals `down`, because the other twelve taps of a 4 × 4 kernel see only padding.

    Returns:
        Maps (batch, halfheight, halfwidth, feature).
    """
    n, h, w, c = x.shape
    blocks = x.reshape(n, h // 2, 2, w // 2, 2, c).transpose(0, 1, 3, 2, 4, 5).reshape(n, h // 2, w // 2, 4 * c)
    return blocks @ kernel.reshape(4 * c, -1)


def up_two(
    x: Float[Array, "batch height width channel"], kernel: Float[Array, "2 2 feature channel"]
) -> Float[Array, "batch twiceheight twicewidth feature"]:
    """Transpose of `down_two`, of maps (batch, height, width, channel), with the same kernel (2, 2, feature, channel).

    On a 1 × 1 map it equals `up`.

    Returns:
        Maps (batch, twiceheight, twicewidth, feature).
    """
    n, h, w, c = x.shape
    blocks = (x @ kernel.reshape(-1, c).T).reshape(n, h, w, 2, 2, -1)
    return blocks.transpose(0, 1, 3, 2, 4, 5).reshape(n, 2 * h, 2 * w, -1)


def patch(
    x: Float[Array, "batch height width channel"],
    kernel: Float[Array, "4 4 channel feature"],
    backend: Backend = "auto",
) -> Float[Array, "batch lessheight lesswidth feature"]:
    """Convolve maps (batch, height, width, channel) with `kernel` (4, 4, channel, feature): stride 1, padding 1.

    The backend `product` is fast only for few features.

    Returns:
        Maps (batch, lessheight, lesswidth, feature), one pixel smaller along each axis.
    """
    if not _use_product(backend):
        return lax.conv_general_dilated(x, kernel, (1, 1), ((1, 1), (1, 1)), dimension_numbers=_LAYOUT)
    n, h, w, c = x.shape
    features = kernel.shape[-1]
    # Compute the sixteen products of every pixel first, then sum shifted maps, which have few features.
    matrix = kernel.transpose(2, 0, 1, 3).reshape(c, -1)
    each = products.product(x.reshape(-1, c), matrix).reshape(n, h, w, 4, 4, features)
    each = jnp.pad(each, ((0, 0), (1, 1), (1, 1), (0, 0), (0, 0), (0, 0)))
    return jnp.asarray(sum(each[:, a : a + h - 1, b : b + w - 1, a, b] for a in range(4) for b in range(4)))


def _use_product(backend: Backend) -> bool:
    return jax.default_backend() == "cpu" if backend == "auto" else backend == "product"


class Down(nn.Module):
    """`down` (or `down_two` for size 2) with a kernel and an optional bias (feature,): halves height and width."""

    features: int
    """Channels of the output."""
    use_bias: bool = True
    """Add a bias. It has no effect before a normalisation, so it is left out there."""
    size: int = 4
    """Side of the kernel, 4 or 2 [pixels]."""
    dtype: Any = jnp.float32
    """Type of the maps; parameters stay float32."""
    backend: Backend = "auto"
    """How a kernel of 4 × 4 is computed, see `layers`."""

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"]
    ) -> Float[Array, "batch halfheight halfwidth feature"]:
        """Maps (batch, height, width, channel) to (batch, halfheight, halfwidth, feature)."""
        kernel = _kernel(self, self.size, x.shape[-1], self.features).astype(self.dtype)
        x = x.astype(self.dtype)
        return _biased(self, down(x, kernel, self.backend) if self.size == 4 else down_two(x, kernel))


class Up(nn.Module):
    """`up` (or `up_two` for size 2) with a kernel and an optional bias (feature,): doubles height and width."""

    features: int
    """Channels of the output."""
    use_bias: bool = True
    """Add a bias. It has no effect before a normalisation, so it is left out there."""
    size: int = 4
    """Side of the kernel, 4 or 2 [pixels]."""
    dtype: Any = jnp.float32
    """Type of the maps; parameters stay float32."""
    backend: Backend = "auto"
    """How a kernel of 4 × 4 is computed, see `layers`."""

    @nn.compact
    def __call__(
        self, *parts: Float[Array, "batch height width _"]
    ) -> Float[Array, "batch twiceheight twicewidth feature"]:
        """Maps (batch, height, width, channel), joined along channels, to (batch, twiceheight, twicewidth, feature)."""
        kernel = _kernel(self, self.size, self.features, sum(v.shape[-1] for v in parts)).astype(self.dtype)
        parts = tuple(v.astype(self.dtype) for v in parts)
        if self.features < products.THIN and self.size == 4:
            # The layer is linear. With few features, adding the outputs of its parts is cheaper than joining the parts.
            ends = list(accumulate(v.shape[-1] for v in parts))
            kernels = jnp.split(kernel, ends[:-1], -1)
            y = sum(up(v, k, self.backend) for v, k in zip(parts, kernels, strict=True))
            return _biased(self, jnp.asarray(y))
        x = jnp.concatenate(parts, -1)
        return _biased(self, up(x, kernel, self.backend) if self.size == 4 else up_two(x, kernel))


class Patch(nn.Module):
    """`patch` with a kernel and an optional bias (feature,): one pixel smaller along each axis."""

    features: int
    """Channels of the output."""
    use_bias: bool = True
    """Add a bias."""
    dtype: Any = jnp.float32
    """Type of the maps; parameters stay float32."""
    backend: Backend = "auto"
    """How the layer is computed, see `layers`."""

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"]
    ) -> Float[Array, "batch lessheight lesswidth feature"]:
        """Maps (batch, height, width, channel) to (batch, lessheight, lesswidth, feature)."""
        kernel = _kernel(self, 4, x.shape[-1], self.features).astype(self.dtype)
        return _biased(self, patch(x.astype(self.dtype), kernel, self.backend))


def _kernel(module: nn.Module, size: int, channels: int, features: int) -> Array:
    # As in pix2pix, whose step size for Adam suits weights drawn from N(0, 0.02²).
    return module.param("kernel", nn.initializers.normal(0.02), (size, size, channels, features))


def _biased(module: Down | Up | Patch, y: Array) -> Array:
    if not module.use_bias:
        return y
    return y + module.param("bias", nn.initializers.zeros, (module.features,)).astype(module.dtype)
