"""Batch normalisation of channels-last maps, with running statistics for inference."""

from __future__ import annotations

import jax.numpy as jnp
from flax import linen as nn
from jax import lax
from jaxtyping import Array, Float

EPSILON = 1e-5


class BatchNorm(nn.Module):
    """Bring each channel to mean `bias` and standard deviation `scale` (both (channel,)) over batch, height and width.

    The mean runs over the complete batch, even if it is spread over devices. Statistics are float32 whatever the type
    of the map.
    """

    running: bool = True
    """Keep running statistics in the collection `batch_stats`. If false, every call uses its own batch."""
    momentum: float = 0.9
    """Share of the old running statistics that is kept at each training step."""

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width channel"], train: bool
    ) -> Float[Array, "batch height width channel"]:
        """Normalise maps (batch, height, width, channel), by the batch's statistics if `train`, else by the
        running ones.
        """
        channels = x.shape[-1:]
        scale = self.param("scale", _scales, channels)
        bias = self.param("bias", nn.initializers.zeros, channels)
        if train or not self.running:
            mean, variance = _moments(x)
        if self.running:
            kept = self.variable("batch_stats", "mean", jnp.zeros, channels)
            kept_variance = self.variable("batch_stats", "variance", jnp.ones, channels)
            if not train:
                mean, variance = kept.value, kept_variance.value
            elif not self.is_initializing():
                count = x.size // x.shape[-1]
                unbiased = variance * (count / max(count - 1, 1))  # running statistics are applied to other pixels
                kept.value = self._moved(kept.value, mean)
                kept_variance.value = self._moved(kept_variance.value, unbiased)
        factor = scale * lax.rsqrt(variance + EPSILON)
        return x * factor.astype(x.dtype) + (bias - mean * factor).astype(x.dtype)

    def _moved(self, old: Array, new: Array) -> Array:
        return self.momentum * old + (1 - self.momentum) * lax.stop_gradient(new)


def _scales(key: Array, shape: tuple[int, ...]) -> Array:
    """Initial scales as in pix2pix: N(1, 0.02²)."""
    return 1.0 + nn.initializers.normal(0.02)(key, shape)


def _moments(x: Array) -> tuple[Array, Array]:
    wide = x.astype(jnp.float32)
    mean = wide.mean((0, 1, 2))
    return mean, jnp.maximum((wide * wide).mean((0, 1, 2)) - mean * mean, 0.0)
