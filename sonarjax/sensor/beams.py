"""What beams hear besides their own azimuth: side lobes, crosstalk of firing groups, gains, streaks, other pings.

Mixing matrices (beam, source) act on rows of an image of mean energy (range, beam); each of their rows sums to one.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.sonar import Sonar

MINUS_3_DB = 0.8859
"""Width of sinc² at half its maximum, in units of its first zero."""


def array_pattern(offset: Float[Array, "*batch"], beam_width: Any) -> Float[Array, "*batch"]:
    """One-way power gain (...) of a line array at `offset` [rad] from the axis of a beam of −3 dB `beam_width` [rad].

    sinc² of u = 0.886·sin(offset)/beam_width (`jnp.sinc` brings the π): first side lobes at −13.26 dB. Urick,
    Principles of Underwater Sound (1983), ch. 3.
    """
    return jnp.square(jnp.sinc(MINUS_3_DB * jnp.sin(offset) / beam_width))


def beam_mixing(sonar: Sonar, widening: Any = 1.0, ways: Any = 2.0) -> Float[Array, "beam source"]:
    """What share of beam `beam`'s energy comes from the azimuth of `source`: matrix (beam, source), rows sum to one.

    `widening` is the −3 dB width in units of the sonar's `beam_width`, or of the beam's own spacing where that is 0;
    `ways` is 1 for a pattern on reception only, 2 on transmission too. Beam tables may be uneven. Mean energies add
    over azimuth, weighted by both patterns, as in reverberation (Urick, Principles of Underwater Sound, 1983, ch. 8).
    That rows sum to one, and `ways` between 1 and 2, are choices of ours.
    """
    spacing = jnp.diff(sonar.azimuth_edges)
    own = jnp.asarray(sonar.beam_width, jnp.float32)
    own = jnp.where(own > 0, own, spacing)
    azimuth = jnp.asarray(sonar.azimuth, jnp.float32)
    gain = array_pattern(azimuth[:, None] - azimuth[None, :], (widening * own)[:, None])
    return _rows_to_one(jnp.maximum(gain, 1e-12) ** jnp.asarray(ways, jnp.float32) * spacing)


def crosstalk_mixing(n_beams: int, leak: Any, period: Any) -> Float[Array, "beam source"]:
    """Leakage between beams of one firing group, whose numbers differ by multiples of `period`: rows sum to one.

    The matrix (beam, source) gives the nearest such beams `leak` of the own beam's weight, and half as much with every
    further period. No source: a model of ours for strong echoes that leak into beams fired at the same time. That a
    DIDSON fires 8 sets of 12 beams, hence a comb of period 8, is an assumption, not checked on a device.
    """
    apart = jnp.abs(jnp.arange(n_beams)[:, None] - jnp.arange(n_beams)[None, :]).astype(jnp.float32)
    turns = jnp.round(apart / period)
    member = (turns > 0) & (jnp.abs(apart - turns * period) < 0.5)
    return _rows_to_one(jnp.eye(n_beams) + jnp.where(member, leak * 0.5 ** jnp.maximum(turns - 1, 0.0), 0.0))


def _rows_to_one(weights: Float[Array, "beam source"]) -> Float[Array, "beam source"]:
    return weights / weights.sum(axis=1, keepdims=True)


def streaks(
    image: Float[Array, "range beam"], highlight: Float[Array, "range beam"], level: Any
) -> Float[Array, "range beam"]:
    """Energy (range, beam) with specular rows smeared over all beams, as a glint does through far side lobes.

    A row gains `level` of its brightest object pixel (energy × `highlight`, (range, beam)), in proportion to how that
    compares with the frame's brightest: only the glint itself makes a visible line. No source: a model of ours for
    the rows that specular faces light in real ARIS frames.
    """
    peak = jnp.max(image * highlight, axis=1, keepdims=True)
    return image + level * peak * (peak / jnp.maximum(jnp.max(peak), 1e-30))


def beam_gains(n_beams: int, std_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Gain (beam,) of each beam's energy: normal in dB with a standard deviation of `std_db` [dB] around 0 dB.

    No source: a model of ours for what is left of the differences between a device's channels.
    """
    return 10 ** (jnp.asarray(std_db, jnp.float32) * jax.random.normal(key, (n_beams,)) / 10)


def group_gains(n_beams: int, period: Any, std_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Gain (beam,) of each beam's energy by its firing group: every `period`-th beam shares one, `std_db` [dB] apart.

    No source: a model of ours for the comb of bright and dark beams in frames of devices that fire in groups.
    """
    group = jnp.arange(n_beams) % jnp.maximum(jnp.asarray(period), 1.0).astype(jnp.int32)
    each = jax.random.normal(key, (n_beams,))
    return 10 ** (jnp.asarray(std_db, jnp.float32) * each[group] / 10)


def dim_beams(n_beams: int, share: Any, loss_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Gain (beam,) of beams of which a `share` [1] hears `loss_db` [dB] less. No source: a model of ours."""
    dim = jax.random.uniform(key, (n_beams,)) < jnp.asarray(share, jnp.float32)
    return jnp.where(dim, 10 ** (-jnp.asarray(loss_db, jnp.float32) / 10), 1.0)


def other_pings(shape: tuple[int, int], level: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Energy (range, beam) of another sonar's pings, heard at two ranges by a few neighbouring beams or by all of them.

    `level` is in units of the floor's energy on the beam axis. No source: a model of ours for short bright bars that
    are no echo.
    """
    rows, beams = shape
    place = jax.random.uniform(key, (4, 2))
    row, beam = rows * place[0], beams * place[1]
    length, width = 1 + 5 * place[2], beams * place[3] ** 2 + 1
    along = jnp.exp(-jnp.square((jnp.arange(rows)[:, None] - row) / length) / 2)
    across = jnp.exp(-jnp.square((jnp.arange(beams)[:, None] - beam) / width) / 2)
    return jnp.asarray(level, jnp.float32) * (along @ across.T)
