"""How bright the bottom is from place to place: ripples, and slow changes over the frame.

Factors (range, beam) of the floor's energy with a mean near 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.sonar import Sonar

WIDE_PATCHES = (3, 3)
"""Independent values that slow changes are interpolated from, along range and beams."""


def ripple_brightness(
    sonar: Sonar, ranges: Float[Array, "range"], depth: Any, wavelength: Any, direction: Any
) -> Float[Array, "range beam"]:
    """Brightness (range, beam) of a rippled floor: 1 + depth·sin(phase), for slant `ranges` (range,) [m].

    Slopes that look at the sonar are brighter by `depth` [1], below 1; crests are `wavelength` [m] apart and run square
    to `direction` [rad] on the floor. To first order a small slope changes Lambert's law in proportion (Urick,
    Principles of Underwater Sound, 1983, ch. 8); a single wave is a model of ours.
    """
    ground = jnp.sqrt(jnp.maximum(ranges**2 - jnp.asarray(sonar.height, jnp.float32) ** 2, 0.0))
    along = jnp.cos(jnp.asarray(sonar.azimuth, jnp.float32) - jnp.asarray(direction, jnp.float32))
    phase = 2 * jnp.pi * ground[:, None] * along / jnp.maximum(jnp.asarray(wavelength, jnp.float32), 1e-2)
    return 1 + jnp.asarray(depth, jnp.float32) * jnp.sin(phase)


def slow_brightness(shape: tuple[int, int], std_db: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Brightness (range, beam) that changes slowly over the frame, normal in dB with `std_db` [dB].

    No source: a model of ours for uneven insonification and a bottom of several kinds.
    """
    coarse = jax.random.normal(key, WIDE_PATCHES)
    smooth = jax.image.resize(coarse, shape, "cubic")
    return 10 ** (jnp.asarray(std_db, jnp.float32) * smooth / 10)
