"""The picture that calibration fits: against plane geometry, the simulator and NumPy's least squares."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate.look import LOOK, sensor_of
from sonarjax.calibrate.picture import (
    UNEVEN_STD,
    clipped,
    fitted,
    leaking,
    make_sampling,
    measured_mean,
    object_layers,
    picture,
    placed,
    stored,
)
from sonarjax.render import WindowSize
from sonarjax.sensor import SensorModel, compress, propagation
from sonarjax.sensor.beams import beam_mixing
from sonarjax.sensor.observe import received_energy

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), n_ranges=64)


def test_bare_floor_is_as_bright_as_the_simulator_has_it() -> None:
    """Energy of the floor by the vertical pattern, pulse and beams, without noise; slopes are free in the picture."""
    layers = jnp.zeros((2, 3, 64, SONAR.n_beams))
    quiet = {"noise": -30.0, "dark": -30.0, "white": 30.0, "leak": -30.0, "streak": -30.0}
    look = LOOK._replace(exponent=math.log(1 - 0.02), log_share=0.0, **quiet)  # energy itself
    drawn = np.asarray(picture(SONAR, look, layers, jnp.zeros(()), 2.5)) + 1
    lit = propagation.elevation_gain(propagation.floor_elevation(SONAR), SONAR.elevation_aperture, look.skirt)
    expected = (
        np.asarray(propagation.pulse_blur(lit, look.pulse)) @ np.asarray(beam_mixing(SONAR, look.widening, 2.0)).T
    )
    np.testing.assert_allclose(drawn, expected, atol=1e-4)


def test_shadow_is_dark_and_echo_is_bright() -> None:
    window = jnp.zeros((2, 3, 64, 16)).at[0, 2, 20:30, 4:10].set(1.0).at[0, 0, 10:14, 4:10].set(0.05)
    layers = placed(window, jnp.int32(40), SONAR.n_beams)
    look = LOOK._replace(leak=-30.0, streak=-30.0)
    bare = np.asarray(picture(SONAR, look, jnp.zeros_like(layers), jnp.zeros(()), 2.5))
    seen = np.asarray(picture(SONAR, look, layers, jnp.zeros(()), 2.5))
    assert (seen[22:28, 46:48] < bare[22:28, 46:48]).all() and (seen[11:13, 46:48] > bare[11:13, 46:48]).all()
    np.testing.assert_allclose(seen[:, :30], bare[:, :30], atol=0.02)  # but for the beams' side lobes


def test_no_look_gives_what_is_not_a_number() -> None:
    """An object where the vertical pattern hears nothing, with a `rim` beyond its range."""
    layers = jnp.zeros((2, 3, 64, SONAR.n_beams)).at[0, :2, :4, 14:20].set(jnp.asarray([0.05, 1.0])[:, None, None])
    look = jax.tree.map(jnp.float32, LOOK._replace(rim=2.0))

    def drawn(at):
        return picture(SONAR, at, layers, jnp.zeros(()), 2.5)

    assert np.isfinite(drawn(look)).all()
    for name, slope in jax.jacfwd(drawn)(look)._asdict().items():
        assert np.isfinite(slope).all(), name


@pytest.mark.slow
def test_the_simulators_mean_energy_is_the_pictures() -> None:
    """With its way to mix object and floor (`rim` 1), its pulse and beams, and none of what is random or leaks."""
    device = replace(SensorModel.nominal(0.0), tvg_exponent=3.0, tvg_absorption=1.0)
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
    mesh, pose = sj.objects.target(), sj.Pose(*(np.float32(v) for v in (2.3, 0.1, 0.7)))
    frame = replace(sj.render(mesh, pose, propagation.with_skirts(sonar)), sonar=sonar)
    wanted = np.asarray(received_energy(frame, device))
    layers = object_layers(mesh, sonar, pose, jnp.zeros(3), 1.0, jnp.int32(0), WindowSize(sonar.shape, sonar.n_beams))
    quiet = {"noise": -30.0, "dark": -30.0, "white": 30.0, "leak": -30.0, "streak": -30.0}
    look = LOOK._replace(exponent=math.log(1 - 0.02), log_share=0.0, rim=1.0, **quiet)
    drawn = np.asarray(picture(sonar, look, layers, jnp.zeros(()), 2.5)) + 1
    bright = wanted > 3
    # The floor's slope in range is free in the picture: compare with bare floor at the same range.
    floors = [np.maximum(v[:, :10].mean(axis=1, keepdims=True), 1e-9) for v in (drawn, wanted)]
    off = np.abs(drawn / floors[0] * floors[1] / np.maximum(wanted, 1e-9) - 1)[bright]
    assert bright.sum() > 300 and np.median(off) < 0.02 and np.percentile(off, 95) < 0.3  # rims


def test_leak_keeps_the_energy_and_reaches_beams_nearby() -> None:
    mixing = np.asarray(leaking(96, jnp.asarray(0.1)))
    np.testing.assert_allclose(mixing.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.diag(mixing), 1 / 1.1, rtol=1e-6)
    assert mixing[40, 43] > mixing[40, 60] > 0 and mixing[40, 41] == 0
    for few in (1, 4, 5):  # a beam without others that it could hear keeps its own energy
        np.testing.assert_allclose(np.asarray(leaking(few, jnp.asarray(0.1))).sum(axis=1), 1.0, rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_display_law_is_that_of_the_sensor_it_is_reported_as(share: float) -> None:
    look = LOOK._replace(log_share=share, exponent=math.log(0.35), white=4.0, dark=-5.0)
    device = sensor_of(look)
    energy = jnp.exp(jnp.linspace(-4.5, 3.5, 50))  # between black and white
    grey = np.asarray(compress(energy, device.gain, device.log_share, device.dynamic_range, device.exponent))
    law = np.asarray(stored(energy, look))
    factor, offset = np.polyfit(law, grey, 1)
    assert factor > 0
    np.testing.assert_allclose(factor * law + offset, grey, atol=1e-4)


def test_black_and_white_bound_the_energy() -> None:
    energy = jnp.asarray([1e-6, 1.0, 1e6])
    np.testing.assert_allclose(clipped(energy, 0.01, 100.0), [0.01, 1.0, 100.0], rtol=2e-3)


def test_offset_factor_and_slow_changes_are_least_squares() -> None:
    rng = np.random.default_rng(0)
    drawn, weight = rng.normal(size=(12, 9)), rng.uniform(0.5, 2.0, (12, 9))
    down, across = np.linspace(-1, 1, 12)[:, None], np.linspace(-1, 1, 9)[None]
    slow = [down + 0 * across, across + 0 * down, across**2 - 1 / 3 + 0 * down, down * across]
    seen = 0.3 + 0.7 * drawn + 0.01 * slow[0] + rng.normal(scale=0.1, size=(12, 9))
    basis = np.stack([np.ones_like(drawn), drawn, *slow]).reshape(6, -1)
    rows = np.concatenate([(basis * np.sqrt(weight.reshape(-1))).T, np.diag([0, 0, *[1 / UNEVEN_STD] * 4])])
    wanted = np.linalg.lstsq(rows, np.concatenate([(seen * np.sqrt(weight)).reshape(-1), np.zeros(6)]), rcond=None)[0]
    found = fitted(*(jnp.asarray(v, jnp.float32) for v in (drawn, seen, weight)))
    np.testing.assert_allclose(found, (wanted @ basis).reshape(12, 9), atol=2e-4)


def test_sampling_keeps_what_is_constant() -> None:
    sampling = make_sampling((64, 96), 2.0)
    np.testing.assert_allclose(sampling(jnp.full((64, 96), 0.7)), np.full((16, 48), 0.7), rtol=1e-5)


def test_what_was_not_measured_does_not_count() -> None:
    """Where all is measured it is the sampling itself; where a part is, whatever stands in the rest changes nothing."""
    rng = np.random.default_rng(4)
    sampling = make_sampling((64, 32), 2.0)
    image, mask = rng.normal(size=(2, 64, 32)).astype(np.float32)
    np.testing.assert_allclose(measured_mean(sampling, image, np.ones_like(image)), sampling(image), atol=1e-5)
    mask = (mask > 0).astype(np.float32)
    other = np.where(mask > 0, image, 100.0).astype(np.float32)
    np.testing.assert_array_equal(measured_mean(sampling, image, mask), measured_mean(sampling, other, mask))
    level = measured_mean(sampling, np.full((64, 32), 0.7, np.float32), mask)
    np.testing.assert_allclose(level, 0.7, rtol=1e-5)  # up to the mask's edge
