"""What a beam hears besides its own azimuth: side lobes, crosstalk of firing groups, gains, streaks, other pings.

Mixing matrices (beam, source) act on the rows of an image (range, beam) of mean energy. Each of their rows sums to one.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.sonar import Sonar

MINUS_3_DB = 0.8859
"""Width of sinc² at half its maximum, as a multiple of its first zero."""


def array_pattern(offset: Float[Array, "*batch"], beam_width: Any) -> Float[Array, "*batch"]:
    """Return the one-way power gain of a line array.

    sinc² of u = 0.886·sin(offset)/beam_width (`jnp.sinc` supplies the π), with first side lobes at −13.26 dB (Urick,
    Principles of Underwater Sound, 1983, ch. 3).

    Args:
        offset: Angle from the axis of the beam (...) [rad].
        beam_width: Full width of the beam at −3 dB [rad].

    Returns:
        Power gain (...): 1 on the axis, less elsewhere.
    """
    return jnp.square(jnp.sinc(MINUS_3_DB * jnp.sin(offset) / beam_width))


def beam_mixing(sonar: Sonar, widening: Any = 1.0, ways: Any = 2.0) -> Float[Array, "beam source"]:
    """Return the share of each beam's energy that comes from the azimuth of each source.

    Mean energies add over azimuth, weighted by the patterns of transmitter and receiver, as in reverberation (Urick,
    Principles of Underwater Sound, 1983, ch. 8). Normalised rows, and `ways` between 1 and 2, are choices of ours. Beam
    spacing may be uneven.

    Args:
        sonar: Gives the beams.
        widening: Width of a beam at −3 dB, as a multiple of the sonar's `beam_width`, or of the beam's own spacing
            where that is 0 [1].
        ways: 1 for a pattern on reception only, 2 for one on transmission too [1].

    Returns:
        Matrix (beam, source) whose rows sum to one.
    """
    spacing = jnp.diff(sonar.azimuth_edges)
    own = jnp.asarray(sonar.beam_width, jnp.float32)
    own = jnp.where(own > 0, own, spacing)
    azimuth = jnp.asarray(sonar.azimuth, jnp.float32)
    gain = array_pattern(azimuth[:, None] - azimuth[None, :], (widening * own)[:, None])
    return _rows_to_one(jnp.maximum(gain, 1e-12) ** jnp.asarray(ways, jnp.float32) * spacing)


def crosstalk_mixing(n_beams: int, leak: Any, period: Any) -> Float[Array, "beam source"]:
    """Return the matrix of the leaks between beams of one firing group.

    Beams are in one group if their numbers differ by a multiple of `period`. The leak halves with every further period
    between them. No source: a model of ours for strong echoes that leak into beams fired at the same time. That a
    DIDSON fires 8 sets of 12 beams, hence a period of 8, is an assumption, not checked on a device.

    Args:
        n_beams: Number of beams.
        leak: Weight of the nearest beams of the group, relative to the beam's own [1].
        period: Step in beam number within one firing group [beams].

    Returns:
        Matrix (beam, source) whose rows sum to one.
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
    """Smear specular rows over all beams, as a glint does through distant side lobes.

    A row gains `level` times its brightest object pixel, scaled by the ratio of that pixel to the brightest of the
    frame, so that only the glint itself makes a visible line. No source: a model of ours for the rows that specular
    faces light up in real ARIS frames.

    Args:
        image: Energy (range, beam).
        highlight: Share of the object in each pixel (range, beam).
        level: Share of a glint's energy that its row gains [1].

    Returns:
        Energy (range, beam) with the streaks added.
    """
    peak = jnp.max(image * highlight, axis=1, keepdims=True)
    brightest = jnp.max(peak)
    shown = brightest > 0  # else the derivative of 0/0 would be NaN
    return image + level * peak * jnp.where(shown, peak / jnp.where(shown, brightest, 1.0), 0.0)


def beam_gains(n_beams: int, std_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Draw a gain for each beam, normal in dB around 0 dB.

    No source: a model of ours for the differences that remain between a device's channels.

    Args:
        n_beams: Number of beams.
        std_db: Standard deviation of the gains [dB].
        key: Source of the random numbers.

    Returns:
        Factor on the energy of each beam (beam,).
    """
    return 10 ** (jnp.asarray(std_db, jnp.float32) * jax.random.normal(key, (n_beams,)) / 10)


def group_gains(n_beams: int, period: Any, std_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Draw a gain for each firing group, the same for every `period`-th beam.

    The gains are normal in dB around 0 dB. No source: a model of ours for the comb of bright and dark beams from
    devices that fire in groups.

    Args:
        n_beams: Number of beams.
        period: Step in beam number within one firing group [beams].
        std_db: Standard deviation of the gains of the groups [dB].
        key: Source of the random numbers.

    Returns:
        Factor on the energy of each beam (beam,).
    """
    group = jnp.arange(n_beams) % jnp.maximum(jnp.asarray(period), 1.0).astype(jnp.int32)
    each = jax.random.normal(key, (n_beams,))
    return 10 ** (jnp.asarray(std_db, jnp.float32) * each[group] / 10)


def dim_beams(n_beams: int, share: Any, loss_db: Any, *, key: jax.Array) -> Float[Array, "beam"]:
    """Draw which beams are dim, and return the gain of each beam.

    No source: a model of ours.

    Args:
        n_beams: Number of beams.
        share: Probability that a beam is dim [1].
        loss_db: How much less a dim beam hears [dB].
        key: Source of the random numbers.

    Returns:
        Factor on the energy of each beam (beam,): 1 where it is not dim.
    """
    dim = jax.random.uniform(key, (n_beams,)) < jnp.asarray(share, jnp.float32)
    return jnp.where(dim, 10 ** (-jnp.asarray(loss_db, jnp.float32) / 10), 1.0)


@full_precision
def other_pings(shape: tuple[int, int], level: Any, *, key: jax.Array) -> Float[Array, "range beam"]:
    """Draw the energy of two pings of another sonar.

    Each is heard at one range, by a few neighbouring beams or by all of them. No source: a model of ours for short
    bright bars that are not echoes.

    Args:
        shape: Shape (range, beam) of the image.
        level: Peak energy of a ping, relative to the floor's energy on the beam axis [1].
        key: Source of the random numbers.

    Returns:
        Energy (range, beam) to add to an image.
    """
    rows, beams = shape
    place = jax.random.uniform(key, (4, 2))
    row, beam = rows * place[0], beams * place[1]
    length, width = 1 + 5 * place[2], beams * place[3] ** 2 + 1
    along = jnp.exp(-jnp.square((jnp.arange(rows)[:, None] - row) / length) / 2)
    across = jnp.exp(-jnp.square((jnp.arange(beams)[:, None] - beam) / width) / 2)
    return jnp.asarray(level, jnp.float32) * (along @ across.T)
