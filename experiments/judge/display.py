"""How a device maps the power of an echo to 8 bits of grey."""

from __future__ import annotations

import numpy as np

from experiments.judge.device import Device

BLACK_DB = -120.0
"""Power below which all is black, so that no logarithm of 0 is taken [dB]."""


def grey(power: np.ndarray, device: Device) -> np.ndarray:
    """Grey in [0, 1] of `power` over the lit floor's median: that itself becomes `device.floor_grey`."""
    level = device.floor_grey
    if device.law == "db":
        decibels = 10 * np.log10(np.maximum(power, 10 ** (BLACK_DB / 10)))
        return np.clip(level + decibels / device.range_db, 0, 1)
    if device.law == "power":
        return np.clip(level * power ** (device.gamma / 2), 0, 1)
    if device.law == "arctan":
        return 2 / np.pi * np.arctan(np.tan(level * np.pi / 2) * np.sqrt(power))
    raise ValueError(f"unknown display law {device.law!r}, expected db, power or arctan")


def stored(power: np.ndarray, device: Device) -> np.ndarray:
    """The 8 bits (range, beam) of `power`, after the automatic gain has answered its peak."""
    peak_db = 10 * np.log10(max(float(power.max()), 1e-12))
    gain_db = -device.automatic_gain * max(peak_db - device.headroom_db, 0.0)
    return np.round(255 * grey(power * 10 ** (gain_db / 10), device)).astype(np.uint8)
