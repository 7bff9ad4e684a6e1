"""From what the rays met to the 8 bits a device stores: echoes, coherent speckle, beams, gain, noise, display.

Every sub-beam and range sample scatters with a complex Gaussian amplitude of its own: at λ = 0.8 mm surfaces are rough.
Pulse and beam pattern add amplitudes, not powers, so speckle and how it hangs together from bin to bin and beam to beam
come out of the sum.
"""

from __future__ import annotations

import numpy as np

from experiments.judge.device import Device
from experiments.judge.display import stored
from experiments.judge.echoes import (
    absorption_db_m,
    bounce_echo,
    floor_echo,
    from_db,
    late_echo,
    object_echo,
)
from experiments.judge.ground import floor_brightness
from experiments.judge.raycast import OBJECT, Hits
from experiments.judge.view import SAMPLES, SUB_BEAMS, View

__all__ = ["Device", "beam_pattern", "field", "store"]

SQUARE = 0.95
"""Cosine of incidence above which a face may glint [1]: within 18°, as bricks have rounded edges and a grain."""
HALF_POWER = {False: 0.44295, True: 0.31890}
"""x at which numpy's sinc(x)² (False: one way) or sinc(x)⁴ (True: both ways) is 1/2 [1]."""


def store(hits: Hits, device: Device, rng: np.random.Generator) -> np.ndarray:
    """The frame (range, beam), uint8, that `device` stores."""
    view = hits.view
    power = _mean_power(hits, device, rng)
    glint = _glint(hits, power, device, rng)
    gain = _gain(view, device)[:, None]
    noise_shape = (view.ranges / view.ranges[-1])[:, None] ** 2
    lit = _lit(hits)
    total = np.zeros((view.n_ranges, view.n_beams), np.float32)
    for _ in range(device.looks):
        amplitude = _crosstalk(field(power, view, device, rng, glint), device, rng) * np.sqrt(gain)
        reference = np.median((np.abs(amplitude) ** 2)[lit]) if lit.any() else 1.0
        noise = _gaussian(amplitude.shape, rng) * np.sqrt(from_db(device.noise_db) * reference * noise_shape)
        total += np.abs(amplitude + noise) ** 2
    return stored(total / (np.median(total[lit]) if lit.any() else 1.0), device)


def field(
    power: np.ndarray, view: View, device: Device, rng: np.random.Generator, steady: np.ndarray | None = None
) -> np.ndarray:
    """Complex amplitude (range, beam) of one look at scatterers of mean `power` (sample, sub).

    `steady` (sample, sub) are amplitudes that do not fluctuate: glints.
    """
    scattered = _gaussian(power.shape, rng) * np.sqrt(power)
    if steady is not None:
        scattered += steady
    return _pulsed(scattered @ beam_pattern(view, device, rng).astype(np.complex64), view, device)


def beam_pattern(view: View, device: Device, rng: np.random.Generator | None = None) -> np.ndarray:
    """Amplitude with which each sub-beam reaches each beam (sub, beam), complex with `rng`, which adds stray sound.

    An array's sin(u)/u in the sine of azimuth, squared where the lens works on both ways; −3 dB at the beam's width.
    """
    away = np.sin(view.sub_azimuth)[:, None] - np.sin(view.centers)
    width = device.beam_width_ratio * np.diff(np.sin(view.edges))
    pattern = np.sinc(2 * HALF_POWER[device.both_ways] * away / width) ** (2 if device.both_ways else 1)
    if rng is None:
        return pattern
    phase = np.exp(2j * np.pi * rng.random(pattern.shape))
    return pattern + np.sqrt(from_db(device.stray_db)) * phase


def _mean_power(hits: Hits, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Mean power of everything that echoes (sample, sub)."""
    direct = object_echo(hits, device)
    power = floor_echo(hits, device) * floor_brightness(hits.view, device, rng)
    return power + direct + bounce_echo(hits, device, rng) + late_echo(direct, hits.view, device)


def _glint(hits: Hits, power: np.ndarray, device: Device, rng: np.random.Generator) -> np.ndarray | None:
    """Amplitude of a mirror-like spot (sample, sub) where a ray strikes the object squarely, or None.

    At most one cell of a frame has it: `device.glint_db` over the largest of `power` (sample, sub).
    """
    row, column = np.nonzero((hits.kind == OBJECT) & (hits.cosine > SQUARE))
    if len(row) == 0 or rng.random() >= device.glint_chance:
        return None
    view, spot = hits.view, rng.integers(len(row))
    sample = int((hits.distance[row[spot], column[spot]] - view.range_min) * SAMPLES / view.range_bin)
    if not 0 <= sample < len(power):
        return None
    steady = np.zeros(power.shape, np.complex64)
    steady[sample, column[spot]] = np.sqrt(from_db(device.glint_db) * power.max())
    return steady


def _pulsed(scattered: np.ndarray, view: View, device: Device) -> np.ndarray:
    """Amplitudes (range, beam) in the bins' middles of (sample, beam): a pulse of raised-cosine envelope."""
    step = view.range_bin / SAMPLES
    reach = max(int(device.pulse_m / step), 1)  # the envelope's half amplitude lies half a pulse from its middle
    offset = np.arange(-reach, reach + 1)
    envelope = 0.5 + 0.5 * np.cos(np.pi * offset * step / max(device.pulse_m, step))
    padded = np.pad(scattered, ((reach, reach), (0, 0)))
    first = SAMPLES // 2
    rows = view.n_ranges * SAMPLES
    total = np.zeros((view.n_ranges, scattered.shape[1]), np.complex64)
    for shift, weight in enumerate(envelope.astype(np.float32)):
        total += weight * padded[first + shift : first + shift + rows : SAMPLES]
    return total


def _crosstalk(amplitude: np.ndarray, device: Device, rng: np.random.Generator) -> np.ndarray:
    """Amplitude (range, beam) with what leaks in from beams fired at once, each leak with a phase of its own."""
    beam = np.arange(amplitude.shape[1])
    together = (beam[:, None] - beam) % device.firing_period == 0
    leak = np.sqrt(from_db(device.crosstalk_db)) * np.exp(2j * np.pi * rng.random(together.shape))
    mixing = np.where(together, leak, 0)
    np.fill_diagonal(mixing, 1)
    return amplitude @ mixing.astype(np.complex64)


def _gain(view: View, device: Device) -> np.ndarray:
    """Time-varied gain in power (range,), 1 in the window's middle: the inverse of the loss that the device assumes."""
    r = view.ranges
    middle = r[len(r) // 2]
    slope = 2 * device.assumed_absorption * absorption_db_m(view.frequency, device.temperature_c)
    return (r / middle) ** device.gain_exponent * from_db((slope + device.gain_slope_db_m) * (r - middle))


def _lit(hits: Hits) -> np.ndarray:
    """Pixels (range, beam) whose floor lies inside the vertical aperture."""
    rows = slice(SAMPLES // 2, hits.view.n_ranges * SAMPLES, SAMPLES)
    middle = hits.elevation[rows, hits.view.inner][:, SUB_BEAMS // 2 :: SUB_BEAMS]
    return np.abs(middle) <= hits.view.aperture / 2


def _gaussian(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Circular complex Gaussian amplitudes of unit mean power."""
    parts = rng.standard_normal((*shape, 2), np.float32) * np.float32(np.sqrt(0.5))
    return parts.view(np.complex64)[..., 0]
