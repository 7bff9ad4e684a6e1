"""What a network is given of a grey image: the grey itself, or numbers that a display law does not change.

A display law is a monotone curve from energy to grey. It differs between devices and between settings of their gain.
The rank of a pixel among all pixels of its image is the same under every such curve.
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Inputs = Literal["grey", "ranks"]
CHANNELS: dict[Inputs, int] = {"grey": 1, "ranks": 2}
"""Number of channels of each kind of input."""
LEVELS = 256
"""Number of levels of the histogram, which is linear between them; devices store as many."""
SPREAD = 2.0
"""Deviation, in standard deviations, at which the second channel begins to saturate."""


def network_input(
    x: Float[Array, "batch height width 1"], inputs: Inputs
) -> Float[Array, "batch height width channel"]:
    """Channels (batch, height, width, channel) in [−1, 1] from images (batch, height, width, 1) in [−1, 1].

    `grey` is the image itself. `ranks` gives the rank of each pixel in its image (histogram equalisation: Gonzalez and
    Woods, Digital Image Processing, 2018, ch. 3), and its deviation from the image's mean in standard deviations,
    saturated. Both are differentiable, because the histogram counts with linear weights.
    """
    if inputs == "grey":
        return x
    image = x[..., 0]
    mean, std = image.mean((1, 2), keepdims=True), image.std((1, 2), keepdims=True)
    deviation = jnp.tanh((image - mean) / (SPREAD * (std + 1e-3)))
    return jnp.stack([2 * jax.vmap(ranks)(image) - 1, deviation], axis=-1)


def ranks(image: Float[Array, "height width"]) -> Float[Array, "height width"]:
    """Share of an image's (height, width) pixels that are darker than each pixel, in [0, 1]; the image is in [−1, 1].

    Pixels of equal value count half, so an even image gives 0.5 everywhere.
    """
    place = jnp.clip((image + 1) / 2, 0.0, 1.0) * (LEVELS - 1)
    low = jnp.minimum(jax.lax.stop_gradient(place).astype(jnp.int32), LEVELS - 2)
    part = place - low
    histogram = jnp.zeros(LEVELS).at[low].add(1 - part).at[low + 1].add(part) / image.size
    below = jnp.cumsum(histogram) - histogram / 2
    return (1 - part) * below[low] + part * below[low + 1]
