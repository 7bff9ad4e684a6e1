"""The echo's energy per range bin (eq. 2): first hits of objects and of the floor, spread over their ranges."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.render.segments import plane_line
from sonarjax.render.slabs import Slabs
from sonarjax.render.spans import Ends, Scene, corners_of, floor_line, interval_range, trace_tau
from sonarjax.sonar import Sonar

USUAL_INTERVALS = 16  # of all the intervals that a slice might hold, about this many are seen
NARROWEST = 0.05  # least spread of a cell [bins]: the sum along range keeps float32's digits
DB_TO_NEPER = math.log(10.0) / 10.0


def strength(
    distance: Float[Array, "*#batch"], cosine: Float[Array, "*#batch"], sonar: Sonar
) -> Float[Array, "*batch"]:
    """Echo of a first hit at `distance` [m] (eq. 2 with I0 = k = 1): rⁿ spreading, absorption, Lambert's law."""
    spread = distance ** (-jnp.asarray(sonar.spreading_exponent, jnp.float32))
    absorbed = jnp.exp(-2 * DB_TO_NEPER * sonar.absorption * distance)
    return spread * absorbed * jnp.maximum(cosine, 1e-6) ** jnp.asarray(sonar.lambert, jnp.float32)


def object_energy(
    ends: Ends, slabs: Slabs, scene: Scene, sonar: Sonar, elevations: int, edges: Float[Array, "edge"],
    reflectivity: Float[Array, "face"] | None = None,
) -> Float[Array, "slab range"]:  # fmt: skip
    """Energy [rad/m²] per range bin of each slab, from the visible intervals' `ends`; `edges` (edge,) [m].

    Each interval is cut into cells, so that a slice has about `elevations` of them; a cell's energy is spread evenly
    over the ranges it covers and what its surface moves in range across the slab. `reflectivity` (face,) multiplies
    what each triangle sends back.
    """
    intervals = ends.tau.shape[1] // 2
    cells = max(1, math.ceil(elevations / min(intervals, USUAL_INTERVALS)))

    def cell_ends(azimuth: Float[Array, "slab"]) -> tuple[Array, tuple[Array, ...]]:
        distance, *others = _cells(ends, azimuth, scene, cells)
        return distance, tuple(others)

    along = (slabs.middle,), (jnp.ones_like(slabs.middle),)
    distance, slope, (tau, cosine, nearest, farthest) = jax.jvp(
        cell_ends, *along, has_aux=True
    )  # (slab, interval, cell end)
    slope = slope * slabs.width[:, None, None]
    # The plane of a facet that is seen edge-on may pass close by the head: no point is beyond the facet's own corners.
    near = jnp.clip(jnp.minimum(distance[..., 1:], distance[..., :-1]), nearest, farthest)
    far = jnp.clip(jnp.maximum(distance[..., 1:], distance[..., :-1]), nearest, farthest)
    angle = jnp.diff(jnp.arctan(tau), axis=-1)
    energy = angle * strength((near + far) / 2, (cosine[..., 1:] + cosine[..., :-1]) / 2, sonar) / 2
    surface = ends.surface[:, :intervals, None]
    energy = jnp.where(surface >= 0, energy, 0.0)
    if reflectivity is not None:
        energy = energy * reflectivity[jnp.maximum(surface, 0)]
    # Half of the energy in each half of the slab. A box's spread over elevation and one over azimuth make a box here
    # whose variance is the sum of theirs; one as wide as both together would smear narrow echoes.
    centre, moved = (near + far) / 2, (slope[..., 1:] + slope[..., :-1]) / 8
    half = jnp.sqrt((far - near) ** 2 / 4 + moved**2 + 1e-14)

    def both(sign: float) -> Array:
        ends = jnp.stack([centre - moved, centre + moved], axis=-1) + (sign * half)[..., None]
        return jnp.clip(ends, nearest[..., None], farthest[..., None]).reshape(len(centre), -1)

    return _spread(jnp.repeat(energy, 2, axis=-1).reshape(len(energy), -1), both(-1.0), both(1.0), edges)


def _cells(ends: Ends, azimuth: Float[Array, "slab"], scene: Scene, cells: int) -> tuple[Array, ...]:
    """Range [m], elevation tangent and cos(incidence) (slab, interval, cell end) at `azimuth` [rad].

    Then the nearest and the farthest range [m] that each cell's facet reaches (slab, interval, cell).
    """
    theta = azimuth[..., None]
    corners = corners_of(scene, ends.surface)
    line = jnp.stack(plane_line(corners, theta), -1)
    low, high = jnp.split(trace_tau(ends, theta, scene, (line[..., 0], line[..., 1]))[0], 2, axis=-1)
    share = jnp.linspace(0.0, 1.0, cells + 1)
    tau = low[..., None] + jnp.maximum(high - low, 0.0)[..., None] * share
    intervals = low.shape[-1]
    distance = interval_range(line[..., :intervals, None, :], tau)
    corners = corners[:, :intervals]
    normal = jnp.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normal = normal / jnp.sqrt((normal**2).sum(-1, keepdims=True) + 1e-24)
    lateral = normal[..., 0] * jnp.cos(theta) + normal[..., 1] * jnp.sin(theta)
    cosine = jnp.abs(lateral[..., None] + normal[..., 2, None] * tau) / jnp.sqrt(1 + tau * tau)
    reach = jnp.cos(theta)[..., None] * corners[..., 0] + jnp.sin(theta)[..., None] * corners[..., 1]  # planar range
    slant = jnp.sqrt(1 + tau * tau)
    nearest, farthest = (v[..., None] * slant for v in (reach.min(-1), reach.max(-1)))
    nearest, farthest = (
        jnp.minimum(nearest[..., 1:], nearest[..., :-1]),
        jnp.maximum(farthest[..., 1:], farthest[..., :-1]),
    )
    return distance, tau, cosine, nearest, jnp.maximum(farthest, nearest)


def _spread(energy: Array, near: Array, far: Array, edges: Float[Array, "edge"]) -> Float[Array, "slab range"]:
    """Energies (slab, cell) spread evenly over [near, far] [m], as the difference of two ramps at each edge.

    The ramps are scattered at their ends and summed along range: the cost does not grow with the number of bins.
    """
    bins, step = len(edges) - 1, edges[1] - edges[0]
    start, stop = (near - edges[0]) / step, (far - edges[0]) / step
    length = jnp.maximum(stop - start, NARROWEST)
    density = energy / length
    slab = jnp.arange(len(energy))[:, None]
    changes = jnp.zeros((len(energy), bins + 2))
    for end, sign in ((start, 1.0), (start + length, -1.0)):
        inside = jnp.clip(end, 0.0, bins + 0.0)
        index = jnp.minimum(inside.astype(jnp.int32), bins - 1)
        part = inside - index
        # A ramp that starts at index + part: its mean slope is 1 - part over this bin and 1 over all later ones.
        changes = changes.at[slab, index].add(sign * density * (1 - part))
        changes = changes.at[slab, index + 1].add(sign * density * part)
    return jnp.cumsum(changes, axis=1)[:, :bins]


def floor_energy(
    azimuth: Float[Array, "beam"], scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]
) -> Float[Array, "range beam"]:
    """Energy [rad/m²] of the bare floor per bin: the elevations that see it between two range `edges` (edge,) [m].

    Exact in elevation: on a line at distance d from the head, elevation differs from the perpendicular's by acos(d/r).
    """
    a, b = floor_line(azimuth, scene.view)
    distance = 1 / jnp.sqrt(a * a + b * b)
    low, high = _floor_span(a, b, scene)
    bounds = jnp.clip(edges[:, None], low, high)
    ratio = jnp.clip(distance / bounds, 0.0, 1.0 - 1e-7)
    angle = jnp.diff(jnp.arccos(ratio), axis=0)
    middle = jnp.maximum((bounds[1:] + bounds[:-1]) / 2, 1e-3)
    return jnp.maximum(angle, 0.0) * strength(middle, jnp.minimum(distance / middle, 1.0), sonar)


def _floor_span(a: Array, b: Array, scene: Scene) -> tuple[Array, Array]:
    """Nearest and farthest floor range [m] inside the aperture; very far where the horizon is in view."""
    line = jnp.stack(jnp.broadcast_arrays(a, b), -1)
    low, high = (
        interval_range(line, jnp.broadcast_to(tau, a.shape)) for tau in (scene.view.tau_min, scene.view.tau_max)
    )
    return low, high


def floor_angle(distance: Float[Array, "*batch"], sonar: Sonar) -> Float[Array, "*batch"]:
    """Elevation [rad] that one range bin of bare floor fills at slant range `distance` [m]; finite anywhere."""
    height = jnp.asarray(sonar.height, jnp.float32)
    aside = jnp.sqrt(jnp.maximum(distance**2 - height**2, (0.1 * height) ** 2))
    return sonar.range_bin * height / (jnp.maximum(distance, height) * aside)


def floor_lit(azimuth: Float[Array, "beam"], scene: Scene, edges: Float[Array, "edge"]) -> Array:
    """Pixels (range, beam) whose middle sees the floor inside the aperture; range `edges` (edge,) [m]."""
    low, high = _floor_span(*floor_line(azimuth, scene.view), scene)
    middle = ((edges[1:] + edges[:-1]) / 2)[:, None]
    return (middle >= low) & (middle <= high)
