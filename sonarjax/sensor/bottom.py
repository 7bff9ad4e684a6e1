"""How bright the bottom is from place to place: ripples, and slow changes over the frame.

All functions give factors (range, beam) for the energy of the floor, around 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.sonar import Sonar

WIDE_PATCHES = (3, 3)
"""Number of independent values, along range and beams, between which slow changes are interpolated."""


def ripple_brightness(
    sonar: Sonar, ranges: Float[Array, "range"], depth: Any, wavelength: Any, direction: Any
) -> Float[Array, "range beam"]:
    """Return the brightness of a rippled floor: 1 + depth·sin(phase).

    Slopes that face the sonar are brighter. To first order, a small slope changes Lambert's law in proportion (Urick,
    Principles of Underwater Sound, 1983, ch. 8). A single wave is a model of ours. `direction` turns the pattern but
    does not change its depth: crests that run along the line of sight tilt the floor only sideways, and so should
    hardly show, but are drawn as deep as those across it.

    The azimuth of a beam stands for the bearing on the floor, which is larger under a tilted sonar. Ripples with crests
    across the beam axis have the wavelength asked for. With crests along it they are longer on the floor, by a factor
    of cos(tilt) + sin(tilt)·height/ground range near the axis: 1/cos(tilt) where the beam axis meets the floor.

    Args:
        sonar: Gives the height and the beams.
        ranges: Slant ranges (range,) [m].
        depth: How much brighter the brightest slopes are [1], below 1.
        wavelength: Distance between crests [m].
        direction: Direction on the floor at right angles to the crests [rad].

    Returns:
        Factor on the energy of the floor (range, beam).
    """
    square = ranges**2 - jnp.asarray(sonar.height, jnp.float32) ** 2
    ground = jnp.sqrt(jnp.maximum(square, 1e-6))  # not 0, where the root has no derivative
    along = jnp.cos(jnp.asarray(sonar.azimuth, jnp.float32) - jnp.asarray(direction, jnp.float32))
    phase = 2 * jnp.pi * ground[:, None] * along / jnp.maximum(jnp.asarray(wavelength, jnp.float32), 1e-2)
    return 1 + jnp.asarray(depth, jnp.float32) * jnp.sin(phase)


def slow_brightness(shape: tuple[int, int], std_db: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Draw a brightness that changes slowly over the frame, normal in dB.

    No source: a model of ours for uneven insonification and a bottom of several kinds. The median is 1, so
    the mean of the energy is a little larger: 1.1 at 2 dB.

    Args:
        shape: Shape (range, beam) of the image.
        std_db: Standard deviation [dB] of the values between which the brightness is interpolated. That of single
            pixels is 0.5 to 1.4 times as large, depending on where they lie, and 0.9 times over the whole frame.
        key: Source of the random numbers.

    Returns:
        Factor on the energy (range, beam).
    """
    coarse = jax.random.normal(key, WIDE_PATCHES)
    smooth = jax.image.resize(coarse, shape, "cubic")
    return 10 ** (jnp.asarray(std_db, jnp.float32) * smooth / 10)
