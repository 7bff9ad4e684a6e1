"""The echo's energy in each range bin (eq. 2): first hits of objects and of the floor, spread over their ranges."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.render.platform import platform_span
from sonarjax.render.segments import NEAR_M, plane_line
from sonarjax.render.slabs import Slabs
from sonarjax.render.spans import Ends, Scene, corners_of, floor_line, interval_range, reach_of, trace_tau
from sonarjax.render.vector import normal_of, unit
from sonarjax.sonar import Sonar

USUAL_INTERVALS = 16  # a slice usually shows about this many intervals, however many it has room for
NARROWEST = 0.05  # least extent of a cell [bins]: a narrower one would cost the sum along range too many digits
DB_TO_NEPER = math.log(10.0) / 10.0


def strength(
    distance: Float[Array, "*#batch"], cosine: Float[Array, "*#batch"], sonar: Sonar
) -> Float[Array, "*batch"]:
    """Echo of a first hit (eq. 2 with I0 = k = 1): spreading, absorption and Lambert's law.

    Args:
        distance: Slant range [m].
        cosine: Cosine of the angle of incidence [1].
        sonar: Gives the spreading exponent, the absorption and Lambert's exponent.
    """
    spread = distance ** (-jnp.asarray(sonar.spreading_exponent, jnp.float32))
    absorbed = jnp.exp(-2 * DB_TO_NEPER * sonar.absorption * distance)
    return spread * absorbed * jnp.maximum(cosine, 1e-6) ** jnp.asarray(sonar.lambert, jnp.float32)


def object_energy(
    ends: Ends, slabs: Slabs, scene: Scene, sonar: Sonar, elevations: int, edges: Float[Array, "edge"],
    reflectivity: Float[Array, "face"] | None = None,
) -> Float[Array, "slab range"]:  # fmt: skip
    """Energy [rad/m²] that the object sends back into each range bin of each slab.

    Each interval is cut into cells. A cell's energy is spread evenly over the ranges that it covers, and over those
    that its surface passes across the slab.

    Args:
        ends: Ends of the visible intervals, from `all_ends`.
        slabs: The slabs.
        scene: The surface and the view.
        sonar: The sonar.
        elevations: About how many cells a slice has.
        edges: Edges (edge,) of the range bins [m].
        reflectivity: Factor (face,) for the energy of each triangle.
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
    # The plane of a facet seen edge-on may pass close to the head, so ranges are limited to those of its corners.
    near = jnp.clip(jnp.minimum(distance[..., 1:], distance[..., :-1]), nearest, farthest)
    far = jnp.clip(jnp.maximum(distance[..., 1:], distance[..., :-1]), nearest, farthest)
    angle = jnp.diff(jnp.arctan(tau), axis=-1)
    energy = angle * strength((near + far) / 2, (cosine[..., 1:] + cosine[..., :-1]) / 2, sonar) / 2
    surface = ends.surface[:, :intervals, None]
    energy = jnp.where(surface >= 0, energy, 0.0)
    if reflectivity is not None:
        energy = energy * reflectivity[jnp.maximum(surface, 0)]
    # Each half of the slab gets half of the energy. The extents over elevation and over azimuth are joined into one box
    # whose variance is the sum of theirs; a box as wide as both together would smear narrow echoes.
    centre, moved = (near + far) / 2, (slope[..., 1:] + slope[..., :-1]) / 8
    half = jnp.sqrt((far - near) ** 2 / 4 + moved**2 + 1e-14)

    def both(sign: float) -> Array:
        ends = jnp.stack([centre - moved, centre + moved], axis=-1) + (sign * half)[..., None]
        return jnp.clip(ends, nearest[..., None], farthest[..., None]).reshape(len(centre), -1)

    return _spread(jnp.repeat(energy, 2, axis=-1).reshape(len(energy), -1), both(-1.0), both(1.0), edges)


def _cells(ends: Ends, azimuth: Float[Array, "slab"], scene: Scene, cells: int) -> tuple[Array, ...]:
    """The cells of each interval at `azimuth` [rad].

    Returns:
        Range [m], elevation tangent and cosine of incidence, each (slab, interval, cell end), then the nearest and the
        farthest range [m] that the cell's facet reaches, each (slab, interval, cell).
    """
    theta = azimuth[..., None]
    corners = corners_of(scene, ends.surface)
    line = jnp.stack(plane_line(corners, theta), -1)
    low, high = jnp.split(trace_tau(ends, theta, scene, (line[..., 0], line[..., 1]))[0], 2, axis=-1)
    share = jnp.linspace(0.0, 1.0, cells + 1)
    tau = low[..., None] + jnp.maximum(high - low, 0.0)[..., None] * share
    intervals = low.shape[-1]
    distance = interval_range(line[..., :intervals, None, :], tau)
    corners = jax.tree.map(lambda v: v[:, :intervals], corners)
    normal = unit(normal_of(corners))
    slant = jnp.sqrt(1 + tau * tau)
    cosine = jnp.abs(normal.turned(theta)[0][..., None] + normal.z[..., None] * tau) / slant
    nearest, farthest = (jnp.maximum(reach, NEAR_M)[..., None] * slant for reach in reach_of(corners, theta))
    nearest, farthest = (
        jnp.minimum(nearest[..., 1:], nearest[..., :-1]),
        jnp.maximum(farthest[..., 1:], farthest[..., :-1]),
    )
    return distance, tau, cosine, nearest, jnp.maximum(farthest, nearest)


def _spread(energy: Array, near: Array, far: Array, edges: Float[Array, "edge"]) -> Float[Array, "slab range"]:
    """Spread energies (slab, cell) evenly over [near, far] [m]: at each edge of a bin the difference of two ramps.

    Only the ends of ramps are scattered, then summed along range, so the cost does not grow with the number of bins.
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
        # The ramp starts at index + part: its mean slope is 1 - part over this bin, and 1 over every later bin.
        changes = changes.at[slab, index].add(sign * density * (1 - part))
        changes = changes.at[slab, index + 1].add(sign * density * part)
    return jnp.cumsum(changes, axis=1)[:, :bins]


def floor_energy(
    azimuth: Float[Array, "beam"], scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]
) -> Float[Array, "range beam"]:
    """Energy [rad/m²] of the bare floor, or of the platform, in each range bin: the elevations that see it between two
    range `edges` (edge,) [m].

    Exact in elevation: for a line at distance d from the sonar head, the point at range r is seen acos(d/r) away from
    the perpendicular. The incidence is that on the floor, not within the slice: its cosine is height / range.
    """
    a, b = floor_line(azimuth, scene.view)
    distance = 1 / jnp.sqrt(a * a + b * b)
    low, high = _floor_span(a, b, scene)
    if sonar.floor is not None:
        start, stop = (bound[:, 0] for bound in platform_span(azimuth, scene, sonar))
        low, high = jnp.maximum(low, start), jnp.minimum(high, stop)
    bounds = jnp.clip(edges[:, None], low, high)
    ratio = jnp.clip(distance / bounds, 0.0, 1.0 - 1e-7)
    angle = jnp.diff(jnp.arccos(ratio), axis=0)
    middle = jnp.maximum((bounds[1:] + bounds[:-1]) / 2, 1e-3)
    return jnp.maximum(angle, 0.0) * strength(middle, jnp.minimum(scene.view.height / middle, 1.0), sonar)


def _floor_span(a: Array, b: Array, scene: Scene) -> tuple[Array, Array]:
    """Nearest and farthest floor range [m] inside the aperture; very far where the horizon is in view."""
    line = jnp.stack(jnp.broadcast_arrays(a, b), -1)
    low, high = (
        interval_range(line, jnp.broadcast_to(tau, a.shape)) for tau in (scene.view.tau_min, scene.view.tau_max)
    )
    return low, high


def floor_angle(distance: Float[Array, "*batch"], sonar: Sonar) -> Float[Array, "*batch"]:
    """Return the elevation that one range bin of bare floor fills.

    It is finite for any distance.

    Args:
        distance: Slant range (*batch) [m].
        sonar: Gives the height and the length of a range bin.

    Returns:
        Elevation (*batch) [rad].
    """
    height = jnp.asarray(sonar.height, jnp.float32)
    aside = jnp.sqrt(jnp.maximum(distance**2 - height**2, (0.1 * height) ** 2))
    return sonar.range_bin * height / (jnp.maximum(distance, height) * aside)


def floor_lit(azimuth: Float[Array, "beam"], scene: Scene, edges: Float[Array, "edge"]) -> Array:
    """Which pixels (range, beam) see the floor inside the aperture at their middle; range `edges` (edge,) [m]."""
    low, high = _floor_span(*floor_line(azimuth, scene.view), scene)
    middle = ((edges[1:] + edges[:-1]) / 2)[:, None]
    return (middle >= low) & (middle <= high)
