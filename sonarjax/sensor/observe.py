"""`observe` turns a rendered frame into what a device would store; `observe_scene` also renders frame and multipath."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, shown
from sonarjax.render import RenderQuality, SonarFrame, render
from sonarjax.render.simulate import check_sonar_alone, single_scene, with_enough_room
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor.beams import (
    beam_gains,
    beam_mixing,
    crosstalk_mixing,
    dim_beams,
    group_gains,
    other_pings,
    streaks,
)
from sonarjax.sensor.bottom import ripple_brightness, slow_brightness
from sonarjax.sensor.display import compress, quantise
from sonarjax.sensor.model import SensorModel
from sonarjax.sensor.multipath import render_bounces
from sonarjax.sensor.propagation import (
    absorption_loss,
    elevation_gain,
    floor_elevation,
    fresh_absorption,
    late_reverberation,
    noise_floor,
    pulse_blur,
    range_middles,
    reference_energy,
    reference_range,
    time_varied_gain,
    with_skirts,
)
from sonarjax.sensor.speckle import (
    azimuth_kernel,
    complex_field,
    correlate,
    gamma_texture,
    heavy_tails,
    multi_look,
    range_kernel,
    speckle_intensity,
)
from sonarjax.sonar import Sonar


def observe(
    frame: SonarFrame,
    model: SensorModel,
    *,
    key: jax.Array,
    bounces: SonarFrame | None = None,
) -> Float[Array, "range beam"]:
    """Turn a rendered frame into the grey image that a device stores.

    If the frame was rendered with the sonar's own aperture, the vertical pattern ends sharply there. `observe_scene`
    renders beyond it, so that the image fades. Works under `jit` and `vmap` over keys, models, frames and sonars.
    Differentiable, except that the derivative of the quantisation is defined as 1. Each effect has a published source.
    No source for their order, which is ours. The automatic gain, energy divided by a power of its mean, is a model of
    ours.

    Args:
        frame: The rendered frame.
        model: The device and its water.
        key: Source of all random numbers.
        bounces: Multipath echoes from `render_bounces`; None for none.

    Returns:
        Grey image (range, beam) of 256 values from 0 to 1.

    Raises:
        SonarjaxError: An argument is of another kind, or a batch.
    """
    check_kind(frame, SonarFrame, "frame")
    if frame.intensity.ndim != 2:
        raise SonarjaxError(f"frame: expected one frame, got shape {frame.intensity.shape}: use jax.vmap")
    if bounces is not None:
        check_kind(bounces, SonarFrame, "bounces")
        if bounces.intensity.shape != frame.intensity.shape:
            raise SonarjaxError(f"bounces: expected shape {frame.intensity.shape}, got {bounces.intensity.shape}")
    gains_key, texture_key, speckle_key = _keys(model, key)
    sonar = frame.sonar
    energy = received_energy(frame, model, bounces) * beam_gains(sonar.n_beams, model.beam_gain_std, key=gains_key)
    energy = energy * gamma_texture(sonar.shape, model.texture, key=texture_key)
    energy = _with_oddities(energy, sonar, model, key=jax.random.fold_in(key, 3))
    noise = noise_floor(range_middles(sonar), model.noise, reference_range(sonar))
    energy = (energy + noise[:, None]) * speckle(sonar, model, key=speckle_key)
    agc = jnp.asarray(model.automatic_gain, jnp.float32)
    energy = energy * jnp.maximum(energy.mean(), 1e-6) ** -agc
    law = model.gain, model.log_share, model.dynamic_range, model.exponent, model.saturation, model.black
    return quantise(compress(energy, *law))


def _keys(model: SensorModel, key: jax.Array) -> Array:
    """Three keys for `observe`. Raises SonarjaxError unless there are one sensor model and one key."""
    check_kind(model, SensorModel, "model")
    for field in fields(model):
        if np.ndim(getattr(model, field.name)) != 0:  # an array of as many values as beams would pass for their gains
            shape = np.shape(getattr(model, field.name))
            raise SonarjaxError(f"model: {field.name}: expected one number, got shape {shape}: use jax.vmap")
    try:
        return jax.random.split(key, 3)
    except (TypeError, ValueError) as error:
        raise SonarjaxError(f"key: expected one key (such as jax.random.key(0)), got {shown(key)}") from error


def _with_oddities(energy: Array, sonar: Sonar, model: SensorModel, *, key: jax.Array) -> Array:
    """Add effects that the nominal device lacks: group gains, dim beams, slow changes, another sonar's pings."""
    groups, dim, slow, pings = jax.random.split(key, 4)
    gains = group_gains(sonar.n_beams, model.crosstalk_period, model.group_gain_std, key=groups)
    gains = gains * dim_beams(sonar.n_beams, model.dim_share, model.dim_loss, key=dim)
    energy = energy * slow_brightness(sonar.shape, model.unevenness, key=slow) * gains
    return energy + other_pings(sonar.shape, model.other_pings, key=pings)


@full_precision
def received_energy(
    frame: SonarFrame, model: SensorModel, bounces: SonarFrame | None = None
) -> Float[Array, "range beam"]:
    """Return the mean energy that is left after propagation, beams, pulse and gain.

    Nothing in it is random: `observe` multiplies it by speckle. The vertical pattern is taken at the floor's elevation
    in each pixel, for objects too; bounces come from other angles and are left without it. The terms are those of the
    sonar equation (Urick, Principles of Underwater Sound, 1983, ch. 2), on top of eq. 2. Models of ours: one
    backscatter for all objects, and a free power of cos(incidence) for the floor, after Lambert's law (Urick, ch. 8).

    Args:
        frame: The rendered frame.
        model: The device and its water.
        bounces: Multipath echoes from `render_bounces`; None for none.

    Returns:
        Mean energy (range, beam), relative to the floor on the beam axis.
    """
    sonar = frame.sonar
    ranges = range_middles(sonar)
    object_gain = 10 ** (jnp.asarray(model.object_gain, jnp.float32) / 10)
    slope = jnp.minimum(sonar.height / ranges, 1.0) ** jnp.asarray(model.floor_lambert, jnp.float32)
    share = frame.highlight
    ripples = ripple_brightness(sonar, ranges, model.ripple, model.ripple_wavelength, model.ripple_direction)
    energy = frame.intensity * (share * object_gain + (1 - share) * slope[:, None] * ripples)
    elevation = elevation_gain(floor_elevation(sonar), sonar.elevation_aperture, model.elevation_skirt)
    energy = energy * elevation
    if bounces is not None:
        energy = energy + object_gain * bounces.intensity
    absorption = fresh_absorption(sonar.frequency, model.temperature)
    reference = reference_range(sonar)
    made_up = time_varied_gain(ranges, reference, model.tvg_exponent, absorption * model.tvg_absorption)
    left = absorption_loss(ranges - reference, absorption - sonar.absorption)
    energy = energy * (made_up * left / reference_energy(sonar))[:, None]
    energy = pulse_blur(energy, model.pulse_bins)
    if not _is_absent(model.reverberation):
        energy = energy + late_reverberation(energy, model.reverberation, model.reverberation_length, sonar.range_bin)
    energy = streaks(energy, share, model.streak)
    leak = crosstalk_mixing(sonar.n_beams, model.crosstalk, model.crosstalk_period)
    return energy @ (leak @ beam_mixing(sonar, model.beam_widening, model.beam_ways)).T


def _is_absent(share: Any) -> bool:
    """Whether a share is known to be 0 before anything is computed: what is traced may be anything."""
    return isinstance(share, float) and share == 0.0


def speckle(sonar: Sonar, model: SensorModel, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Draw speckle with the model's contrast, looks and correlation.

    No source for the order of the steps: each of them, from `complex_field` to `multi_look`, has its own.

    Args:
        sonar: Gives the shape of the image and the beams.
        model: Gives contrast, looks and correlation.
        key: Source of the random numbers.

    Returns:
        Intensity (range, beam) of mean 1.
    """
    contrast = jnp.clip(jnp.asarray(model.speckle, jnp.float32), 0.0, 1.0)
    diffuse = 1 - jnp.sqrt(jnp.maximum(1 - contrast**2, 1e-12))
    field = complex_field(sonar.shape, key=key)
    field = correlate(field, azimuth_kernel(sonar, model.speckle_beams), range_kernel(model.speckle_bins))
    intensity = heavy_tails(speckle_intensity(field, diffuse), jnp.maximum(model.speckle, 1.0))
    return multi_look(intensity, model.looks)


def observe_scene(
    mesh: Mesh | Sequence[Mesh],
    pose: Pose | Sequence[Pose],
    sonar: Sonar,
    model: SensorModel,
    *,
    key: jax.Array,
    quality: RenderQuality = RenderQuality(),
) -> tuple[Float[Array, "range beam"], SonarFrame]:
    """Render objects on the floor with their multipath, and observe them (eq. 1–2, `render_bounces`, `observe`).

    Args:
        mesh: One mesh, or a sequence of meshes that stand in the same scene.
        pose: One pose of the mesh [m, rad], or a sequence with one pose for each mesh.
        sonar: The sonar that looks.
        model: The device and its water.
        key: Source of all random numbers.
        quality: How finely to render the objects. Multipath has a quality of its own.

    Returns:
        The observed image (range, beam), and the clean frame behind it.

    Raises:
        SonarjaxError: An argument is of another kind, or a batch; the numbers of meshes and poses differ; or a pose
            (unless traced) is not finite or absurdly far away.
    """
    check_sonar_alone(sonar)
    _keys(model, key)
    mesh, pose = single_scene(mesh, pose)
    found = with_enough_room(lambda roomy: _observe_scene(roomy, pose, sonar, model, key, quality), mesh)
    return found.image, found.frame


class _Observed(NamedTuple):
    """What `observe_scene` returns, and the overflow of everything rendered for it."""

    image: Array
    """Grey image (range, beam)."""
    frame: SonarFrame
    """The clean frame behind it."""
    overflow: Array
    """As in `SonarFrame`; the largest of all renders."""


@partial(jax.jit, static_argnames="quality")
def _observe_scene(
    mesh: Mesh, pose: Pose, sonar: Sonar, model: SensorModel, key: jax.Array, quality: RenderQuality
) -> _Observed:
    def reaching(aperture: Array) -> SonarFrame:
        return render(mesh, pose, sonar.replace(elevation_aperture=aperture), quality=quality)

    # One aperture after the other, so that the renderer is compiled once.
    apertures = [s.elevation_aperture for s in (sonar, with_skirts(sonar))]
    both = jax.lax.map(reaching, jnp.stack([jnp.asarray(a, jnp.float32) for a in apertures]))
    frame, seen = (replace(jax.tree.map(lambda v, k=k: v[k], both), sonar=sonar) for k in (0, 1))
    bounces = render_bounces(mesh, pose, sonar, model)
    overflow = jnp.maximum(both.overflow.max(), bounces.overflow)
    return _Observed(observe(seen, model, key=key, bounces=bounces), frame, overflow)
