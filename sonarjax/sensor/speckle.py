"""Speckle: complex Gaussian fields, their correlation, and what makes them less or more than Rayleigh.

Fields are (part, range, beam) with the real part first, of unit mean intensity; intensities (range, beam) have mean 1.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.sonar import Sonar

MAX_LOOKS = 4
"""Most looks that `multi_look` averages."""
LOOK_SHIFTS = (0, 1, 3, 9)  # thirteenths of the image: all differences differ, so two pixels share one look at most
PATCH = (16, 4)
"""Spacing (range bins, beams) of the patches of an uneven bottom."""


def complex_field(shape: tuple[int, int], *, key: jax.Array) -> Float[Array, "part range beam"]:
    """White circular Gaussian field (part, range, beam) with E|g|² = 1: its amplitude is Rayleigh.

    What many scatterers within one resolution cell add up to (Goodman, Speckle Phenomena in Optics, 2007, ch. 2).
    """
    field = jax.random.normal(key, (2, *shape)) * 0.5**0.5
    return jax.lax.optimization_barrier(field)  # else XLA draws the numbers anew for each of their uses


def azimuth_kernel(sonar: Sonar, reach: Any) -> Float[Array, "beam source"]:
    """Matrix (beam, source) that correlates a white field over azimuth; its rows have unit energy.

    Gaussian in the azimuth difference, of width `reach` in mean beam spacings. The intensity's autocorrelation at a
    lag of n spacings is exp(−n²/(2 reach²)), to 2 % for a reach above 0.8: 0.60 at one beam for 0.99. It is the square
    of the field's (Siegert's relation for circular Gaussian fields). No source for the Gaussian: a model of ours; 0.60
    was measured on real Oculus frames.
    """
    azimuth = jnp.asarray(sonar.azimuth, jnp.float32)
    spacing = (azimuth[-1] - azimuth[0]) / max(sonar.n_beams - 1, 1) if sonar.n_beams > 1 else jnp.float32(1.0)
    lag = (azimuth[:, None] - azimuth[None, :]) / spacing
    weights = jnp.exp(-jnp.square(lag / jnp.maximum(jnp.asarray(reach, jnp.float32), 0.1)) / 2)
    return weights / jnp.sqrt(jnp.square(weights).sum(axis=1, keepdims=True))


def range_kernel(correlation: Any) -> Float[Array, "3"]:
    """Three weights (3) along range, of unit energy, after which the *intensity* of a white field correlates by this.

    `correlation` is that of neighbouring bins, 0 to 0.5: the square of the field's, as in `azimuth_kernel`. No source
    for the three weights: a model of ours.
    """
    field = jnp.sqrt(jnp.clip(jnp.asarray(correlation, jnp.float32), 1e-6, 0.4999))
    side = (1 - jnp.sqrt(1 - 2 * field**2)) / (2 * field)
    return jnp.stack([side, jnp.ones_like(side), side]) / jnp.sqrt(1 + 2 * side**2)


def correlate(
    field: Float[Array, "part range beam"],
    across: Float[Array, "beam source"],
    along: Float[Array, "3"],
) -> Float[Array, "part range beam"]:
    """A white field (part, range, beam) correlated by `azimuth_kernel` (beam, source) and `range_kernel` (3).

    No source: linear filters, so a Gaussian field stays Gaussian; that they act one by one is a model of ours.
    """
    rows = field.shape[1]
    # Beams first: the other way round XLA fuses the drawing of the numbers into the product, ten times slower.
    mixed = jnp.einsum("prs,bs->prb", field, across)
    padded = jnp.concatenate([mixed[:, -1:], mixed, mixed[:, :1]], axis=1)  # around the ends: they stay as strong
    return along[0] * padded[:, :rows] + along[1] * mixed + along[2] * padded[:, 2:]


def speckle_intensity(field: Float[Array, "part range beam"], diffuse: Any = 1.0) -> Float[Array, "range beam"]:
    """Intensity (range, beam), mean 1, of a field (part, range, beam) beside a steady echo: Rice's distribution.

    `diffuse` is the share of the energy that scatters at random: 1 gives exponential intensity (Rayleigh amplitude),
    0 gives exactly 1. The variance is 1 − (1 − diffuse)² (Rice, Bell Syst. Tech. J. 24, 1945).
    """
    diffuse = jnp.clip(jnp.asarray(diffuse, jnp.float32), 0.0, 1.0)
    steady, scattered = _safe_sqrt(1 - diffuse), _safe_sqrt(diffuse)
    return jnp.square(steady + scattered * field[0]) + jnp.square(scattered * field[1])


def heavy_tails(intensity: Float[Array, "range beam"], power: Any) -> Float[Array, "range beam"]:
    """`intensity` (range, beam)^`power` over its mean: of exponential intensity Weibull's law with the shape 1/power.

    The standard deviation in dB is `power` times Rayleigh's 5.57 dB; 2/power is the shape of the amplitude's law, 1.7
    as measured on the bottom of real Oculus frames. Weibull clutter: Sekine and Mao, Weibull Radar Clutter (1990).
    """
    power = jnp.asarray(power, jnp.float32)
    return jnp.maximum(intensity, 1e-9) ** power * jnp.exp(-jax.scipy.special.gammaln(1 + power))


def _safe_sqrt(value: Array) -> Array:
    return jnp.where(value > 0, jnp.sqrt(jnp.where(value > 0, value, 1.0)), 0.0)


def multi_look(intensity: Float[Array, "range beam"], looks: Any) -> Float[Array, "range beam"]:
    """Mean (range, beam) of `looks` independent speckles of unit mean, 1 to 4: Gamma(L, 1/L) for whole numbers.

    The other looks are the same `intensity` (range, beam) shifted by large parts of the image, which costs no random
    numbers; pixels that are that far apart share a look. Between whole numbers the last look counts less, so that the
    variance is 1/looks of one look's (Oliver and Quegan, Understanding Synthetic Aperture Radar Images, 1998, ch. 4).
    """
    rows, beams = intensity.shape
    weights = look_weights(looks)
    shifts = [(k * rows // 13, k * beams // 13) for k in LOOK_SHIFTS]
    return sum(w * jnp.roll(intensity, shift, (0, 1)) for w, shift in zip(weights, shifts, strict=True))


def look_weights(looks: Any) -> Float[Array, "look"]:
    """Weights (look,) of sum 1 whose squares sum to 1/looks: m equal ones and a smaller one, m the whole part."""
    looks = jnp.clip(jnp.asarray(looks, jnp.float32), 1.0, float(MAX_LOOKS))
    whole = jnp.floor(looks)
    # (m + x)² = L·(m + x²) for the last weight x, relative to the others
    rest = looks - 1
    last = (whole - _safe_sqrt(whole**2 - rest * whole * (looks - whole))) / jnp.where(rest > 0, rest, 1.0)
    order = jnp.arange(MAX_LOOKS)
    weights = jnp.where(order < whole, 1.0, jnp.where(order == whole, jnp.where(rest > 0, last, 0.0), 0.0))
    return weights / weights.sum()


def gamma_texture(shape: tuple[int, int], variance: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Mean energy (range, beam) of a patchy bottom: Gamma of mean 1 and `variance`, smooth between patches.

    Speckle times this is K-distributed with shape 1/variance (Jakeman and Pusey, IEEE Trans. Antennas Propag. 24,
    1976): the second moment of the intensity is 2·(1 + variance). Gamma from a Gaussian by `gamma_of_normal`.
    """
    return gamma_of_normal(patchy_normal(shape, key=key), variance)


def gamma_of_normal(normal: Float[Array, "*batch"], variance: Any) -> Float[Array, "*batch"]:
    """Gamma variates (...) of mean 1 and `variance` from standard `normal` ones (...), monotonically.

    The cube of Wilson and Hilferty (Proc. Natl. Acad. Sci. 17, 1931), good for a variance up to 1.
    """
    ninth = jnp.asarray(variance, jnp.float32) / 9
    return jnp.maximum(1 - ninth + _safe_sqrt(ninth) * normal, 0.0) ** 3


def patchy_normal(shape: tuple[int, int], *, key: jax.Array) -> Float[Array, "range beam"]:
    """A standard normal field (range, beam) that changes over the length of a patch, interpolated between patches.

    No source: a model of ours for how an uneven bottom varies.
    """
    coarse = jax.random.normal(key, (shape[0] // PATCH[0] + 2, shape[1] // PATCH[1] + 2))
    rows, columns = (_interpolation(n, step) for n, step in zip(shape, PATCH, strict=True))
    return rows @ coarse @ columns.T


def _interpolation(count: int, step: int) -> Float[Array, "pixel patch"]:
    """Linear interpolation weights, scaled so that independent normals stay of unit variance."""
    place = jnp.arange(count) / step
    weights = jnp.maximum(1 - jnp.abs(place[:, None] - jnp.arange(count // step + 2)), 0.0)
    return weights / jnp.sqrt(jnp.square(weights).sum(axis=1, keepdims=True))
