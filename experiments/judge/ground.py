"""What makes a real floor uneven: patches, ripples, and the texture that turns Rayleigh speckle into K."""

from __future__ import annotations

import math

import numpy as np

from experiments.judge.device import Device
from experiments.judge.view import View


def floor_brightness(view: View, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Relative power of the floor's echo (sample, sub), of mean about 1."""
    brightness = _patches(view, device, rng) * _texture(view, device, rng)
    return brightness * _ripples(view, device, rng) if device.ripple > 0 else brightness


def _patches(view: View, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Lognormal brightness that changes from patch to patch."""
    away, across = _cells(view, device.patch_m, rng)
    along, beside = (_between(at) for at in (away, across))
    coarse = rng.standard_normal((along.shape[1], beside.shape[1]), np.float32)
    level_db = device.patch_db * (along @ coarse @ beside.T)
    return np.exp(level_db * (math.log(10) / 10))


def _texture(view: View, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Gamma-distributed brightness of mean 1, alike within a grain: times exponential intensity, the K distribution."""
    away, across = (np.floor(at).astype(np.int64) for at in _cells(view, device.grain_m, rng))
    grains = rng.standard_gamma(device.texture_shape, (away.max() + 1, across.max() + 1), np.float32)
    return (grains / np.float32(device.texture_shape))[away][:, across]


def _ripples(view: View, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Straight ripples on the floor, their crests in a random direction: one slope of each sends more back.

    The direction turns the pattern only. Ripples whose crests run along the line of sight are as strong as those
    across it, although their slopes face sideways.
    """
    ground = _ground_range(view)[:, None].astype(np.float32)
    azimuth = view.sub_azimuth.astype(np.float32)
    heading, start = rng.uniform(0, 2 * np.pi, 2).astype(np.float32)
    phase = ground * np.cos(azimuth - heading) * np.float32(2 * np.pi / device.ripple_m) + start
    return 1 + np.float32(device.ripple) * np.sin(phase)


def _ground_range(view: View) -> np.ndarray:
    """Horizontal distance of the range samples on the floor (sample,) [m]."""
    return np.sqrt(view.sample_ranges**2 - view.height**2)


def _cells(view: View, size: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the samples (sample,) and sub-beams (sub,) in cells of `size` [m] on the floor, from 0 upwards.

    Across, a cell has its size in the window's middle.
    """
    ground, azimuth = _ground_range(view), view.sub_azimuth
    away = (ground - ground[0]) / size
    across = (azimuth - azimuth[0]) * ground[len(ground) // 2] / size
    return away + rng.random(), across + rng.random()


def _between(at: np.ndarray) -> np.ndarray:
    """Weights (point, node) of linear interpolation at `at` (point,), scaled so that the variance is even."""
    nodes = np.arange(int(at.max()) + 2)
    weights = np.maximum(1 - np.abs(at[:, None] - nodes), 0)
    return (weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32)
