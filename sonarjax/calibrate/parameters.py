"""The numbers of a sonar that a calibration can fit: what each means, its unit, its usual prior."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import is_number, shown
from sonarjax.refine.free import in_order
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


class Parameter(NamedTuple):
    """One free number, given as its difference from the nominal sonar's."""

    std: float
    """Standard deviation of the usual prior [unit]."""
    trust: float
    """Scale of the steps of a fit [unit]: how far the picture is nearly linear."""
    unit: str
    """rad, deg, m, or 1 for a ratio."""


PARAMETERS: dict[str, Parameter] = {
    "tilt": Parameter(math.radians(5.0), math.radians(1.5), "rad"),
    "roll": Parameter(math.radians(3.0), math.radians(1.0), "rad"),
    "height": Parameter(0.3, 0.04, "m"),
    "elevation_aperture": Parameter(math.radians(2.0), math.radians(1.0), "rad"),
    "range_offset": Parameter(0.05, 0.01, "m"),
    "range_scale": Parameter(0.02, 0.004, "1"),
    "azimuth_scale": Parameter(0.03, 0.01, "1"),
    "beam_bend": Parameter(0.05, 0.02, "1"),
    "beam_skew": Parameter(0.05, 0.02, "1"),
    "highlight_max_incidence": Parameter(20.0, 4.0, "deg"),
}
"""The sonar's numbers that may be free. `range_scale` stretches all ranges, as a wrong sound speed does, and
`azimuth_scale` all beam angles. `beam_bend` b moves a beam at the share u of the half field of view by b·(u −
u³) of it: the smooth unevenness of a lens. `beam_skew` b moves it by b·(u² − 1/3): that of a lens that is not
centred. `highlight_max_incidence` is the angle from a facet's normal [deg] about which its echo fades, kept within
`INCIDENCE_DEG`.
"""
INCIDENCE = "highlight_max_incidence"
INCIDENCE_DEG = 1.0, 90.0
"""Least and largest incidence limit [deg]; the largest leaves all echoes."""

SIZES: dict[str, Parameter] = {
    name: Parameter(0.25, 0.08, "1") for name in ("object_length", "object_width", "object_height")
}
"""The object's numbers that may be free instead, see `sonarjax.shape.fit_size`: its extents along x, y and z of
its mesh, as the logarithm of their ratio to those of the mesh. The mesh grows around its origin, but from its lowest
point upwards; where it leans, the lowest point in each frame stays where the pose puts it (`resting`).
"""


OFFSET_ROOM = 2.0
"""At least this many prior standard deviations of a free `range_offset` must lie between sonar and window, because
ranges below 0 have no meaning.
"""


def check_free(free: Sequence[str]) -> tuple[str, ...]:
    """Check names of free numbers, and put them in the order of `PARAMETERS`.

    Args:
        free: The names.

    Returns:
        The names in order.

    Raises:
        SonarjaxError: There are no names, or one is unknown or repeated.
    """
    return in_order(free, PARAMETERS)


def prior_std(free: Sequence[str], prior: Mapping[str, float] | None, sonar: Sonar) -> Float[np.ndarray, "free"]:
    """Standard deviations of the priors (free,): from `prior`, else the sonar's `geometry_std`, else the usual ones.

    Raises:
        SonarjaxError: A name is not free, a value is not positive, or `range_offset` is free and the window begins so
            near the sonar that ranges might become negative.
    """
    if not isinstance(prior, Mapping | None):
        raise SonarjaxError(f"prior: expected standard deviations by name, got {shown(prior)}")
    given = dict(prior or {})
    for name, value in given.items():
        if name not in free:
            raise SonarjaxError(f"prior: {name!r} is not among the free numbers {', '.join(free)}")
        if not (is_number(value) and 0 < value < math.inf):
            raise SonarjaxError(f"prior: {name}: expected a positive standard deviation, got {shown(value)}")
    stated = {} if sonar.geometry_std is None else vars(sonar.geometry_std)
    known = {name: float(stated.get(name, 0.0)) or (PARAMETERS | SIZES)[name].std for name in free} | given
    nearest = OFFSET_ROOM * known.get("range_offset", 0.0)
    if float(sonar.range_min) < nearest:
        raise SonarjaxError(
            f"free: range_offset: expected a window that begins {nearest:g} m or more from the sonar "
            f"({OFFSET_ROOM:g} standard deviations of its prior), got {float(sonar.range_min):g} m"
        )
    return np.array([known[name] for name in free], float)


def changed_sonar(sonar: Sonar, free: Sequence[str], change: Float[Array, "free"]) -> Sonar:
    """The sonar with the `free` numbers changed by `change` (free,); differentiable."""
    by = {name: change[k] for k, name in enumerate(free)}
    fields: dict[str, Any] = {
        name: jnp.asarray(getattr(sonar, name), jnp.float32) + by[name]
        for name in ("tilt", "roll", "height", "elevation_aperture", INCIDENCE)
        if name in by
    }
    if INCIDENCE in by:
        fields[INCIDENCE] = jnp.clip(fields[INCIDENCE], *INCIDENCE_DEG)
    stretch, shift = 1 + by.get("range_scale", 0.0), by.get("range_offset", 0.0)
    if "range_scale" in by or "range_offset" in by:
        fields |= {name: getattr(sonar, name) * stretch + shift for name in ("range_min", "range_max")}
    if not by.keys().isdisjoint(("azimuth_scale", "beam_bend", "beam_skew")):
        azimuth = jnp.asarray(sonar.azimuth)
        half = jnp.maximum(jnp.abs(azimuth).max(), 1e-6)  # 0 for a single beam straight ahead
        share = azimuth / half
        bend, skew = by.get("beam_bend", 0.0), by.get("beam_skew", 0.0)
        bent = azimuth + half * (bend * (share - share**3) + skew * (share**2 - 1 / 3))
        fields["azimuth"] = bent * (1 + by.get("azimuth_scale", 0.0))
    return sonar.replace(**fields)


def changed_mesh(mesh: Mesh, free: Sequence[str], change: Float[Array, "free"]) -> Mesh:
    """The mesh with those of the `SIZES` that are `free` changed by `change` (free,); differentiable."""
    if not any(name in SIZES for name in free):
        return mesh
    by = {name: change[k] for k, name in enumerate(free)}
    grown = jnp.exp(jnp.stack([jnp.asarray(by.get(name, 0.0), jnp.float32) for name in SIZES]))
    vertices = jnp.asarray(mesh.vertices)
    base = vertices[..., 2].min() * jnp.array([0.0, 0.0, 1.0])
    return mesh.with_vertices(base + (vertices - base) * grown)


def resting(pose: Pose, mesh: Mesh, grown: Mesh) -> Pose:
    """The poses (*batch), raised or lowered so that the lowest point is as high for `grown` as for `mesh`.

    Nothing changes where the object is upright; one that lies grows from its lowest side. Differentiable.
    """
    was, now = (pose.to_ground(jnp.asarray(one.vertices))[..., 2].min(axis=-1) for one in (mesh, grown))
    return replace(pose, z=pose.z + (was - now))
