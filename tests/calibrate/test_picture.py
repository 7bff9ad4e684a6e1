"""The picture that calibration fits: against plane geometry, the simulator and NumPy's least squares."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate.picture import LOOK, UNEVEN_STD, fitted, floor_elevation, make_sampling, picture
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sensor import propagation
from sonarjax.sensor.beams import beam_mixing

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), n_ranges=64)


def test_floor_elevation_is_the_simulators_without_roll() -> None:
    ranges = propagation.range_middles(SONAR)
    np.testing.assert_allclose(floor_elevation(SONAR, ranges), propagation.floor_elevation(SONAR), atol=2e-6)


@pytest.mark.parametrize("roll", [-0.2, 0.1])
def test_rays_at_the_floors_elevation_meet_the_floor(roll: float) -> None:
    sonar = SONAR.replace(roll=roll)
    ranges = np.asarray(propagation.range_middles(sonar), np.float64)
    phi = np.asarray(floor_elevation(sonar, jnp.asarray(ranges, jnp.float32)), np.float64)
    theta = np.asarray(sonar.azimuth, np.float64)[None]
    ray = np.stack([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)], axis=-1)
    to_ground = np.asarray(rotation_y(sonar.tilt) @ rotation_x(roll), np.float64)
    z = float(sonar.height) + ranges[:, None] * (ray @ to_ground.T)[..., 2]
    np.testing.assert_allclose(z, 0.0, atol=1e-5)


def test_bare_floor_is_as_bright_as_the_simulator_has_it() -> None:
    """Energy of the floor by the vertical pattern, pulse and beams, without noise; slopes are free in the picture."""
    layers = jnp.zeros((2, 3, 64, 16))
    look = LOOK._replace(noise=-30.0, exponent=math.log(1 - 0.02))  # energy itself
    drawn = np.asarray(picture(SONAR, look, layers, jnp.zeros(()), jnp.int32(10), 2.5)) + 1
    lit = propagation.elevation_gain(propagation.floor_elevation(SONAR), SONAR.elevation_aperture, look.skirt)
    expected = propagation.pulse_blur(lit, look.pulse) @ beam_mixing(SONAR, look.widening, 2.0).T
    np.testing.assert_allclose(drawn, expected, atol=1e-4)


def test_shadow_is_dark_and_echo_is_bright() -> None:
    layers = jnp.zeros((2, 3, 64, 16)).at[0, 2, 20:30, 4:10].set(1.0).at[0, 0, 10:14, 4:10].set(0.05)
    bare = np.asarray(picture(SONAR, LOOK, jnp.zeros_like(layers), jnp.zeros(()), jnp.int32(40), 2.5))
    seen = np.asarray(picture(SONAR, LOOK, layers, jnp.zeros(()), jnp.int32(40), 2.5))
    assert (seen[22:28, 46:48] < bare[22:28, 46:48]).all() and (seen[11:13, 46:48] > bare[11:13, 46:48]).all()
    np.testing.assert_allclose(seen[:, :30], bare[:, :30], atol=0.02)  # but for the beams' side lobes


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
