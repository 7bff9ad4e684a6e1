"""Speckle: complex Gaussian fields, their correlation, and distributions narrower or wider than Rayleigh's.

Fields are (part, range, beam), real part first, with a mean intensity of 1. Intensities are (range, beam), mean 1.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.sonar import Sonar

MAX_LOOKS = 4
"""Most looks that `multi_look` averages."""
LOOK_SHIFTS = (0, 1, 3, 9)  # in thirteenths of the image; all differences differ, so two pixels share at most one look
PATCH = (16, 4)
"""Size (range bins, beams) of the patches of an uneven bottom."""


def complex_field(shape: tuple[int, int], *, key: jax.Array) -> Float[Array, "part range beam"]:
    """Draw a white circular Gaussian field with E|g|² = 1; its amplitude is Rayleigh.

    It is the sum of many scatterers within one resolution cell (Goodman, Speckle Phenomena in Optics, 2007, ch. 2).

    Args:
        shape: Shape (range, beam) of the image.
        key: Source of the random numbers.

    Returns:
        Field (part, range, beam), real part first.
    """
    field = jax.random.normal(key, (2, *shape)) * 0.5**0.5
    return jax.lax.optimization_barrier(field)  # without it XLA draws the numbers again for each use


def azimuth_kernel(sonar: Sonar, reach: Any) -> Float[Array, "beam source"]:
    """Return the matrix that correlates a white field over azimuth.

    Gaussian in the difference of azimuth. The autocorrelation of the intensity at a lag of n mean beam spacings is
    exp(−n²/(2 reach²)), to 2 % for a reach above 0.8; for example 0.60 at one beam for 0.99. It is the square of the
    field's autocorrelation (Siegert's relation for circular Gaussian fields). No source for the Gaussian: a model of
    ours; 0.60 was measured on real Oculus frames.

    Args:
        sonar: Gives the beams.
        reach: Width of the Gaussian [mean beam spacings].

    Returns:
        Matrix (beam, source) whose rows have unit energy.
    """
    azimuth = jnp.asarray(sonar.azimuth, jnp.float32)
    spacing = (azimuth[-1] - azimuth[0]) / max(sonar.n_beams - 1, 1) if sonar.n_beams > 1 else jnp.float32(1.0)
    lag = (azimuth[:, None] - azimuth[None, :]) / spacing
    weights = jnp.exp(-jnp.square(lag / jnp.maximum(jnp.asarray(reach, jnp.float32), 0.1)) / 2)
    return weights / jnp.sqrt(jnp.square(weights).sum(axis=1, keepdims=True))


def range_kernel(correlation: Any) -> Float[Array, "3"]:
    """Return the weights that correlate a white field along range.

    The correlation of intensity is the square of the field's, as in `azimuth_kernel`. No source for the three weights:
    a model of ours.

    Args:
        correlation: Wanted correlation of *intensity* between neighbouring range bins [1], 0 to 0.5.

    Returns:
        Three weights (3) of unit energy.
    """
    field = jnp.sqrt(jnp.clip(jnp.asarray(correlation, jnp.float32), 1e-6, 0.4999))
    side = (1 - jnp.sqrt(1 - 2 * field**2)) / (2 * field)
    return jnp.stack([side, jnp.ones_like(side), side]) / jnp.sqrt(1 + 2 * side**2)


@full_precision
def correlate(
    field: Float[Array, "part range beam"],
    across: Float[Array, "beam source"],
    along: Float[Array, "3"],
) -> Float[Array, "part range beam"]:
    """Correlate a white field over azimuth and along range.

    No source: both are linear filters, so a Gaussian field stays Gaussian. Applying one after the other is a model of
    ours.

    Args:
        field: White field (part, range, beam).
        across: Matrix (beam, source) of `azimuth_kernel`.
        along: Weights (3) of `range_kernel`.

    Returns:
        Correlated field (part, range, beam).
    """
    rows = field.shape[1]
    # Beams come first. In the other order XLA fuses the drawing of numbers into the product, which is ten times slower.
    mixed = jnp.einsum("prs,bs->prb", field, across)
    if rows < 3:  # a pixel would be its own neighbour
        return mixed
    padded = jnp.concatenate([mixed[:, -1:], mixed, mixed[:, :1]], axis=1)  # wraps, so that the ends stay as strong
    return along[0] * padded[:, :rows] + along[1] * mixed + along[2] * padded[:, 2:]


def speckle_intensity(field: Float[Array, "part range beam"], diffuse: Any = 1.0) -> Float[Array, "range beam"]:
    """Return the intensity of a field added to a steady echo: Rice's distribution.

    The variance is 1 − (1 − diffuse)² (Rice, Bell Syst. Tech. J. 24, 1945).

    Args:
        field: Field (part, range, beam) of mean intensity 1.
        diffuse: Share of the energy that scatters at random [1]: 1 gives exponential intensity (Rayleigh amplitude), 0
            gives exactly 1.

    Returns:
        Intensity (range, beam) of mean 1.
    """
    diffuse = jnp.clip(jnp.asarray(diffuse, jnp.float32), 0.0, 1.0)
    steady, scattered = _safe_sqrt(1 - diffuse), _safe_sqrt(diffuse)
    return jnp.square(steady + scattered * field[0]) + jnp.square(scattered * field[1])


def heavy_tails(intensity: Float[Array, "range beam"], power: Any) -> Float[Array, "range beam"]:
    """Raise an intensity to a power, which makes exponential intensity Weibull of shape 1/power.

    The standard deviation in dB is `power` times Rayleigh's 5.57 dB. The amplitude's law has the shape 2/power; on the
    bottom of real Oculus frames that is 1.7. Weibull clutter: Sekine and Mao, Weibull Radar Clutter (1990).

    Args:
        intensity: Intensity (range, beam), exponential with mean 1.
        power: Exponent [1]; 1 changes nothing.

    Returns:
        Intensity (range, beam), scaled to mean 1.
    """
    power = jnp.asarray(power, jnp.float32)
    return jnp.maximum(intensity, 1e-9) ** power * jnp.exp(-jax.scipy.special.gammaln(1 + power))


def _safe_sqrt(value: Array) -> Array:
    return jnp.where(value > 0, jnp.sqrt(jnp.where(value > 0, value, 1.0)), 0.0)


def multi_look(intensity: Float[Array, "range beam"], looks: Any) -> Float[Array, "range beam"]:
    """Average independent speckles of mean 1, which makes exponential intensity Gamma(L, 1/L) for a whole number L.

    The further looks are the same intensity shifted by large parts of the image, which needs no further random numbers;
    pixels that are one shift apart share a look. (In an image of fewer than 13 pixels along both axes, looks repeat.)
    For a fractional number the last look has less weight, so that the variance is 1/looks times that of one look
    (Oliver and Quegan, Understanding Synthetic Aperture Radar Images, 1998, ch. 4).

    Args:
        intensity: Intensity (range, beam) of one look.
        looks: Number of looks, 1 to 4; fractions are allowed.

    Returns:
        Mean intensity (range, beam) of the looks.
    """
    rows, beams = intensity.shape
    weights = look_weights(looks)
    shifts = [(k * rows // 13, k * beams // 13) for k in LOOK_SHIFTS]
    return reduce(jnp.add, [w * jnp.roll(intensity, shift, (0, 1)) for w, shift in zip(weights, shifts, strict=True)])


def look_weights(looks: Any) -> Float[Array, "look"]:
    """Weights (look,) that sum to 1, with squares that sum to 1/looks.

    All looks have the same weight, except the last one if `looks` is not a whole number: that one weighs less.
    """
    looks = jnp.clip(jnp.asarray(looks, jnp.float32), 1.0, float(MAX_LOOKS))
    full = jnp.floor(looks)
    # The last weight x, relative to the m equal ones, solves (m + x)² = L·(m + x²).
    rest = looks - 1
    last = (full - _safe_sqrt(full**2 - rest * full * (looks - full))) / jnp.where(rest > 0, rest, 1.0)
    order = jnp.arange(MAX_LOOKS)
    weights = jnp.where(order < full, 1.0, jnp.where(order == full, jnp.where(rest > 0, last, 0.0), 0.0))
    return weights / weights.sum()


def gamma_texture(shape: tuple[int, int], variance: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Draw the mean energy of a patchy bottom: Gamma of mean 1, smooth between patches.

    Speckle times this is K-distributed with shape 1/variance (Jakeman and Pusey, IEEE Trans. Antennas Propag. 24,
    1976): the second moment of intensity is 2·(1 + variance). `gamma_of_normal` makes Gamma from Gaussian numbers.

    Args:
        shape: Shape (range, beam) of the image.
        variance: Variance of the mean energy [1].
        key: Source of the random numbers.

    Returns:
        Factor on the energy (range, beam).
    """
    return gamma_of_normal(patchy_normal(shape, key=key), variance)


def gamma_of_normal(normal: Float[Array, "*batch"], variance: Any) -> Float[Array, "*batch"]:
    """Turn standard normal numbers into Gamma numbers of mean 1, monotonically.

    The cube of Wilson and Hilferty (Proc. Natl. Acad. Sci. 17, 1931), accurate for a variance up to 1.

    Args:
        normal: Standard normal numbers (...).
        variance: Variance of the Gamma numbers [1].

    Returns:
        Gamma numbers (...).
    """
    ninth = jnp.asarray(variance, jnp.float32) / 9
    return jnp.maximum(1 - ninth + _safe_sqrt(ninth) * normal, 0.0) ** 3


@full_precision
def patchy_normal(shape: tuple[int, int], *, key: jax.Array) -> Float[Array, "range beam"]:
    """Draw a standard normal field that is interpolated between patches of the size `PATCH`.

    No source: a model of ours for how an uneven bottom varies.

    Args:
        shape: Shape (range, beam) of the image.
        key: Source of the random numbers.

    Returns:
        Standard normal numbers (range, beam).
    """
    coarse = jax.random.normal(key, (shape[0] // PATCH[0] + 2, shape[1] // PATCH[1] + 2))
    rows, columns = (_interpolation(n, step) for n, step in zip(shape, PATCH, strict=True))
    return rows @ coarse @ columns.T


def _interpolation(count: int, step: int) -> Float[Array, "pixel patch"]:
    """Weights of linear interpolation, scaled so that independent normal numbers keep unit variance."""
    place = jnp.arange(count) / step
    weights = jnp.maximum(1 - jnp.abs(place[:, None] - jnp.arange(count // step + 2)), 0.0)
    return weights / jnp.sqrt(jnp.square(weights).sum(axis=1, keepdims=True))
