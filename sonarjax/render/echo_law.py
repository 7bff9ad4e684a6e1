"""How a device stores an echo as a grey value: a power of the energy, of the object over the floor and the noise."""

from __future__ import annotations

from jaxtyping import Array, Float

from sonarjax.records import record
from sonarjax.render.energy import floor_angle
from sonarjax.sonar import Sonar


@record
class EchoLaw:
    """How a device stores an echo: what decides its brightness relative to floor and shadow."""

    gain: Float[Array, "*batch"]
    """Ratio of the object's backscatter to the floor's [1]."""
    noise: Float[Array, "*batch"]
    """Ratio of the energy in a shadow to the floor's [1]."""
    exponent: Float[Array, "*batch"]
    """Power of energy that is stored [1]; a small power stands for a logarithm."""


def stored_echo(
    echo: Float[Array, "range beam"],
    shadow: Float[Array, "range beam"],
    ranges: Float[Array, "range"],
    sonar: Sonar,
    law: EchoLaw,
) -> Float[Array, "range beam"]:
    """Compute what a device stores of an object on a bare floor, as the difference from the floor's grey.

    Energies are relative to that of the bare floor, which fills `floor_angle` of elevation in a range bin (eq. 2's
    spreading is the same for both). No source for the law: devices store amplitudes, energies or decibels, and a power
    comes near each of them.

    Args:
        echo: Elevation (range, beam) [rad] that first hits of the object fill, as in `EchoLayers`.
        shadow: Shadow's share of each pixel's floor (range, beam), as in `EchoLayers`.
        ranges: Slant range of each row (range,) [m].
        sonar: Gives the height and the length of a range bin.
        law: How the device stores an echo.

    Returns:
        Difference (range, beam) from the grey of the bare floor [1].
    """
    energy = law.gain * echo / floor_angle(ranges, sonar)[:, None]
    return (energy + 1 - shadow + law.noise) ** law.exponent - (1 + law.noise) ** law.exponent
