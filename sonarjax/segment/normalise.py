"""Batch normalisation as pix2pix has it: flax's, with pix2pix's constants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array

EPSILON = 1e-5
MOMENTUM = 0.9
"""Share of the old running statistics that a training step keeps."""


def batch_norm(name: str, *, train: bool, dtype: Any = jnp.float32) -> nn.BatchNorm:
    """Normalise each channel over batch, height and width: by the batch in training, else by running statistics.

    Statistics are float32 at any `dtype` of map, and run over the whole batch also where it is spread over devices.
    """
    return nn.BatchNorm(
        use_running_average=not train, momentum=MOMENTUM, epsilon=EPSILON, dtype=dtype, scale_init=_scales, name=name
    )


def _scales(key: Array, shape: Sequence[int], dtype: Any = jnp.float32) -> Array:
    """Scales about one, N(1, 0.02²), where pix2pix starts."""
    return 1.0 + 0.02 * jax.random.normal(key, shape, dtype)
