"""From energy to what a device stores: gain, logarithm or root, eight bits."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

TINY = 1e-9


def compress(
    energy: Float[Array, "*batch"], gain: Any, log_share: Any, dynamic_range: Any, exponent: Any,
    saturation: Any = 0.0, black: Any = 0.0,
) -> Float[Array, "*batch"]:  # fmt: skip
    """Grey value (...) in [0, 1] of `energy` (...), whose 1 lies `gain` [dB] below white.

    A blend of two curves that meet at white: the logarithm over `dynamic_range` [dB] with the weight `log_share`, and
    energy^`exponent` (0.5: amplitude; 0.25: its square root, about what an Oculus stores). The logarithm is how
    ARIS files store it, over 80 dB (see `io.aris`); the square root was measured on real Oculus pings. No source for
    the blend: a model of ours, which makes one family of such devices. `saturation` s bends the power law towards
    white, arctan(s·g)/arctan(s), as viewers do that must show a glint beside a floor; 0 is none. What lies below
    `black` of the whole scale is shown as 0.
    """
    nepers = jnp.log(jnp.maximum(energy, TINY)) - jnp.asarray(gain, jnp.float32) * (jnp.log(10.0) / 10)
    logarithm = 1 + nepers * (10 / jnp.log(10.0)) / dynamic_range
    root = jnp.exp(jnp.asarray(exponent, jnp.float32) * nepers)
    bend = jnp.maximum(jnp.asarray(saturation, jnp.float32), 1e-3)
    root = jnp.arctan(bend * root) / jnp.arctan(bend)
    log_share, black = jnp.asarray(log_share, jnp.float32), jnp.asarray(black, jnp.float32)
    grey = log_share * jnp.maximum(logarithm, 0.0) + (1 - log_share) * root
    return jnp.clip((grey - black) / (1 - black), 0.0, 1.0)


@jax.custom_jvp
def quantise(image: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """`image` (...) in [0, 1] as the nearest of the 256 values n/255; its derivative is taken to be 1.

    Eight bits are what ARIS, DIDSON and Oculus files store (see `io`). No source for the derivative: a choice of ours.
    """
    return jnp.round(255 * image) / 255


@quantise.defjvp
def _quantise_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    return quantise(*primals), tangents[0]
