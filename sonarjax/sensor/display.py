"""The display law: from energy to what a device stores, by gain, a logarithm or a root, and eight bits."""

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
    """Turn energy into grey values.

    Blends two curves that meet at white: a logarithm, and a power law. ARIS files store the logarithm over 80 dB (see
    `io.aris`). The power law with exponent 0.25 is about what an Oculus stores, as measured on real pings. No source
    for the blend: a model of ours that covers the devices in between.

    Args:
        energy: Energy (...) relative to the floor on the beam axis.
        gain: How far an energy of 1 lies below white [dB].
        log_share: Weight of the logarithm [1]; the power law has the rest.
        dynamic_range: Range of the logarithm from black to white [dB].
        exponent: Power of energy [1]: 0.5 is amplitude, 0.25 its square root.
        saturation: Bends the power law g towards white, to arctan(s·g)/arctan(s), as viewers do that must show a glint
            beside a floor. 0 bends nothing.
        black: Share of the grey scale that is shown as 0 [1].

    Returns:
        Grey values (...) from 0 to 1.
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
    """Round grey values to the nearest of the 256 values n/255. The derivative is defined as 1.

    ARIS, DIDSON and Oculus files store eight bits (see `io`). No source for the derivative: a choice of ours.

    Args:
        image: Grey values (...) from 0 to 1.

    Returns:
        Rounded grey values (...).
    """
    return jnp.round(255 * image) / 255


@quantise.defjvp
def _quantise_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    return quantise(*primals), tangents[0]
