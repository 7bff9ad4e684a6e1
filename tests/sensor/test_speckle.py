"""Speckle against its closed-form laws (Rayleigh, Rice, Gamma, K, Weibull) and its measured correlation."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from sonarjax.sensor import (
    azimuth_kernel,
    complex_field,
    correlate,
    gamma_of_normal,
    gamma_texture,
    heavy_tails,
    multi_look,
    patchy_normal,
    range_kernel,
    speckle_intensity,
)
from sonarjax.sensor.speckle import look_weights
from sonarjax.sonar import Sonar

SHAPE = (512, 96)
KS_LIMIT = 1.63 / math.sqrt(SHAPE[0] * SHAPE[1])  # Kolmogorov and Smirnov's distance at the 1 % level


def white(key: jax.Array) -> jax.Array:
    return complex_field(SHAPE, key=key)


def lag_one(values: np.ndarray, axis: int) -> float:
    """Correlation coefficient of neighbours along an axis."""
    first, second = np.moveaxis(values, axis, 0)[:-1], np.moveaxis(values, axis, 0)[1:]
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def test_amplitude_is_rayleigh_and_intensity_exponential(key: jax.Array) -> None:
    intensity = np.asarray(speckle_intensity(white(key))).ravel()
    amplitude = np.sqrt(intensity)
    assert stats.kstest(intensity, stats.expon.cdf).statistic < KS_LIMIT
    assert stats.kstest(amplitude, stats.rayleigh(scale=math.sqrt(0.5)).cdf).statistic < KS_LIMIT
    assert amplitude.var() / amplitude.mean() ** 2 == pytest.approx(4 / math.pi - 1, rel=0.02)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_short_frames_have_speckle_of_mean_one(key: jax.Array, rows: int) -> None:
    fields = [complex_field((rows, 200), key=one) for one in jax.random.split(key, 100)]
    mixed = [correlate(field, jnp.eye(200), range_kernel(0.25)) for field in fields]
    assert np.mean([speckle_intensity(one) for one in mixed]) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("diffuse", [0.25, 0.7])
def test_partly_developed_speckle_is_rice(key: jax.Array, diffuse: float) -> None:
    intensity = np.asarray(speckle_intensity(white(key), diffuse)).ravel()
    # 2I/diffuse is non-central chi-squared with two degrees of freedom
    law = stats.ncx2(df=2, nc=2 * (1 - diffuse) / diffuse, scale=diffuse / 2)
    assert stats.kstest(intensity, law.cdf).statistic < KS_LIMIT
    assert intensity.var() == pytest.approx(1 - (1 - diffuse) ** 2, rel=0.03)


def test_no_diffuse_share_is_exactly_one(key: jax.Array) -> None:
    assert np.all(np.asarray(speckle_intensity(white(key), 0.0)) == 1.0)


@pytest.mark.parametrize("looks", [1, 2, 3, 4])
def test_looks_are_gamma(key: jax.Array, looks: int) -> None:
    intensity = np.asarray(multi_look(speckle_intensity(white(key)), float(looks))).ravel()
    limit = KS_LIMIT * math.sqrt(looks)  # each number is in that many pixels, so fewer are independent
    assert stats.kstest(intensity, stats.gamma(looks, scale=1 / looks).cdf).statistic < limit


@pytest.mark.parametrize("looks", [1.0, 1.3, 2.0, 2.5, 3.9, 4.0])
def test_any_number_of_looks_divides_the_variance(looks: float) -> None:
    weights = np.asarray(look_weights(looks), np.float64)
    assert weights.sum() == pytest.approx(1.0, abs=1e-6)
    assert 1 / (weights**2).sum() == pytest.approx(looks, rel=1e-5)


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
def test_heavy_tails_are_weibull_of_mean_one(key: jax.Array, power: float) -> None:
    intensity = np.asarray(heavy_tails(speckle_intensity(white(key)), power)).ravel()
    law = stats.weibull_min(1 / power, scale=1 / math.gamma(1 + power))
    assert stats.kstest(intensity, law.cdf).statistic < KS_LIMIT
    assert intensity.mean() == pytest.approx(1.0, rel=0.04)
    spread = 10 * np.log10(intensity)
    # ln of an exponential variate has the standard deviation π/√6
    assert spread.std() == pytest.approx(power * 10 / math.log(10) * math.pi / math.sqrt(6), rel=0.02)


@pytest.mark.parametrize("variance", [0.05, 0.3, 1.0])
def test_texture_of_independent_normals_is_gamma(rng: np.random.Generator, variance: float) -> None:
    texture = np.asarray(gamma_of_normal(jnp.asarray(rng.standard_normal(100_000), jnp.float32), variance))
    # Wilson and Hilferty's cube is an approximation: 1.3 % of probability at the worst shape here
    assert stats.kstest(texture, stats.gamma(1 / variance, scale=variance).cdf).statistic < 0.015
    assert texture.mean() == pytest.approx(1.0, abs=0.01)


def test_speckle_on_patches_has_the_second_moment_of_k() -> None:
    variance, moments, deviations = 0.4, [], []
    for seed in range(30):  # few patches fit in a frame
        field, texture = (jax.random.key(n) for n in (seed, 1000 + seed))
        patches = gamma_texture(SHAPE, variance, key=texture)
        intensity = np.asarray(patches * speckle_intensity(complex_field(SHAPE, key=field)))
        moments.append([intensity.mean(), (intensity**2).mean()])
        deviations.append(float(patchy_normal(SHAPE, key=texture).std()))
    mean, square = np.mean(moments, axis=0)
    assert square / mean**2 == pytest.approx(2 * (1 + variance), rel=0.05)
    assert np.mean(deviations) == pytest.approx(1.0, abs=0.03)


def test_correlation_of_an_oculus_is_the_measured_one() -> None:
    """Measured on real far-field frames: 0.60 in azimuth, 0.06 in range, 1/e at 1.5 beams (our physics notes)."""
    sonar = Sonar.preset("oculus", azimuth=np.radians(np.arange(-40, 40) * 0.25))
    kernels = azimuth_kernel(sonar, 0.99), range_kernel(0.06)
    found = []
    for seed in range(4):
        field = complex_field((1024, sonar.n_beams), key=jax.random.key(seed))
        intensity = np.asarray(speckle_intensity(correlate(field, *kernels)))
        centred = intensity - intensity.mean()
        lags = [(centred[:, : -k or None] * centred[:, k:]).mean() / centred.var() for k in range(4)]
        found.append([lag_one(intensity, 1), lag_one(intensity, 0), lags[2], intensity.mean(), intensity.var()])
    azimuth, along, lag_two, mean, variance = np.mean(found, axis=0)
    assert azimuth == pytest.approx(0.60, abs=0.01)
    assert along == pytest.approx(0.06, abs=0.01)
    assert lag_two == pytest.approx(math.exp(-(2**2) / (2 * 0.99**2)), abs=0.015)
    assert (mean, variance) == (pytest.approx(1.0, abs=0.01), pytest.approx(1.0, abs=0.03))
    assert 0.99 * math.sqrt(2) == pytest.approx(1.5, abs=0.15)  # where exp(−n²/(2·0.99²)) is 1/e


@pytest.mark.parametrize("reach", [0.9, 1.0, 1.5])
def test_azimuth_kernel_gives_the_stated_correlation(reach: float) -> None:
    sonar = Sonar.preset("didson-hf")
    kernel = np.asarray(azimuth_kernel(sonar, reach), np.float64)
    covariance = kernel @ kernel.T
    assert np.allclose(np.diag(covariance), 1.0, atol=1e-5)
    for lag in (1, 2, 3):
        assert covariance[48, 48 + lag] ** 2 == pytest.approx(math.exp(-(lag**2) / (2 * reach**2)), abs=5e-3)


def test_azimuth_kernel_follows_an_uneven_table() -> None:
    sonar = Sonar.preset("aris-1800")
    kernel = np.asarray(azimuth_kernel(sonar, 1.0), np.float64)
    correlation = np.diag((kernel @ kernel.T) ** 2, k=1)
    spacing = np.diff(np.asarray(sonar.azimuth, np.float64))
    expected = np.exp(-((spacing / spacing.mean()) ** 2) / 2)
    assert np.allclose(correlation[5:-5], expected[5:-5], atol=0.02)
    assert correlation[8] > correlation[47] + 0.05  # beams lie closer at the edge, so speckle is alike there


@pytest.mark.parametrize("correlation", [0.0, 0.06, 0.3, 0.49])
def test_range_kernel_gives_the_stated_correlation(correlation: float) -> None:
    kernel = np.asarray(range_kernel(correlation), np.float64)
    assert (kernel**2).sum() == pytest.approx(1.0, abs=1e-5)
    assert (kernel[:-1] * kernel[1:]).sum() ** 2 == pytest.approx(correlation, abs=1e-4)
