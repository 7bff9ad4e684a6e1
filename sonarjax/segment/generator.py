"""The generator of pix2pix (§2.2): a U-Net of 15 layers in which layer 16 − n also gets the output of layer n."""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.inputs import Inputs, network_input
from sonarjax.segment.layers import Backend, Down, Up
from sonarjax.segment.normalise import batch_norm

Head = Literal["tanh", "classes"]
STRIDE = 128
"""Height and width of an image are multiples of this: seven layers halve it."""
DROPOUT_LAYERS = 3
DROPOUT = 0.5


class Generator(nn.Module):
    """Seven convolutions of stride 2 down to 1 × 1, a bottleneck layer, and seven transposed convolutions back up.

    Dropout in the first three layers of the way up is the random input z of the paper. Give `rngs={"dropout": key}` to
    draw it; without it the answer is the mean. Layers 7 and 8 have one pixel for each crop, hence no normalisation.
    Layers 7 and 9 have only the 2 × 2 taps that reach that pixel: the other taps of a 4 × 4 kernel would see padding,
    never learn, and disturb larger images.
    """

    width: int = 64
    """Channels of the first layer; the deeper ones have `multipliers` times as many."""
    head: Head = "tanh"
    """`tanh`: one grey channel in [−1, 1]. `classes`: three logits in the order of the labels."""
    skips: bool = True
    """Give the output of layer n to layer 16 − n; False for the ablation."""
    multipliers: tuple[int, ...] = (1, 2, 4, 8, 8, 8, 8)
    """Channels of the seven layers on the way down, as multiples of `width`."""
    dtype: Any = jnp.float32
    """Type of the maps; bfloat16 is faster on GPUs. Parameters and statistics stay float32."""
    backend: Backend = "auto"
    """How the layers are computed, see `layers`."""
    inputs: Inputs = "grey"
    """What the first layer is given of an image, see `inputs`."""

    @nn.compact
    def __call__(
        self, x: Float[Array, "batch height width 1"], train: bool = False
    ) -> Float[Array, "batch height width output"]:
        """Turn images (batch, height, width, 1) in [−1, 1] into maps (batch, height, width, output).

        Args:
            x: Images; height and width are multiples of 128.
            train: Normalise by the batch's own statistics, and update the running ones.

        Returns:
            Maps with one output channel, or three, as `head` says.

        Raises:
            SonarjaxError: Height or width is not a multiple of 128.
        """
        if x.shape[1] % STRIDE or x.shape[2] % STRIDE:
            raise SonarjaxError(f"image: expected height and width to be multiples of {STRIDE}, got {x.shape[1:3]}")
        layers = self._way_down(network_input(x, self.inputs), train)
        bottleneck = nn.Dense(layers[-1].shape[-1], dtype=self.dtype, kernel_init=nn.initializers.normal(0.02))
        y = self._way_up(nn.relu(bottleneck(layers[-1])), layers, train).astype(jnp.float32)
        return jnp.tanh(y) if self.head == "tanh" else y

    def _way_down(self, x: Array, train: bool) -> list[Array]:
        """Outputs of layers 1 to 7."""
        layers: list[Array] = []
        for n, multiplier in enumerate(self.multipliers, start=1):
            plain = n in (1, 7)
            size = 2 if n == 7 else 4
            x = Down(self.width * multiplier, plain, size, self.dtype, self.backend, name=f"down{n}")(x)
            x = x if plain else batch_norm(f"norm{n}", train=train, dtype=self.dtype)(x)
            x = nn.leaky_relu(x, 0.2)
            layers.append(x)
        return layers

    def _way_up(self, x: Array, layers: list[Array], train: bool) -> Array:
        """Output of layer 15, before its nonlinearity, given that of layer 8."""
        output = 1 if self.head == "tanh" else 3
        for n in range(9, 16):
            copied = (layers[15 - n],) if self.skips else ()  # layer 16 − n, counted from 1
            features = output if n == 15 else self.width * self.multipliers[14 - n]
            x = Up(features, n == 15, 2 if n == 9 else 4, self.dtype, self.backend, name=f"up{n}")(x, *copied)
            if n == 15:
                break
            x = batch_norm(f"norm{n}", train=train, dtype=self.dtype)(x)
            if n < 9 + DROPOUT_LAYERS:
                x = nn.Dropout(DROPOUT, deterministic=not self.has_rng("dropout"))(x)
            x = nn.relu(x)
        return x


def to_grey(output: Float[Array, "batch height width output"]) -> Float[Array, "batch height width 1"]:
    """Turn a generator's output (batch, height, width, output) into grey (batch, height, width, 1) in [−1, 1].

    A single channel is grey already. Three logits give the probability of highlight minus that of shadow.
    """
    if output.shape[-1] == 1:
        return output
    probability = jax.nn.softmax(output, -1)
    return probability[..., 1:2] - probability[..., 2:3]
