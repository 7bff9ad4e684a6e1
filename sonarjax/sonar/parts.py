"""What a `Sonar` may hold besides numbers: a platform, how well its geometry is known; and the edges of its beams."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.records import record

Scalar = Any


@record
class FloorPatch:
    """A rectangular platform at z = 0 instead of an endless floor; lengths [m], angles [rad] in the ground frame."""

    x: Scalar
    """Forward position of its centre [m]."""
    y: Scalar
    """Position to port of its centre [m]."""
    length: Scalar
    """Side along its own x axis [m]."""
    width: Scalar
    """Side along its own y axis [m]."""
    yaw: Scalar = 0.0
    """Rotation about the vertical [rad]."""


@record
class GeometryStd:
    """How well a sonar's geometry is known: standard deviations, for example from a calibration.

    A value is 0 where none is stated. Angles are in radians, but for the incidence limit, as in `Sonar`. `range_scale`,
    `azimuth_scale`, `beam_bend` and `beam_skew` are the parameters of that name in `sonarjax.calibrate.PARAMETERS`.
    """

    tilt: Scalar = 0.0
    """Standard deviation of the tilt [rad]."""
    roll: Scalar = 0.0
    """Standard deviation of the roll [rad]."""
    height: Scalar = 0.0
    """Standard deviation of the height [m]."""
    elevation_aperture: Scalar = 0.0
    """Standard deviation of the vertical aperture [rad]."""
    range_offset: Scalar = 0.0
    """Standard deviation of an offset of all ranges [m]."""
    range_scale: Scalar = 0.0
    """Standard deviation of a factor on all ranges [1]."""
    azimuth_scale: Scalar = 0.0
    """Standard deviation of a factor on all beam angles [1]."""
    beam_bend: Scalar = 0.0
    """Standard deviation of uneven beam spacing that is symmetric about the axis [1]."""
    beam_skew: Scalar = 0.0
    """Standard deviation of uneven beam spacing that differs from port to starboard [1]."""
    highlight_max_incidence: Scalar = 0.0
    """Standard deviation of the highlight's incidence limit [deg]."""


def beam_edges(azimuth: Any, beam_width: Any) -> Float[Array, "*batch edge"]:
    """Edges (*batch, edge) of beams with these centres (*batch, beam) [rad]; a single beam is `beam_width` [rad] wide.

    Inner edges lie midway between beam centres. An outer edge is as far from its centre as that beam's inner edge.
    """
    centers = jnp.asarray(azimuth)
    if centers.shape[-1] == 1:
        half = jnp.maximum(jnp.asarray(beam_width, jnp.float32), 1e-4)[..., None] / 2
        return jnp.concatenate([centers - half, centers + half], axis=-1)
    middle = (centers[..., 1:] + centers[..., :-1]) / 2
    first, last = 2 * centers[..., :1] - middle[..., :1], 2 * centers[..., -1:] - middle[..., -1:]
    return jnp.concatenate([first, middle, last], axis=-1)


def field_of_view_deg(azimuth: Any) -> float:
    """Angle between the outer edges of the outer beams [deg], of two or more beams."""
    edges = beam_edges(azimuth, 0.0)
    return math.degrees(float(edges[-1] - edges[0]))
