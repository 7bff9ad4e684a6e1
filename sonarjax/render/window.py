"""The simulator's core: one window of a sonar image from a surface in the sonar frame (§2.1, eq. 1–2).

Slabs of azimuth (`slices`), triangles cut by their half-planes (`candidates`, `segments`), the exact visible profile
(`envelope`), its ends as differentiable ranges (`profile`), and their footprints in the range bins (`footprint`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.candidates import candidates, front_faces
from sonarjax.render.energy import floor_energy, floor_lit, object_energy
from sonarjax.render.envelope import Pieces, is_sampled, visible_pieces
from sonarjax.render.footprint import covered, spread
from sonarjax.render.patch import patch_lit, patch_span
from sonarjax.render.profile import (
    Outline,
    Scene,
    all_ends,
    corners_of,
    facet_width,
    find_outline,
    incidence_cosine,
    lit_pieces,
    max_items,
    trace_ranges,
)
from sonarjax.render.segments import Segments, View, cut
from sonarjax.render.slices import Slabs, event_azimuths, make_slabs
from sonarjax.render.stage import computed_once
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sonar import Sonar

STEEPEST = 2.0  # slope in range per arc length [1] up to which a facet stands for its neighbours in the slab


class Window(NamedTuple):
    """A part of the image: `shape` (range, beam) pixels whose first one is (`row`, `column`)."""

    row: Int[Array, ""] | int
    """First range bin."""
    column: Int[Array, ""] | int
    """First beam."""
    shape: tuple[int, int]
    """Number of (range, beam) pixels."""
    object_columns: int | None = None
    """Upper bound of the beams that the object itself touches; None for all. Only they are looked at."""


class Layers(NamedTuple):
    """What is rendered, each (range, beam)."""

    intensity: Float[Array, "range beam"]
    """Energy of first hits per range bin, objects and floor [rad/m²]."""
    highlight: Float[Array, "range beam"]
    """Share of the pixel's range cell covered by first hits of the object, 0 to 1."""
    shadow: Float[Array, "range beam"]
    """Share of the pixel's floor hidden behind the object, 0 to 1."""
    lit: Bool[Array, "range beam"]
    """True where the floor is insonified, or the object is seen."""


class Visible(NamedTuple):
    """The visible profile of every slab; no part of it carries a gradient."""

    pieces: Pieces
    """Which candidate is nearest at which elevations."""
    segments: Segments
    """The candidates, cut by the slab's half-plane: fields (slab, candidate, ...)."""
    table: Int[Array, "slab candidate"]
    """Triangle that each candidate is, or -1."""
    outline: Outline
    """Runs of the object and stretches of hidden floor."""


def in_sonar_frame(mesh: Mesh, pose: Pose, sonar: Sonar) -> Scene:
    """The mesh at `pose` as seen from the sonar: vertices (vertex, 3) [m] in the sonar frame, aperture and floor."""
    rotation = rotation_y(sonar.tilt) @ rotation_x(sonar.roll)  # columns: the sonar's axes in the ground frame
    height = jnp.asarray(sonar.height, jnp.float32)
    head = jnp.stack([jnp.zeros_like(height), jnp.zeros_like(height), height])
    reach = jnp.tan(jnp.asarray(sonar.elevation_aperture, jnp.float32) / 2)
    view = View(-reach, reach, rotation[2], height)
    return Scene((pose.to_ground(mesh.vertices) - head) @ rotation, mesh.faces, view)


def find_visible(
    mesh: Mesh, scene: Scene, slabs: Slabs, sonar: Sonar, elevations: int, by_facet: bool = False
) -> Visible:
    """The visible profile in the middle of each slab (all of it without a gradient)."""
    fixed = stop_gradient(scene)
    azimuth = stop_gradient(slabs.middle)
    seen = front_faces(fixed.vertices, fixed.faces, mesh.closed)
    # The barriers keep XLA from fusing a stage into each of its uses, which costs compile time and run time alike.
    table = candidates(fixed.vertices, fixed.faces, seen, azimuth, mesh.crossings, mesh.front)
    table = jnp.broadcast_to(table, (len(azimuth), table.shape[1]))

    def cut_slabs(azimuth: Array, table: Array) -> Segments:
        segments = cut(corners_of(fixed, table), azimuth[:, None], fixed.view)
        return segments._replace(hit=segments.hit & (table >= 0))

    def outline_of(pieces: Pieces, segments: Segments, table: Array, azimuth: Array) -> Outline:
        lit = jnp.ones(pieces.winner.shape, bool)
        if sonar.highlight_max_incidence < 90.0:
            cosine = incidence_cosine(pieces, segments, corners_of(fixed, table), azimuth)
            lit = lit_pieces(cosine, sonar.highlight_max_incidence)
        items = max_items(mesh.crossings, by_facet)
        return find_outline(pieces, segments, table, lit, items, is_sampled(segments), by_facet)

    segments = computed_once(cut_slabs, azimuth, table)
    pieces = visible_pieces(segments, mesh.crossing, elevations)
    outline = computed_once(outline_of, pieces, segments, table, azimuth)
    return Visible(pieces, segments, table, outline)


def render_window(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, sub_beams: int, elevations: int) -> Layers:
    """Render one window of the image; layers that are not used cost nothing under `jax.jit`."""
    rows, columns = window.shape
    scene = in_sonar_frame(mesh, pose, sonar)
    slabs = _slabs_of(mesh, scene, sonar, window, sub_beams)
    visible = find_visible(mesh, scene, slabs, sonar, elevations)
    edges, azimuth = _edges_of(sonar, window), _columns(jnp.asarray(sonar.azimuth), window.column, columns)
    runs, stretches = _swept_ends(visible.outline, slabs, scene, sonar, edges)
    highlight = _per_beam(slabs, covered(*_pulsed(*runs, sonar), visible.outline.runs, rows))
    shadow = _per_beam(slabs, covered(*stretches, visible.outline.stretches, rows))
    ends = all_ends(visible.pieces, visible.segments, visible.table)
    echo = _per_beam(slabs, object_energy(ends, slabs, scene, sonar, elevations, edges))
    floor = patch_lit(azimuth, scene, sonar, edges)
    bare = floor_energy(azimuth, scene, sonar, edges) * floor
    lit = (floor_lit(azimuth, scene, edges) & floor) | (highlight > 0.5)
    return Layers(jnp.maximum(echo, 0.0) + bare * jnp.maximum(1 - shadow, 0.0), highlight, shadow, lit)


def render_echo(
    mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, sub_beams: int, elevations: int
) -> tuple[Float[Array, "range beam"], Float[Array, "range beam"]]:
    """Elevation [rad] that an object's first hits fill in each pixel of a window, and its shadow: both (range, beam).

    Times the spreading that eq. 2 has for each range this is the object's energy as `render_window` has it, at the cost
    of its highlight: a facet's elevation is spread evenly over the ranges that it shows in a slab. How much elevation
    that is carries no gradient, only where it falls, and does not depend on incidence (`sonar.lambert` plays no part).
    """
    rows = window.shape[0]
    scene = in_sonar_frame(mesh, pose, sonar)
    slabs = _slabs_of(mesh, scene, sonar, window, sub_beams)
    outline = find_visible(mesh, scene, slabs, sonar, elevations, by_facet=True).outline
    runs, stretches = _swept_ends(outline, slabs, scene, sonar, _edges_of(sonar, window))
    shown = _pulsed(*runs, sonar)
    length = stop_gradient(shown[0][:, 1] - shown[0][:, 0])
    density = jnp.where(outline.runs, outline.angle / jnp.maximum(length, 1.0), 0.0)
    echo = jnp.maximum(_per_beam(slabs, spread(*shown, density, rows)), 0.0)
    return echo, _per_beam(slabs, covered(*stretches, outline.stretches, rows))


def _slabs_of(mesh: Mesh, scene: Scene, sonar: Sonar, window: Window, sub_beams: int) -> Slabs:
    azimuth_edges = _columns(jnp.asarray(sonar.azimuth_edges), window.column, window.shape[1] + 1)
    events = event_azimuths(scene.vertices, scene.faces, mesh.crease, mesh.events)
    return make_slabs(azimuth_edges, events, sub_beams, window.object_columns)


def _edges_of(sonar: Sonar, window: Window) -> Float[Array, "edge"]:
    return sonar.range_min + sonar.range_bin * (window.row + jnp.arange(window.shape[0] + 1, dtype=jnp.float32))


def _columns(values: Float[Array, "beam"], first: Int[Array, ""] | int, count: int) -> Float[Array, "column"]:
    return jnp.take(values, first + jnp.arange(count), mode="clip")


def _per_beam(slabs: Slabs, values: Float[Array, "slab range"]) -> Float[Array, "range beam"]:
    return (slabs.weights @ values).T


def _pairs(ends: Float[Array, "slab end"]) -> Float[Array, "slab 2 item"]:
    return ends.reshape(len(ends), 2, -1)


def _swept_ends(
    outline: Outline, slabs: Slabs, scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Both ends (slab, 2, run) [bins] in the middle of each slab, and half their sweep; the same of the stretches."""

    def bins(azimuth: Float[Array, "slab"]) -> Float[Array, "slab end"]:
        ranges = trace_ranges(outline, azimuth, scene)
        if sonar.floor is not None:  # only a floor that is there is hidden
            ranges = jnp.where(outline.on_object, ranges, jnp.clip(ranges, *patch_span(azimuth, scene, sonar)))
        return (ranges - edges[0]) / sonar.range_bin

    middle, slope = jax.jvp(bins, (slabs.middle,), (jnp.ones_like(slabs.middle),))
    # A facet narrower than the slab is followed only as far as it reaches, or as a surface of STEEPEST would be.
    half_width = (slabs.width / 2)[:, None]
    reach = facet_width(outline, slabs.middle, scene)
    steep = STEEPEST * (middle + edges[0] / sonar.range_bin) / jnp.maximum(jnp.abs(slope), 1e-6)
    half = slope * stop_gradient(jnp.minimum(half_width, jnp.maximum(reach, steep * half_width)))
    n_object = 2 * outline.runs.shape[1]  # the first ends lie on the object, the others on the floor
    runs = _pairs(middle[:, :n_object]), _pairs(half[:, :n_object])
    return runs, (_pairs(middle[:, n_object:]), _pairs(half[:, n_object:]))


def _pulsed(
    middle: Float[Array, "slab 2 run"], half: Float[Array, "slab 2 run"], sonar: Sonar
) -> tuple[Float[Array, "slab 2 run"], Float[Array, "slab 2 run"]]:
    """Runs no shorter than the pulse (at least a bin)."""
    pulse = jnp.maximum(jnp.asarray(sonar.pulse_length, jnp.float32) / sonar.range_bin, 1.0)
    short = (middle[:, 1] - middle[:, 0] < pulse)[:, None]
    grown = middle.mean(axis=1, keepdims=True) + pulse * jnp.array([[-0.5], [0.5]])
    return jnp.where(short, grown, middle), jnp.where(short, half.mean(axis=1, keepdims=True), half)
