"""The look of a device, which is how it shows energy: numbers that are fitted together with the geometry, and
their priors.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from sonarjax.sensor import SensorModel


class Look(NamedTuple):
    """How the device shows energy, shared by all frames. Each field is a number."""

    gain: Any
    """Logarithm of the ratio of the object's backscatter to the floor's [1]."""
    noise: Any
    """Logarithm of the ratio of the noise to the floor's energy [1], at the reference range."""
    exponent: Any
    """Logarithm of the power of energy in what is stored [1]."""
    log_share: Any
    """The logarithm's share of the slope of what is stored, at the floor's energy [1]; the power has the rest."""
    skirt: Any
    """How steeply the vertical pattern falls outside the aperture [dB per degree]."""
    slope: Any
    """Power of range by which the floor becomes brighter [1]."""
    noise_slope: Any
    """Power of range by which the noise becomes brighter [1], which is that of the time-varied gain."""
    pulse: Any
    """Length of the pulse [range bins], 1 to 9."""
    widening: Any
    """−3 dB width of a beam, as a multiple of the sonar's own [1]."""
    dark: Any
    """Logarithm of the energy, relative to the floor's, below which everything is black [1]."""
    white: Any
    """Logarithm of the energy, relative to the floor's, above which everything is white [1]."""
    rim: Any
    """Share of the simulator's way of mixing object and floor at the object's rim [1], see `picture`."""
    leak: Any
    """Logarithm of the energy that a beam hears of all other beams, relative to its own [1]."""
    streak: Any
    """Logarithm of the share of a glint's energy that is added to its entire range row [1]."""
    floor_path: Any
    """1 if an echo bounces on the floor both ways, 0.5 if on one way only [1]."""


class _Prior(NamedTuple):
    start: float
    std: float
    trust: float


_DEVICE = SensorModel()
_DB = math.log(10.0) / 10
_PRIORS = Look(
    gain=_Prior(_DB * float(_DEVICE.object_gain), 1.0, 0.5),
    noise=_Prior(math.log(float(_DEVICE.noise)), 2.0, 0.8),
    exponent=_Prior(-1.2, 0.6, 0.3),
    log_share=_Prior(0.5, 0.35, 0.2),
    skirt=_Prior(float(_DEVICE.elevation_skirt), 1.5, 2.0),
    slope=_Prior(0.0, 1.5, 0.5),
    noise_slope=_Prior(float(_DEVICE.tvg_exponent), 1.5, 1.0),
    pulse=_Prior(float(_DEVICE.pulse_bins), 1.0, 0.5),
    widening=_Prior(float(_DEVICE.beam_widening), 0.3, 0.2),
    dark=_Prior(-6.0, 3.0, 1.0),
    white=_Prior(_DB * float(_DEVICE.gain), 1.0, 0.5),
    rim=_Prior(0.5, 0.5, 0.5),
    leak=_Prior(-2.5, 1.5, 0.7),
    streak=_Prior(math.log(float(_DEVICE.streak)), 1.5, 0.7),
    floor_path=_Prior(0.75, 0.2, 0.15),
)
LOOK = Look(*(prior.start for prior in _PRIORS))
"""Initial look: that of the nominal device."""
LOOK_STD = Look(*(prior.std for prior in _PRIORS))
"""Standard deviations of its prior: the spread of the devices that the package draws."""
LOOK_TRUST = Look(*(prior.trust for prior in _PRIORS))
"""Scales of the steps of a fit, see `Parameter.trust`."""
LEAST_EXPONENT = 0.02
"""Least power of energy [1], which is practically a logarithm."""


def sensor_of(look: Look) -> SensorModel:
    """The nominal device with this look, whose white is at least 1 dB above its black.

    The display's blend of a logarithm and a power (`sensor.compress`) is that of `picture` up to a factor and an
    offset.
    """
    power = math.exp(look.exponent) + LEAST_EXPONENT
    dynamic_range = max(float(look.white - look.dark) / _DB, 1.0)
    # The slopes at energy 1 of the logarithm and of the power have the ratio share : 1 − share.
    share = min(max(float(look.log_share), 0.0), 1.0)
    logarithm = share * power * math.exp(-power * look.white) * _DB * dynamic_range
    return SensorModel(
        object_gain=look.gain / _DB, noise=math.exp(look.noise), elevation_skirt=look.skirt,
        tvg_exponent=look.noise_slope, pulse_bins=look.pulse, beam_widening=look.widening,
        gain=look.white / _DB, dynamic_range=dynamic_range, exponent=power,
        log_share=logarithm / (logarithm + 1 - share),
    )  # fmt: skip
