"""`observe` and `SensorModel`: reproducible, noise-free at severity 0, one compilation for a family, differentiable."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.render import RenderQuality, SonarFrame, render
from sonarjax.scene import Pose
from sonarjax.scene.objects import brick
from sonarjax.sensor import (
    SensorModel,
    absorption_loss,
    compress,
    elevation_gain,
    floor_elevation,
    observe,
    observe_scene,
    range_middles,
    received_energy,
    reference_range,
    with_skirts,
)
from sonarjax.sensor.model import FLOOR_HEARD, RANGES, SCALED, SURFACE_HEARD, WIDE
from sonarjax.sonar import Sonar

ROWS, BEAMS = slice(60, 80), slice(18, 30)  # of an object, and its shadow behind
SHADOW = slice(80, 110)


def sonar_of(name: str) -> Sonar:
    """Part of a device's beams, in 160 bins about the place where the beam axis meets the floor."""
    sonar = Sonar.preset(name, tilt=math.radians(25), range_min=1.7, range_max=2.6, n_ranges=160)
    return sonar.replace(azimuth=sonar.azimuth[:48])


def frame_of(sonar: Sonar) -> SonarFrame:
    """Flat floor (h·Δr/(r⁴·cos) as the renderer has it) with a bright block and its shadow; nothing is rendered."""
    r = range_middles(sonar)[:, None] * jnp.ones(sonar.shape)
    floor = sonar.height * sonar.range_bin / (r**3 * jnp.sqrt(r**2 - sonar.height**2))
    highlight = jnp.zeros(sonar.shape).at[ROWS, BEAMS].set(1.0)
    shadow = jnp.zeros(sonar.shape).at[SHADOW, BEAMS].set(1.0)
    intensity = floor * (1 - shadow) * (1 + 3 * highlight)
    return SonarFrame(intensity, highlight, shadow, intensity > 0, jnp.zeros((), jnp.int32), sonar)


SONAR = sonar_of("didson-hf")
FRAME = frame_of(SONAR)
look = jax.jit(observe)
heard = jax.jit(received_energy)


def traced(model: SensorModel) -> SensorModel:
    """Whatever the numbers were, as arrays: models of all tests share compiled code."""
    return jax.tree.map(jnp.float32, model)


def seen(severity: float, key: jax.Array) -> np.ndarray:
    return np.asarray(look(FRAME, traced(SensorModel.nominal(severity)), key=key))


def test_same_key_same_image_other_key_other_image(key: jax.Array) -> None:
    first, again, other = seen(1.0, key), seen(1.0, key), seen(1.0, jax.random.key(1))
    assert np.array_equal(first, again)
    assert (first != other).mean() > 0.9


def test_severity_zero_is_noise_free(key: jax.Array) -> None:
    first, other = seen(0.0, key), seen(0.0, jax.random.key(1))
    assert np.array_equal(first, other)
    assert first[84:106, 21:27].max() < 0.05  # side lobes alone
    floor = first[112:150, :10]
    assert np.ptp(floor) < 0.05
    assert first[65:75, 21:27].mean() > floor.mean() + 0.2


def test_noise_grows_with_severity(key: jax.Array) -> None:
    clean = seen(0.0, key)
    errors = [np.sqrt(np.mean((seen(s, key) - clean) ** 2)) for s in (0.25, 0.5, 1.0, 1.5, 2.0)]
    assert (np.diff(errors) > 0).all()


def test_image_is_in_256_steps_and_its_parts_in_order(key: jax.Array) -> None:
    image = seen(1.0, key)
    assert image.shape == SONAR.shape and image.dtype == np.float32
    assert image.min() >= 0 and image.max() <= 1
    assert np.abs(255 * image - np.rint(255 * image)).max() < 1e-4
    parts = [image[SHADOW, 20:28], image[112:150], image[ROWS, 20:28]]
    assert parts[0].mean() + 0.1 < parts[1].mean() < parts[2].mean() - 0.15
    assert parts[1].std() > 0.05  # the floor is visible and speckled


def test_floor_follows_the_elevation_pattern() -> None:
    """Without gain errors a flat floor shows nothing but the vertical pattern."""
    model = replace(SensorModel.nominal(0.0), tvg_exponent=4.0, tvg_absorption=1.0, pulse_bins=1.0, beam_widening=1e-3)
    r = range_middles(SONAR)[:, None] * jnp.ones(SONAR.shape)
    bare = SONAR.height * SONAR.range_bin / (r**3 * jnp.sqrt(r**2 - SONAR.height**2))
    empty = replace(FRAME, intensity=bare, highlight=0 * bare, shadow=0 * bare, lit=bare > 0)
    expected = elevation_gain(floor_elevation(SONAR), SONAR.elevation_aperture, model.elevation_skirt)
    slant = np.sqrt(1 - (float(SONAR.height) / np.asarray(r)) ** 2)
    found = np.asarray(heard(empty, traced(model))) * slant / math.cos(math.radians(25))
    assert found == pytest.approx(np.asarray(expected), rel=2e-3)


@pytest.mark.slow
def test_the_floor_fades_beyond_the_aperture_instead_of_ending() -> None:
    """Of a rendered empty tank, on the middle beams: the skirt's closed form to 2.5° beyond, where a template is 0."""
    model = replace(SensorModel.nominal(0.0), tvg_exponent=4.0, tvg_absorption=1.0, pulse_bins=1.0, beam_widening=1e-3)
    sonar = Sonar.preset("didson-hf", tilt=math.radians(25))
    beyond = np.degrees(np.abs(np.asarray(floor_elevation(sonar))) - float(sonar.elevation_aperture) / 2)
    chosen = (beyond > 0.5) & (beyond < 2.5) & (np.abs(np.asarray(sonar.azimuth)) < math.radians(2))
    assert chosen.sum() > 200
    far = Pose(x=50.0)
    sharp, wide = (render(brick(), far, s, quality=RenderQuality(1)) for s in (sonar, with_skirts(sonar)))
    assert not np.asarray(sharp.intensity)[chosen].any()
    slant = np.sqrt(1 - (float(sonar.height) / np.asarray(range_middles(sonar))[:, None]) ** 2)
    found = np.asarray(received_energy(replace(wide, sonar=sonar), model)) * slant / math.cos(math.radians(25))
    expected = np.asarray(elevation_gain(floor_elevation(sonar), sonar.elevation_aperture, model.elevation_skirt))
    assert 10 * np.log10(found[chosen] / expected[chosen]) == pytest.approx(0.0, abs=0.5)


def test_mixing_moves_energy_but_adds_none() -> None:
    """Pulse, pattern and crosstalk on an even image change nothing; on the scene they keep its mean."""
    plain = replace(SensorModel.nominal(0.0), pulse_bins=1.0, beam_widening=1e-3)
    mixed = replace(plain, pulse_bins=4.0, beam_widening=1.5, crosstalk=0.05)
    before, after = (np.asarray(heard(FRAME, traced(m)), np.float64) for m in (plain, mixed))
    assert after.sum() == pytest.approx(before.sum(), rel=0.01)  # what crosses the window's edge is replaced
    assert np.abs(after - before).max() > 0.5


@pytest.mark.parametrize("name", ["aris-1800", pytest.param("oculus", marks=pytest.mark.slow)])
def test_one_compilation_serves_a_batch_of_devices_and_keys(name: str, key: jax.Array) -> None:
    """Models and keys batch under vmap and jit, on uneven beam tables, and agree with one at a time."""
    sonar = sonar_of(name)
    frame = frame_of(sonar)
    keys = jax.random.split(key, 3)
    models = jax.vmap(lambda k: SensorModel.draw(key=k))(keys)
    batch = jax.jit(jax.vmap(lambda m, k: observe(frame, m, key=k)))(models, keys)
    assert batch.shape == (3, *sonar.shape) and bool(jnp.isfinite(batch).all())
    single = look(frame, jax.tree.map(lambda v: v[1], models), key=keys[1])
    assert np.abs(np.asarray(batch[1]) - np.asarray(single)).max() <= 1.01 / 255
    assert len({float(image.mean()) for image in batch}) == 3


@pytest.mark.parametrize("name", ["gain", "object_gain", "noise"])
def test_a_model_of_arrays_is_refused(name: str, key: jax.Array) -> None:
    """As many values as beams would be taken for those of the beams, without a word."""
    for count in (1, SONAR.n_beams, 4):
        model = SensorModel(**{name: jnp.ones(count)})
        with pytest.raises(SonarjaxError, match=f"model: {name}: expected one number"):
            observe(FRAME, model, key=key)
        with pytest.raises(SonarjaxError, match=f"model: {name}: expected one number"):
            observe_scene(brick(), Pose(x=2.0), SONAR, model, key=key)


def test_a_batch_of_models_or_bounces_is_refused(key: jax.Array) -> None:
    models = jax.vmap(lambda k: SensorModel.draw(key=k))(jax.random.split(key, 3))
    with pytest.raises(SonarjaxError, match="expected one number, got shape .3,.: use jax.vmap"):
        observe(FRAME, models, key=key)
    stacked = jax.tree.map(lambda v: jnp.stack([v, v]), FRAME)
    with pytest.raises(SonarjaxError, match="bounces: expected shape"):
        observe(FRAME, SensorModel(), key=key, bounces=stacked)


def test_nominal_is_the_default_and_scales() -> None:
    base, twice = SensorModel(), SensorModel.nominal(2.0)
    for field in fields(SensorModel):
        scale = 2.0 if field.name in SCALED else 1.0
        assert getattr(twice, field.name) == pytest.approx(scale * getattr(base, field.name))
        assert getattr(SensorModel.nominal(), field.name) == getattr(base, field.name)


def test_draws_fill_their_ranges_around_the_nominal_device() -> None:
    draw = jax.jit(jax.vmap(lambda k: SensorModel.draw(key=k)))
    models, again = (draw(jax.random.split(jax.random.key(5), 400)) for _ in range(2))
    assert set(RANGES) | set(WIDE) == {field.name for field in fields(SensorModel)}
    for name, (low, high, _) in RANGES.items():
        values = np.asarray(getattr(models, name))
        assert np.array_equal(values, np.asarray(getattr(again, name)))
        spoken = values[values > 0]
        margin = 1e-5 * high + (0.5 if name == "crosstalk_period" else 0.0)
        assert spoken.min() >= low - margin and spoken.max() <= high + margin
        assert np.ptp(spoken) > 0.9 * (high - low)
        assert low <= getattr(SensorModel(), name) <= high
    assert abs(np.corrcoef(models.floor_lambert, models.speckle)[0, 1]) < 0.2  # each number of its own key
    heard = np.mean(np.asarray([models.floor_bounce, models.surface_bounce]) > 0, axis=1)
    assert heard == pytest.approx([FLOOR_HEARD, SURFACE_HEARD], abs=0.1)


def test_received_energy_differentiates_in_the_model() -> None:
    names = ("object_gain", "pulse_bins", "beam_widening", "tvg_exponent", "temperature", "elevation_skirt", "streak")

    @jax.jit
    @jax.value_and_grad
    def loss(values: jax.Array) -> jax.Array:
        model = replace(SensorModel.nominal(), **dict(zip(names, values, strict=True)))
        return jnp.square(received_energy(FRAME, model)).mean()

    at = jnp.array([getattr(SensorModel(), name) for name in names])
    value, slopes = (np.asarray(v) for v in loss(at))
    for k, name in enumerate(names):
        step = jnp.zeros(len(names)).at[k].set(0.01 * at[k])
        expected = float(loss(at + step)[0] - loss(at - step)[0]) / float(0.02 * at[k])
        assert slopes[k] != 0
        assert slopes[k] == pytest.approx(expected, rel=0.05, abs=1e-5 * float(value / at[k])), name


@jax.jit
@partial(jax.grad, argnums=(0, 1, 2))
def mean_slopes(model: SensorModel, intensity: jax.Array, tilt: jax.Array, key: jax.Array) -> jax.Array:
    frame = replace(FRAME, intensity=intensity, sonar=SONAR.replace(tilt=tilt))
    return observe(frame, model, key=key).mean()


@pytest.mark.parametrize("severity", [0.0, 1.0, 2.0])
def test_observe_has_finite_slopes_in_everything(key: jax.Array, severity: float) -> None:
    model = jax.tree.map(jnp.float32, SensorModel.nominal(severity))
    slopes = mean_slopes(model, FRAME.intensity, jnp.float32(0.4), key)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slopes))
    assert float(slopes[0].gain) < 0  # the more room below white, the darker


def test_a_full_automatic_gain_takes_a_brighter_frame_for_the_same(key: jax.Array) -> None:
    model = traced(replace(SensorModel.nominal(0.0), automatic_gain=1.0, noise=0.0))
    image = np.asarray(look(FRAME, model, key=key))
    brighter = np.asarray(look(replace(FRAME, intensity=4 * FRAME.intensity), model, key=key))
    assert image.std() > 0.05
    np.testing.assert_allclose(brighter, image, atol=1.01 / 255)


def test_bounces_have_the_objects_backscatter() -> None:
    bounces, added = replace(FRAME, intensity=0.1 * FRAME.intensity), []
    for gain in (0.0, 6.0):  # [dB]
        model = traced(replace(SensorModel.nominal(0.0), object_gain=gain, streak=0.0))
        added.append(np.asarray(heard(FRAME, model, bounces)) - np.asarray(heard(FRAME, model)))
    assert added[1].sum() / added[0].sum() == pytest.approx(10**0.6, rel=1e-3)


def test_absorption_that_was_rendered_is_not_counted_twice() -> None:
    model = traced(replace(SensorModel.nominal(0.0), tvg_absorption=0.0))
    left = absorption_loss(range_middles(SONAR), 0.8)[:, None]
    rendered = replace(FRAME, intensity=FRAME.intensity * left, sonar=SONAR.replace(absorption=0.8))
    np.testing.assert_allclose(heard(rendered, model), heard(FRAME, model), rtol=2e-3, atol=1e-6)


def test_noise_is_that_of_the_model_where_the_beam_axis_meets_the_floor(key: jax.Array) -> None:
    model = replace(SensorModel.nominal(0.0), noise=0.3, automatic_gain=0.0)
    dark = replace(FRAME, intensity=jnp.zeros(SONAR.shape), highlight=jnp.zeros(SONAR.shape))
    image = np.asarray(look(dark, traced(model), key=key))
    row = int(np.abs(np.asarray(range_middles(SONAR)) - float(reference_range(SONAR))).argmin())
    law = model.gain, model.log_share, model.dynamic_range, model.exponent
    np.testing.assert_allclose(image[row], float(compress(jnp.float32(0.3), *law)), atol=1.5 / 255)
