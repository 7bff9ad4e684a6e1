"""The discriminator of pix2pix (§2.2): four convolutions that classify patches of a semantic map as true or
generated.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float

from sonarjax.segment.layers import Backend, Down, Patch
from sonarjax.segment.normalise import batch_norm


class Discriminator(nn.Module):
    """Three convolutions of stride 2 and one of stride 1: a logit for every 8 × 8 pixels, each from 46 × 46 pixels."""

    width: int = 64
    """Channels of the first layer; the second and third have two and four times as many."""
    dtype: Any = jnp.float32
    """Type of the maps; parameters stay float32."""
    backend: Backend = "auto"
    """How the layers are computed, see `layers`."""

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width 1"], y: Float[Array, "batch height width 1"]
    ) -> Float[Array, "batch patchrow patchcolumn 1"]:
        """Logits (batch, patchrow, patchcolumn, 1), positive for true maps.

        Normalisation always uses the batch's own statistics, because the discriminator is used in training only.

        Args:
            x: Images (batch, height, width, 1) in [−1, 1].
            y: Their semantic maps (batch, height, width, 1) in [−1, 1].
        """
        maps = jnp.concatenate([x, y], -1).astype(self.dtype)
        for n in (1, 2, 3):
            maps = Down(self.width * 2 ** (n - 1), n == 1, 4, self.dtype, self.backend, name=f"down{n}")(maps)
            maps = maps if n == 1 else batch_norm(f"norm{n}", train=True, dtype=self.dtype)(maps)
            maps = nn.leaky_relu(maps, 0.2)
        return Patch(1, True, self.dtype, self.backend, name="patch")(maps).astype(jnp.float32)
