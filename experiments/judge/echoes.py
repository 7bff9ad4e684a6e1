"""Mean echo power per range sample and sub-beam, before speckle: the floor's, the object's, and what follows them.

One ray's echo is (backscattering strength / cosine of incidence) × pattern × solid angle / r² × absorption: the surface
it covers is r² solid angle / cosine, and power falls as r⁻⁴ there and back (Urick, ch. 8).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from experiments.judge.device import Device
from experiments.judge.raycast import FLOOR, Hits, Paths
from experiments.judge.view import SAMPLES, View

STEEPEST = 0.05
"""Cosine of incidence below which a face's echo is not divided by it any further [1]."""
PHASED_LEGS = 4.0
"""A path over the floor on one way is run in both directions, equally long: amplitudes add, power is fourfold."""


def from_db(level: float | np.ndarray) -> float | np.ndarray:
    """Power ratio of a level [dB]."""
    return 10 ** (np.asarray(level) / 10)


def absorption_db_m(frequency: float, temperature_c: float) -> float:
    """One-way absorption in fresh water [dB/m] at `frequency` [Hz], up to 20 °C (Francois–Garrison's viscous term)."""
    t = temperature_c
    return (4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.5e-8 * t**3) * (frequency / 1e3) ** 2 / 1e3


def vertical_pattern(elevation: np.ndarray, aperture: float, device: Device) -> np.ndarray:
    """Power there and back at `elevation` [rad] off the axis: flat-topped with skirts, 1 on the axis."""
    part = np.abs(elevation) / (aperture / 2)
    outside = np.degrees(np.maximum(part - 1, 0) * (aperture / 2))
    loss = device.droop_db * np.minimum(part, 1) ** 2 + device.skirt_db_per_deg * outside
    return np.exp(loss * (-math.log(10) / 10))


def floor_echo(hits: Hits, device: Device) -> np.ndarray:
    """Mean power of an even floor (sample, sub), without what the object hides."""
    n = hits.view.n_ranges * SAMPLES
    return bare_floor(hits, device) * (hits.kind[:n] == FLOOR)


def bare_floor(hits: Hits, device: Device, first: int = 0, step: int = 1) -> np.ndarray:
    """Mean power of an even floor with nothing on it (sample, sub), of every `step`-th sample from `first`."""
    view = hits.view
    rows = slice(first, view.n_ranges * SAMPLES, step)
    r = view.sample_ranges[rows]
    lost = hits.sine[rows] / r**2 * from_db(-2 * absorption_db_m(view.frequency, device.temperature_c) * r)
    power = vertical_pattern(hits.elevation[rows], view.aperture, device) * hits.solid_angle[rows]
    power *= lost[:, None].astype(np.float32)
    return power


def path_echo(paths: Paths, view: View, device: Device) -> np.ndarray:
    """Mean power of each path at the object (path,): Lambert's law plus a glossy lobe."""
    lambert = paths.cos_in * paths.cos_out
    width = np.sin(np.radians(device.gloss_deg)) ** 2
    gloss = from_db(device.gloss_db) * np.exp(-np.maximum(1 - paths.cos_half**2, 0) / width)
    strength = from_db(device.object_db) * (lambert + gloss)
    pattern = np.sqrt(
        vertical_pattern(paths.elevation_in, view.aperture, device)
        * vertical_pattern(paths.elevation_out, view.aperture, device)
    )
    lost = from_db(-2 * absorption_db_m(view.frequency, device.temperature_c) * paths.length)
    return strength / np.maximum(paths.cos_in, STEEPEST) * pattern * paths.solid_angle / paths.near**2 * lost


def object_echo(hits: Hits, device: Device) -> np.ndarray:
    """Mean power of the object's direct echo (sample, sub)."""
    paths = hits.direct()
    return gathered(hits.view, paths.column, paths.length, path_echo(paths, hits.view, device))


def bounce_echo(hits: Hits, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Mean power of the object's echo by way of the floor (sample, sub), one way and both ways."""
    total = np.zeros((hits.view.n_ranges * SAMPLES, len(hits.view.sub_azimuth)), np.float32)
    for paths, bounces, gain in ((hits.one_bounce, 1, PHASED_LEGS), (hits.two_bounces, 2, 1.0)):
        late = rng.exponential(device.bounce_spread_m, (bounces, len(paths.column))).sum(0)
        power = gain * from_db(bounces * device.bounce_db) * path_echo(paths, hits.view, device)
        total += gathered(hits.view, paths.column, paths.length + late, power)
    return total


def late_echo(echo: np.ndarray, view: View, device: Device) -> np.ndarray:
    """Late reverberation (sample, sub): a share of the object's `echo`, decaying with range behind it.

    It comes over many paths, so it keeps the object's bearing only within a few beams.
    """
    step = view.range_bin / SAMPLES
    keep = np.exp(-step / device.late_m)
    busy = np.flatnonzero(echo.any(axis=0))
    late = np.zeros_like(echo)
    if len(busy) == 0:
        return late
    blur = np.exp(-np.abs(view.sub_azimuth[:, None] - view.sub_azimuth[busy]) / LATE_SPREAD)
    blur /= blur.sum(axis=0)
    decayed = lfilter([1 - keep], [1, -keep], echo[:, busy], axis=0).astype(np.float32)
    return decayed @ (blur.T * from_db(device.late_db)).astype(np.float32)


LATE_SPREAD = np.radians(1.5)
"""Late reverberation falls to 1/e so far from the object's bearing [rad]."""


def gathered(view: View, column: np.ndarray, length: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Powers (path,) summed into range samples and sub-beams (sample, sub); what lies outside the window is dropped."""
    rows, columns = view.n_ranges * SAMPLES, len(view.sub_azimuth)
    row = np.floor((length - view.range_min) * (SAMPLES / view.range_bin)).astype(np.int64)
    inside = (row >= 0) & (row < rows)
    at = row[inside] * columns + column[inside]
    return np.bincount(at, power[inside], rows * columns).astype(np.float32).reshape(rows, columns)
