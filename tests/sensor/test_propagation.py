"""Absorption, gain, elevation pattern, pulse and noise against tables and closed forms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sonarjax.render.energy import floor_energy
from sonarjax.render.window import in_sonar_frame
from sonarjax.scene import Pose, objects
from sonarjax.sensor import (
    absorption_loss,
    elevation_gain,
    floor_elevation,
    fresh_absorption,
    noise_floor,
    pulse_blur,
    range_middles,
    reference_energy,
    reference_range,
    time_varied_gain,
    with_skirts,
)
from sonarjax.sonar import Sonar


@pytest.mark.parametrize(("frequency", "table"), [(0.9e6, 0.21), (1.1e6, 0.31), (1.8e6, 0.84), (3.0e6, 2.34)])
def test_absorption_of_fresh_water_at_15_degrees(frequency: float, table: float) -> None:
    """The viscous term A₃f² of Francois and Garrison (J. Acoust. Soc. Am. 72, 1982, part II), to two decimals."""
    assert float(fresh_absorption(frequency, 15.0)) == pytest.approx(table, abs=0.005)


def test_absorption_falls_with_temperature_and_grows_with_the_square_of_frequency() -> None:
    cold, warm = (float(fresh_absorption(1.8e6, t)) for t in (4.0, 20.0))
    # Francois and Garrison's polynomial, in float64
    for t, found in ((4.0, cold), (20.0, warm)):
        a3 = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.5e-8 * t**3
        assert found == pytest.approx(a3 * 1800**2 / 1000, rel=1e-5)
    assert cold > warm
    assert float(fresh_absorption(3.6e6, 4.0)) == pytest.approx(4 * cold, rel=1e-5)


def test_absorption_loss_in_decibels() -> None:
    share = np.asarray(absorption_loss(jnp.array([1.0, 2.5]), 0.84))
    assert 10 * np.log10(share) == pytest.approx([-1.68, -4.2], abs=1e-4)


def test_gain_undoes_the_loss_that_it_assumes() -> None:
    ranges = jnp.linspace(1.5, 4.0, 50)
    lost = ranges**-4.0 * absorption_loss(ranges, 0.84)
    evened = np.asarray(lost * time_varied_gain(ranges, 2.0, 4.0, 0.84))
    assert evened == pytest.approx(float(2.0**-4 * absorption_loss(jnp.float32(2.0), 0.84)), rel=1e-4)


def test_elevation_is_flat_then_steep() -> None:
    aperture, skirt = math.radians(14), 12.0
    gain = 10 * np.log10(
        np.asarray(elevation_gain(jnp.radians(jnp.array([0.0, 5.0, 7.0, -7.0, 9.0, 10.0])), aperture, skirt))
    )
    assert gain[:2] == pytest.approx([0.0, 0.0], abs=0.02)
    assert gain[2:4] == pytest.approx([-3.01, -3.01], abs=0.01)
    assert gain[5] - gain[4] == pytest.approx(-skirt, abs=0.05)


def test_skirts_end_at_straight_down() -> None:
    """Beyond it the floor comes nearer again, which the renderer does not draw."""
    for tilt_deg, wanted_deg in ((20.0, 20.0), (80.5, 19.0), (83.0, 14.0)):
        sonar = Sonar.preset("didson-hf", tilt=math.radians(tilt_deg), elevation_aperture=math.radians(14.0))
        assert math.degrees(with_skirts(sonar).elevation_aperture) == pytest.approx(wanted_deg, abs=1e-3)


@pytest.mark.parametrize("roll", [0.0, -0.2, 0.1])
@pytest.mark.parametrize("name", ["didson-hf", "aris-3000", "oculus"])
def test_floor_elevation_points_at_the_floor(name: str, roll: float) -> None:
    sonar = Sonar.preset(name, tilt=math.radians(20), roll=roll)
    phi, theta = np.asarray(floor_elevation(sonar), np.float64), np.asarray(sonar.azimuth, np.float64)
    ray = np.stack([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)], axis=-1)
    to_ground = Rotation.from_euler("YX", [float(sonar.tilt), roll]).as_matrix()
    z = float(sonar.height) + np.asarray(range_middles(sonar), np.float64)[:, None] * (ray @ to_ground.T)[..., 2]
    assert np.abs(z).max() < 1e-5


@pytest.mark.parametrize("tilt_deg", [15.0, 25.0])
def test_reference_energy_is_the_renderer_s_on_the_beam_axis(tilt_deg: float) -> None:
    sonar = Sonar.preset("didson-hf", tilt=math.radians(tilt_deg), absorption=0.5, lambert=1.0)
    scene = in_sonar_frame(objects.brick(), Pose(), sonar)
    edges = reference_range(sonar) + sonar.range_bin * jnp.array([-0.5, 0.5])
    energy = floor_energy(jnp.zeros(1), scene, sonar, edges)
    # the renderer's difference of two arccosines in float32 is good to about 1 %
    assert float(reference_energy(sonar)) == pytest.approx(float(energy[0, 0]), rel=0.01)


@pytest.mark.parametrize("length", [1.0, 2.5, 4.0, 9.0])
def test_pulse_spreads_a_point_evenly_and_keeps_its_energy(length: float) -> None:
    image = jnp.zeros((40, 3)).at[20].set(1.0)
    blurred = np.asarray(pulse_blur(image, length))[:, 1]
    # the share of each bin that a pulse of this length around the point's bin covers
    bins = np.arange(40) - 20
    covered = np.clip(np.minimum(bins + 0.5, length / 2) - np.maximum(bins - 0.5, -length / 2), 0, None) / length
    assert blurred == pytest.approx(covered, abs=1e-6)
    assert blurred.sum() == pytest.approx(1.0, abs=1e-6)
    assert np.asarray(pulse_blur(jnp.ones((40, 3)), length)) == pytest.approx(1.0, abs=1e-6)


def test_noise_grows_with_the_square_of_range() -> None:
    assert np.asarray(noise_floor(jnp.array([1.0, 2.0, 4.0]), 0.1, 4.0)) == pytest.approx(
        [0.00625, 0.025, 0.1], rel=1e-6
    )


def test_everything_has_finite_slopes() -> None:
    sonar = Sonar.preset("didson-hf", n_ranges=64).replace(azimuth=jnp.linspace(-0.2, 0.2, 8))

    @jax.jit
    def total(tilt: jax.Array, pulse: jax.Array, temperature: jax.Array, skirt: jax.Array) -> jax.Array:
        tilted = sonar.replace(tilt=tilt)
        gain = elevation_gain(floor_elevation(tilted), sonar.elevation_aperture, skirt)
        loss = absorption_loss(range_middles(tilted), fresh_absorption(sonar.frequency, temperature))
        image = pulse_blur(gain * loss[:, None], pulse)
        return jnp.square(image).mean() / reference_energy(tilted)

    at = tuple(jnp.float32(v) for v in (0.3, 2.3, 12.0, 11.0))
    slopes = jax.grad(total, argnums=(0, 1, 2, 3))(*at)
    for k, (value, slope) in enumerate(zip(at, slopes, strict=True)):
        step = 3e-3 * float(value)
        above, below = (total(*at[:k], value + sign * step, *at[k + 1 :]) for sign in (1, -1))
        assert float(slope) == pytest.approx(float(above - below) / (2 * step), rel=0.02)
