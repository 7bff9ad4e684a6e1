"""The `SensorModel` pytree: what a device and its water add to a rendered frame, described by floats only."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from sonarjax.records import record

Scalar = Any


@record
class SensorModel:
    """How a device turns energy into an image. Every field is a float, or an array of one batch shape for `jax.vmap`.

    Choices are floats too, so that one compiled `observe` serves a family of devices. Energies are relative to the
    floor's energy on the beam axis. The defaults are `nominal()`: a DIDSON in the paper's tank.
    """

    # experiments/calibrate_sensor.py chose the defaults of object_gain, noise, speckle, looks, texture and
    # floor_bounce: frames of §4.1 then correlate with their own template by 0.572 ± 0.03 on average.
    object_gain: Scalar = 8.0
    """Backscatter of objects relative to the floor's [dB]; the renderer itself gives both the same."""
    floor_lambert: Scalar = 0.0
    """Exponent of cos(incidence) in the floor's echo [1], on top of the renderer's own; 1 for Lambert's law."""
    temperature: Scalar = 15.0
    """Temperature of the fresh water, which sets the absorption [deg C]."""
    tvg_absorption: Scalar = 0.9
    """Share of the absorption for which the time-varied gain compensates [1]."""
    tvg_exponent: Scalar = 3.7
    """n of the time-varied gain rⁿ of energy [1]: 4 is 40 log r, which makes a flat floor even; 3 is 30 log r."""
    beam_widening: Scalar = 1.0
    """−3 dB width of a beam [1], as a multiple of the sonar's `beam_width`, or of the beam spacing where that is 0."""
    beam_ways: Scalar = 2.0
    """1 if only the receiver forms beams, 2 if the transmitter does too [1]: side lobes at −13 or −27 dB."""
    elevation_skirt: Scalar = 12.0
    """How steeply the vertical pattern falls outside the aperture [dB per degree]."""
    pulse_bins: Scalar = 2.5
    """Pulse length [range bins], 1 to 9."""
    crosstalk: Scalar = 0.02
    """Leak between neighbouring beams of one firing group, as a share of the beam's own energy [1]."""
    crosstalk_period: Scalar = 8.0
    """Step in beam number within one firing group [beams]."""
    streak: Scalar = 0.004
    """Share of a glint's energy that is added to its entire range row [1]."""
    beam_gain_std: Scalar = 0.4
    """Standard deviation of the gains of the beams [dB]."""
    noise: Scalar = 0.05
    """Receiver noise after the gain, at the range where the beam axis meets the floor [energy of the floor there]."""
    speckle: Scalar = 1.0
    """Speckle contrast of one look [1]: standard deviation of intensity over its mean, up to 1 for fully developed
    speckle.

    Above 1 the values in dB spread by that factor: Weibull's law, with heavier tails than Rayleigh's.
    """
    looks: Scalar = 1.0
    """Number of independent looks that are averaged [1], 1 to 4."""
    texture: Scalar = 0.15
    """Variance of the bottom's mean energy from patch to patch [1]: 1/shape of the K-distribution."""
    speckle_beams: Scalar = 0.8
    """Width of the speckle's correlation in azimuth [mean beam spacings]."""
    speckle_bins: Scalar = 0.25
    """Correlation of intensity between neighbouring range bins [1], 0 to 0.5, where speckle is fully developed. At a
    lower contrast neighbours are more alike.
    """
    floor_bounce: Scalar = 0.3
    """Share of the energy that is left after a bounce on the floor [1]."""
    floor_path: Scalar = 1.0
    """1 if the sound bounces on the floor both ways, 0.5 if on one way only [1]."""
    surface_bounce: Scalar = 0.005
    """Share of the energy left after a bounce on the water surface [1], loss of the vertical pattern at that angle
    included.
    """
    surface_path: Scalar = 0.5
    """As `floor_path`, for the surface [1]."""
    water_depth: Scalar = 1.7
    """Height of the water surface above the floor [m]."""
    gain: Scalar = 20.0
    """How far below white the floor on the beam axis lies [dB]."""
    automatic_gain: Scalar = 0.2
    """0: the floor fixes the gain. 1: the frame's mean energy does, so that a glint darkens the rest [1]."""
    log_share: Scalar = 0.5
    """Weight of the logarithm in the stored value [1]; the power law has the rest."""
    dynamic_range: Scalar = 40.0
    """Range of the logarithm from black to white [dB]."""
    exponent: Scalar = 0.25
    """Power of energy in the power law [1]: 0.5 is amplitude, 0.25 its square root."""

    # Effects of some devices and places only. The nominal device has none of them.
    floor_bounce_once: Scalar = 0.0
    """Energy of echoes that bounce on the floor on one way only, relative to the direct echo [1]; in addition to
    `floor_bounce`.

    Sound meets the floor either on its way out or on its way back. This is the energy of both echoes together, which
    arrive in phase: up to four times that of one alone.
    """
    saturation: Scalar = 0.0
    """How far the power law bends towards white, as an arctangent of this steepness [1]."""
    black: Scalar = 0.0
    """Share of the grey scale that is shown as black [1]."""
    reverberation: Scalar = 0.0
    """Share of each bin's energy that arrives again later, by way of floor, walls and object [1]."""
    reverberation_length: Scalar = 0.2
    """Decay length of that late energy [m]."""
    group_gain_std: Scalar = 0.0
    """Standard deviation of the gains of the firing groups [dB]."""
    dim_share: Scalar = 0.0
    """Share of the beams that are dim [1]."""
    dim_loss: Scalar = 10.0
    """How much less a dim beam hears [dB]."""
    unevenness: Scalar = 0.0
    """Standard deviation of slow changes of brightness over the frame [dB]."""
    ripple: Scalar = 0.0
    """How much brighter the slopes of a rippled floor are that face the sonar [1], below 1."""
    ripple_wavelength: Scalar = 0.1
    """Distance between the crests of ripples [m]."""
    ripple_direction: Scalar = 0.0
    """Direction on the floor at right angles to the crests [rad]."""
    other_pings: Scalar = 0.0
    """Strength of another sonar's pings [energy of the floor on the beam axis]."""

    @classmethod
    def nominal(cls, severity: Scalar = 1.0) -> SensorModel:
        """Return the model of a DIDSON in a tank.

        `experiments/calibrate_sensor.py` fitted the constants, to the paper's correlations only.

        Args:
            severity: Factor on noise and artefacts [1]: 0 for none, 1 for frames as hard as the paper's, 2 for twice
                the noise.

        Returns:
            The model.
        """
        return cls().scaled(severity)

    @classmethod
    def draw(cls, *, key: jax.Array, severity: Scalar = 1.0) -> SensorModel:
        """Draw a device of the family around DIDSON, ARIS and Oculus: each field from `RANGES`.

        Multipath by way of floor and surface is present in the shares `FLOOR_HEARD` and `SURFACE_HEARD` of the draws
        only.

        Args:
            key: Source of the random numbers.
            severity: Factor on noise and artefacts [1], as in `scaled`.

        Returns:
            The model of the device.
        """
        *keys, which = jax.random.split(key, len(RANGES) + 1)
        drawn = {name: _drawn(*RANGES[name], key=part) for name, part in zip(RANGES, keys, strict=True)}
        heard = jax.random.uniform(which, (2,)) < jnp.array([FLOOR_HEARD, SURFACE_HEARD])
        drawn |= {
            name: jnp.where(heard[i], drawn[name], 0.0) for i, name in enumerate(("floor_bounce", "surface_bounce"))
        }
        drawn["crosstalk_period"] = jnp.round(drawn["crosstalk_period"])
        return cls(**drawn).scaled(severity)

    @classmethod
    def draw_wide(cls, *, key: jax.Array, severity: Scalar = 1.0) -> SensorModel:
        """Draw a device and a place from wider ranges, with rarer effects: the network trains on these.

        As `draw`, with the fields of `WIDE` drawn from there. Each field of `SELDOM` is present in its share of the
        draws only.

        Args:
            key: Source of the random numbers.
            severity: Factor on noise and artefacts [1], as in `scaled`.

        Returns:
            The model of the device and place.
        """
        own, keys, which = (jax.random.fold_in(key, n) for n in range(3))
        device = cls.draw(key=own)
        wider = {name: _drawn(*WIDE[name], key=jax.random.fold_in(keys, n)) for n, name in enumerate(WIDE)}
        wider["log_share"] = jnp.clip(wider["log_share"], 0.0, 1.0)
        for n, (name, share) in enumerate(SELDOM.items()):
            there = jax.random.uniform(jax.random.fold_in(which, n)) < share
            wider[name] = jnp.where(there, wider[name], getattr(cls, name))
        return replace(device, **wider).scaled(severity)

    def scaled(self, severity: Scalar) -> SensorModel:
        """Multiply the noise and artefacts of the device (the fields in `SCALED`) by a factor.

        No bounce becomes louder than the direct echo.

        Args:
            severity: The factor [1], as in `nominal`.

        Returns:
            The changed model.
        """
        scaled = {name: severity * getattr(self, name) for name in SCALED}
        for name in ("floor_bounce", "floor_bounce_once", "surface_bounce"):  # none is louder than the direct echo
            scaled[name] = jnp.minimum(scaled[name], 1.0)
        return replace(self, **scaled)


def _drawn(low: float, high: float, kind: str, *, key: jax.Array) -> jax.Array:
    """Draw a number from `low` to `high`, uniform in the number itself or, for "log", in its logarithm."""
    share = jax.random.uniform(key)
    return low * (high / low) ** share if kind == "log" else low + (high - low) * share


SCALED = ("crosstalk", "streak", "beam_gain_std", "noise", "speckle", "texture", "floor_bounce", "surface_bounce",
          "floor_bounce_once", "reverberation", "group_gain_std", "unevenness")  # fmt: skip
"""Fields that `severity` multiplies."""

FLOOR_HEARD, SURFACE_HEARD = 0.55, 0.2
"""Shares of the drawn devices that hear multipath by way of the floor, and of the water surface."""

RANGES: dict[str, tuple[float, float, str]] = {
    "object_gain": (2.0, 12.0, "even"),
    "floor_lambert": (0.0, 1.0, "even"),
    "temperature": (4.0, 20.0, "even"),
    "tvg_absorption": (0.0, 1.2, "even"),
    "tvg_exponent": (2.8, 4.4, "even"),
    "beam_widening": (0.7, 2.0, "even"),
    "beam_ways": (1.0, 2.0, "even"),
    "elevation_skirt": (8.0, 16.0, "even"),
    "pulse_bins": (1.0, 5.0, "even"),
    "crosstalk": (0.002, 0.2, "log"),
    "crosstalk_period": (3.0, 16.0, "even"),
    "streak": (0.0005, 0.02, "log"),
    "beam_gain_std": (0.1, 1.0, "even"),
    "noise": (0.005, 0.15, "log"),
    "speckle": (0.6, 1.2, "even"),
    "looks": (1.0, 2.5, "even"),
    "texture": (0.02, 0.4, "log"),
    "speckle_beams": (0.3, 1.3, "even"),
    "speckle_bins": (0.0, 0.45, "even"),
    "floor_bounce": (0.02, 0.6, "log"),
    "floor_path": (0.5, 1.0, "even"),
    "surface_bounce": (0.0005, 0.03, "log"),
    "surface_path": (0.5, 1.0, "even"),
    "water_depth": (1.2, 3.0, "even"),
    "gain": (12.0, 26.0, "even"),
    "automatic_gain": (0.0, 0.8, "even"),
    "log_share": (0.0, 1.0, "even"),
    "dynamic_range": (30.0, 80.0, "even"),
    "exponent": (0.2, 0.5, "even"),
}
"""Least and largest value of each field that `draw` gives at severity 1, and the kind: "even" in the field or in its
"log".
"""

WIDE: dict[str, tuple[float, float, str]] = {
    "object_gain": (0.0, 14.0, "even"),
    "tvg_exponent": (2.0, 5.0, "even"),
    "pulse_bins": (1.0, 7.0, "even"),
    "texture": (0.02, 0.8, "log"),
    "noise": (0.003, 0.2, "log"),
    "looks": (1.0, 3.0, "even"),
    "gain": (8.0, 29.0, "even"),
    "log_share": (-0.5, 1.5, "even"),  # clipped to [0, 1]: half of the devices have only one of the two laws
    "dynamic_range": (25.0, 90.0, "even"),
    "exponent": (0.15, 0.7, "even"),
    "saturation": (0.0, 6.0, "even"),
    "black": (0.0, 0.35, "even"),
    "reverberation": (0.01, 0.5, "log"),
    "reverberation_length": (0.03, 1.0, "log"),
    "group_gain_std": (0.0, 1.5, "even"),
    "dim_share": (0.0, 0.08, "even"),
    "dim_loss": (3.0, 20.0, "even"),
    "unevenness": (0.0, 2.5, "even"),
    "ripple": (0.1, 0.7, "even"),
    "ripple_wavelength": (0.03, 0.4, "log"),
    "ripple_direction": (-1.6, 1.6, "even"),
    "other_pings": (0.3, 20.0, "log"),
    "floor_bounce_once": (0.03, 1.0, "log"),
}
"""Ranges as in `RANGES` that `draw_wide` uses in place of those there, or in addition, at severity 1."""

SELDOM: dict[str, float] = {
    "saturation": 0.3, "black": 0.15, "reverberation": 0.6, "group_gain_std": 0.3, "dim_share": 0.2, "unevenness": 0.6,
    "ripple": 0.15, "other_pings": 0.1, "floor_bounce_once": 0.6,
}  # fmt: skip
"""Share of the draws of `draw_wide` in which a field is present; elsewhere it has the nominal value."""
