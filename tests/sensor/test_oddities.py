"""What odd devices and places add: late echoes, ripples, groups of beams, other pings, and how they are drawn."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render import SonarFrame
from sonarjax.sensor import SensorModel, observe, range_middles
from sonarjax.sensor.beams import dim_beams, group_gains, other_pings
from sonarjax.sensor.bottom import ripple_brightness, slow_brightness
from sonarjax.sensor.display import compress
from sonarjax.sensor.model import SELDOM, WIDE
from sonarjax.sensor.propagation import late_reverberation
from sonarjax.sonar import Sonar

SONAR = Sonar.preset("didson-hf", tilt=math.radians(20), range_min=1.8, range_max=2.8, n_ranges=128)


def test_late_echoes_decay_exponentially_and_hold_their_share() -> None:
    image = jnp.zeros((400, 2)).at[20, 0].set(5.0)
    tail = np.asarray(late_reverberation(image, 0.3, 0.1, 0.005))
    assert tail.sum() == pytest.approx(0.3 * 5.0, rel=1e-3)
    assert (tail[:21] == 0).all() and (tail[:, 1] == 0).all()
    assert tail[41, 0] / tail[21, 0] == pytest.approx(math.exp(-20 * 0.005 / 0.1), rel=1e-4)


def test_late_echoes_much_shorter_than_a_bin_arrive_in_the_next_one() -> None:
    tail = np.asarray(late_reverberation(jnp.eye(4, 1), 0.3, 0.002, 0.2))
    assert tail[:, 0] == pytest.approx([0, 0.3, 0, 0], abs=1e-6)


def test_ripples_have_a_derivative_nearer_than_the_sonar_is_high() -> None:
    """No floor is seen there, and the root of its distance would have none."""
    ranges = jnp.linspace(0.5, 2.0, 20)
    slope = jax.grad(lambda height: ripple_brightness(SONAR.replace(height=height), ranges, 0.5, 0.1, 0.0).sum())(0.9)
    assert np.isfinite(slope) and slope != 0


def test_ripples_have_their_wavelength_on_the_floor() -> None:
    ranges = range_middles(SONAR)
    bright = np.asarray(ripple_brightness(SONAR, ranges, 0.5, 0.1, 0.0))
    ground = np.sqrt(np.asarray(ranges) ** 2 - float(SONAR.height) ** 2)
    middle = bright[:, SONAR.n_beams // 2] - 1
    crests = ground[1:-1][(middle[1:-1] > middle[:-2]) & (middle[1:-1] > middle[2:])]
    assert np.diff(crests) == pytest.approx(0.1, abs=0.012)
    assert bright.max() == pytest.approx(1.5, abs=0.01) and bright.mean() == pytest.approx(1.0, abs=0.03)


def test_slow_brightness_is_smooth_and_spreads_in_decibels(key: jax.Array) -> None:
    draws = np.stack([10 * np.log10(slow_brightness((64, 48), 2.0, key=k)) for k in jax.random.split(key, 40)])
    assert draws.std() == pytest.approx(2.0, rel=0.35)
    assert np.abs(np.diff(draws, axis=1)).max() < 0.6


def test_a_firing_group_shares_its_gain(key: jax.Array) -> None:
    gains = np.asarray(group_gains(24, 8.0, 1.0, key=key))
    assert np.array_equal(gains[:8], gains[8:16]) and len(set(gains[:8].tolist())) == 8
    assert (np.asarray(group_gains(24, 8.0, 0.0, key=key)) == 1).all()


def test_dim_beams_lose_what_they_should(key: jax.Array) -> None:
    gains = np.asarray(dim_beams(4000, 0.1, 10.0, key=key))
    assert np.unique(gains) == pytest.approx([0.1, 1.0])
    assert (gains < 1).mean() == pytest.approx(0.1, abs=0.02)


def test_another_ping_is_short_in_range(key: jax.Array) -> None:
    energy = np.asarray(other_pings((200, 48), 3.0, key=key))
    assert 2.0 < energy.max() < 7.0
    assert (energy.max(axis=1) > 0.5 * energy.max()).sum() < 40
    assert not np.asarray(other_pings((200, 48), 0.0, key=key)).any()


def test_saturation_and_black_bend_the_display() -> None:
    energy = jnp.asarray([0.0, 0.01, 0.1, 1.0])
    bent = np.asarray(compress(energy, 0.0, 0.0, 40.0, 0.5, 5.0, 0.0))
    assert bent == pytest.approx(np.arctan(5 * np.sqrt(energy)) / math.atan(5), abs=1e-3)
    cut = np.asarray(compress(energy, 0.0, 0.0, 40.0, 0.5, 0.0, 0.2))
    assert cut == pytest.approx(np.maximum(np.sqrt(energy) - 0.2, 0) / 0.8, abs=1e-4)


def test_wide_draws_fill_their_ranges_and_seldom_fields_are_seldom() -> None:
    models = jax.jit(jax.vmap(lambda k: SensorModel.draw_wide(key=k)))(jax.random.split(jax.random.key(6), 600))
    for name, (low, high, _) in WIDE.items():
        values, nominal = np.asarray(getattr(models, name)), getattr(SensorModel(), name)
        drawn = values[values != np.float32(nominal)] if name in SELDOM else values
        low, high = (0.0, 1.0) if name == "log_share" else (low, high)
        assert low - 1e-4 <= drawn.min() and drawn.max() <= high * (1 + 1e-5), name
        assert np.ptp(drawn) > 0.8 * (high - low), name
        if name in SELDOM:
            assert len(drawn) / len(values) == pytest.approx(SELDOM[name], abs=0.07), name
    assert (np.asarray(models.log_share) == 0).mean() == pytest.approx(0.25, abs=0.07)


def test_each_oddity_alone_changes_a_frame(key: jax.Array) -> None:
    echo = jnp.zeros(SONAR.shape).at[40:60, 40:60].set(1.0)
    shadow = jnp.roll(echo, 20, axis=0)
    floor = SONAR.range_bin / range_middles(SONAR)[:, None] ** 3
    intensity = floor * (1 - shadow) * (1 + 3 * echo)
    frame = SonarFrame(intensity, echo, shadow, intensity > 0, jnp.zeros((), jnp.int32), SONAR)
    see = jax.jit(lambda model: observe(frame, model, key=key))
    plain = np.asarray(see(jax.tree.map(jnp.float32, SensorModel.nominal())))
    for name in sorted(SELDOM.keys() - {"floor_bounce_once"}):  # a bounce is rendered: test_multipath has it
        changed = replace(SensorModel.nominal(), **{name: (WIDE[name][0] + WIDE[name][1]) / 2})
        assert np.abs(np.asarray(see(jax.tree.map(jnp.float32, changed))) - plain).max() > 0.02, name


def test_crests_of_ripples_run_at_right_angles_to_their_direction() -> None:
    r = np.asarray(range_middles(SONAR))
    ground = np.sqrt(r**2 - float(SONAR.height) ** 2)[:, None]
    x, y = ground * np.cos(np.asarray(SONAR.azimuth)), ground * np.sin(np.asarray(SONAR.azimuth))
    expected = 1 + 0.5 * np.sin(2 * np.pi * (x * math.cos(0.6) + y * math.sin(0.6)) / 0.4)
    np.testing.assert_allclose(ripple_brightness(SONAR, jnp.asarray(r), 0.5, 0.4, 0.6), expected, atol=1e-3)
