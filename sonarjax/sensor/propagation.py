"""What range does to an echo: absorption, the device's time-varied gain, the elevation pattern, the pulse, the noise.

All functions take slant ranges [m] or an image (range, beam) of mean energy, and return factors or an image.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.render import floor_angle
from sonarjax.sonar import Sonar

MAX_PULSE_BINS = 9
"""Longest pulse over which `pulse_blur` spreads an echo [range bins]."""
SKIRT = math.radians(3.0)
"""How far beyond the aperture an echo still counts [rad]: at 12 dB per degree it is 36 dB down there."""

ARCSIN = (
    1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046, 0.0308918810, -0.0170881256, 0.0066700901, -0.0012624911,
)  # fmt: skip


def fresh_absorption(frequency: Any, temperature: Any) -> Float[Array, "*batch"]:
    """Return the one-way absorption of sound in fresh water.

    The viscous term A₃f² of Francois and Garrison (J. Acoust. Soc. Am. 72, 1982, part II), the only one without salts.

    Args:
        frequency: Acoustic frequency (...) [Hz].
        temperature: Temperature of the water (...) [deg C], at most 20 °C.

    Returns:
        Absorption (...) [dB/m].
    """
    t = jnp.asarray(temperature, jnp.float32)
    a3 = 4.937e-4 + t * (-2.59e-5 + t * (9.11e-7 - 1.50e-8 * t))
    return a3 * jnp.square(jnp.asarray(frequency, jnp.float32) / 1e3) / 1e3


def absorption_loss(ranges: Float[Array, "*batch"], absorption: Any) -> Float[Array, "*batch"]:
    """Return the share of an echo's energy that is left after two-way absorption.

    Urick, Principles of Underwater Sound (1983), ch. 5.

    Args:
        ranges: Slant ranges (...) [m].
        absorption: One-way absorption [dB/m].

    Returns:
        Share of the energy (...).
    """
    return 10 ** (-0.2 * jnp.asarray(absorption, jnp.float32) * ranges)


def time_varied_gain(
    ranges: Float[Array, "*batch"], reference: Any, exponent: Any, absorption: Any
) -> Float[Array, "*batch"]:
    """Return the gain by which a device makes up for spreading and absorption.

    It is (r/reference)^exponent, divided by the share of the energy that two-way absorption between `reference` and r
    leaves. An exponent of 4 is '40 log r', for points. An exponent of 3 is '30 log r', for surfaces, whose echoing area
    grows with range (Urick, 1983, ch. 8).

    Args:
        ranges: Slant ranges (...) [m].
        reference: Slant range at which the gain is 1 [m].
        exponent: Exponent of range [1].
        absorption: One-way absorption that is compensated, on both ways [dB/m].

    Returns:
        Factor on the energy of an echo (...).
    """
    spread = (ranges / reference) ** jnp.asarray(exponent, jnp.float32)
    return spread / absorption_loss(ranges - reference, absorption)


def elevation_gain(offset: Float[Array, "*batch"], aperture: Any, skirt: Any) -> Float[Array, "*batch"]:
    """Return the two-way gain at an angle above or below the beam axis.

    It is flat, then −3 dB at half the aperture, and falls by `skirt` beyond. No source for the curve: a logistic curve
    in dB, a model of ours for a lens, which has a flat top and steep skirts instead of a line array's sinc². Skirts of
    10 to 14 are those of a public fit to an ARIS 3000, whose author is not on record.

    Args:
        offset: Elevation from the beam axis (...) [rad].
        aperture: Full vertical width of the beam [rad].
        skirt: How steeply the gain falls outside the aperture [dB per degree].

    Returns:
        Factor on the energy (...).
    """
    beyond = jnp.degrees(jnp.abs(offset) - jnp.asarray(aperture, jnp.float32) / 2)
    return 1 / (1 + 10 ** jnp.clip(jnp.asarray(skirt, jnp.float32) * beyond / 10, -20.0, 20.0))


def with_skirts(sonar: Sonar) -> Sonar:
    """Widen the aperture of a sonar by `SKIRT` above and below, but not past straight down.

    `observe_scene` renders the widened sonar before it applies `elevation_gain`: a template ends sharply at the
    aperture, but an image fades out there. No source: a choice of ours.

    Args:
        sonar: The sonar with its own aperture.

    Returns:
        The sonar with the wider aperture.
    """
    aperture = jnp.asarray(sonar.elevation_aperture, jnp.float32)
    room = jnp.pi - 2 * jnp.asarray(sonar.tilt, jnp.float32)  # beyond it the floor comes nearer again
    return sonar.replace(elevation_aperture=jnp.minimum(aperture + 2 * SKIRT, jnp.maximum(room, aperture)))


def floor_elevation(sonar: Sonar) -> Float[Array, "range beam"]:
    """Return the elevation of the floor that each pixel shows.

    From r·(n₃ sin φ + (n₁ cos θ + n₂ sin θ) cos φ) = −height, where n is the ground's upward direction in the sonar
    frame: (−sin T, cos T sin R, cos T cos R) for a tilt T and a roll R. Straight down where the range is less than the
    height. No source: plane geometry in the package's frames.

    Args:
        sonar: Gives height, tilt, roll, beams and range bins.

    Returns:
        Elevation in the sonar frame (range, beam) [rad].
    """
    tilt, roll = (jnp.asarray(v, jnp.float32) for v in (sonar.tilt, sonar.roll))
    azimuth = jnp.asarray(sonar.azimuth)
    upward = jnp.cos(tilt) * jnp.cos(roll)
    forward = jnp.cos(azimuth) * jnp.sin(tilt) - jnp.sin(azimuth) * (jnp.cos(tilt) * jnp.sin(roll))
    reach = jnp.sqrt(upward**2 + forward**2)
    down = sonar.height / (range_middles(sonar)[:, None] * reach)
    return jnp.arctan2(forward, upward) - _arcsin(jnp.clip(down, 0.0, 1.0 - 1e-6))


def _arcsin(x: Array) -> Array:
    """arcsin of 0 ≤ x < 1 to 2e-8 (Abramowitz and Stegun, 4.4.46). XLA's own takes six times as long on a CPU."""
    series = jnp.full_like(x, ARCSIN[-1])
    for coefficient in ARCSIN[-2::-1]:
        series = series * x + coefficient
    return math.pi / 2 - jnp.sqrt(1 - x) * series


def range_middles(sonar: Sonar) -> Float[Array, "range"]:
    """Return the slant range of the middle of each range bin. No source: the definition of the bins.

    Args:
        sonar: Gives the range bins.

    Returns:
        Slant ranges (range,) [m].
    """
    return sonar.range_min + sonar.range_bin * (jnp.arange(sonar.n_ranges, dtype=jnp.float32) + 0.5)


def reference_range(sonar: Sonar) -> Float[Array, ""]:
    """Return the slant range at which the beam axis meets the floor, limited to between 1.05 and 6 heights.

    It depends on the sonar's height and tilt only, not on the window, so a crop of a frame is processed as the frame
    is. No source: a choice of ours.

    Args:
        sonar: Gives height and tilt.

    Returns:
        Slant range [m].
    """
    down = jnp.sin(jnp.clip(jnp.asarray(sonar.tilt, jnp.float32), 1 / 6, math.asin(1 / 1.05)))
    return sonar.height / down


def reference_energy(sonar: Sonar) -> Float[Array, ""]:
    """Return the energy of a range bin of bare floor at the reference range, as the renderer counts it (eq. 2, k = 1).

    Args:
        sonar: Gives height, tilt, range bins and the exponents and absorption of eq. 2.

    Returns:
        Energy [rad/m²].
    """
    r = reference_range(sonar)
    absorbed = absorption_loss(r, sonar.absorption) * (sonar.height / r) ** jnp.asarray(sonar.lambert, jnp.float32)
    return floor_angle(r, sonar) * r ** (-jnp.asarray(sonar.spreading_exponent, jnp.float32)) * absorbed


def pulse_blur(image: Float[Array, "range beam"], pulse_bins: Any) -> Float[Array, "range beam"]:
    """Spread energy evenly over the length of a pulse.

    At any moment a pulse of duration τ echoes from cτ/2 of range (Urick, 1983, ch. 8); its envelope is taken as a box.
    The weights sum to one. Energy from beyond the window is taken to equal that of the outermost bins.

    Args:
        image: Energy (range, beam).
        pulse_bins: Length of the pulse, 1 to 9 [range bins]; a pulse of one bin changes nothing.

    Returns:
        Blurred energy (range, beam).
    """
    half = MAX_PULSE_BINS // 2
    length = jnp.clip(jnp.asarray(pulse_bins, jnp.float32), 1.0, float(MAX_PULSE_BINS))
    weights = jnp.clip(0.5 + length / 2 - jnp.abs(jnp.arange(-half, half + 1)), 0.0, 1.0) / length
    rows = image.shape[0]
    # Without the barrier XLA's CPU compiler computes `image` anew for each of the shifts.
    padded = jax.lax.optimization_barrier(jnp.pad(image, ((half, half), (0, 0)), mode="edge"))
    blurred = weights[0] * padded[:rows]
    for k in range(1, MAX_PULSE_BINS):
        blurred += weights[k] * padded[k : k + rows]
    return blurred


def noise_floor(ranges: Float[Array, "*batch"], level: Any, range_max: Any) -> Float[Array, "*batch"]:
    """Return the mean energy of the receiver's noise after its gain: level·(r/range_max)².

    The noise in the sonar equation does not depend on range (Urick, 1983, ch. 2); a gain of 20 log r makes it grow so.
    No source for that gain: a model of ours, independent of the time-varied gain of the echoes.

    Args:
        ranges: Slant ranges (...) [m].
        level: Energy of the noise at `range_max`.
        range_max: Slant range at which the noise has this energy [m].

    Returns:
        Energy of the noise (...), in the unit of `level`.
    """
    return level * jnp.square(ranges / range_max)


@full_precision
def late_reverberation(
    image: Float[Array, "range beam"], share: Any, length: Any, range_bin: Any
) -> Float[Array, "range beam"]:
    """Return the energy that arrives late by way of floor, walls and object: an exponential tail along range.

    It fills shadows from their near end. Reverberation decays exponentially in a closed basin (Kuttruff, Room
    Acoustics, 2009, ch. 5); one share and one length for a frame are models of ours.

    Args:
        image: Energy that arrives first (range, beam).
        share: Share of each bin's energy that arrives again later [1].
        length: Decay length [m].
        range_bin: Length of a range bin [m].

    Returns:
        Energy that arrives late (range, beam), without that of `image`.
    """
    rows = image.shape[0]
    step = jnp.asarray(range_bin, jnp.float32) / jnp.maximum(jnp.asarray(length, jnp.float32), 1e-3)
    step = jnp.minimum(step, 80.0)  # exp of more is infinite; all of it arrives in the next bin anyway
    behind = jnp.arange(rows)[:, None] - jnp.arange(rows)[None, :]
    tail = jnp.where(behind > 0, jnp.exp(-step * jnp.maximum(behind, 0)), 0.0) * (jnp.exp(step) - 1)
    return jnp.asarray(share, jnp.float32) * (tail @ image)
