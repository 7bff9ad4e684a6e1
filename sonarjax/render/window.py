"""The simulator's core: one window of a sonar image from a surface in the sonar frame (§2.1, eq. 1–2).

Slabs of azimuth (`slices`), triangles cut by their half-planes (`candidates`, `segments`), the exact visible profile
(`envelope`), its ends as differentiable ranges (`profile`), and their footprints in the range bins (`footprint`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import optimization_barrier, stop_gradient
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.candidates import candidates, front_faces
from sonarjax.render.energy import floor_energy, floor_lit, object_energy
from sonarjax.render.envelope import Pieces, visible_pieces
from sonarjax.render.footprint import covered, swept
from sonarjax.render.patch import patch_lit, patch_span
from sonarjax.render.profile import (
    Outline,
    Scene,
    all_ends,
    corners_of,
    find_outline,
    incidence_cosine,
    lit_pieces,
    max_items,
    trace_ranges,
)
from sonarjax.render.segments import Segments, View, cut
from sonarjax.render.slices import GAUSS, Slabs, event_azimuths, make_slabs
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sonar import Sonar


class Window(NamedTuple):
    """A part of the image: `shape` (range, beam) pixels whose first one is (`row`, `column`)."""

    row: Int[Array, ""] | int
    """First range bin."""
    column: Int[Array, ""] | int
    """First beam."""
    shape: tuple[int, int]
    """Number of (range, beam) pixels."""


class Layers(NamedTuple):
    """What is rendered, each (range, beam)."""

    intensity: Float[Array, "range beam"]
    highlight: Float[Array, "range beam"]
    shadow: Float[Array, "range beam"]
    lit: Bool[Array, "range beam"]


class Visible(NamedTuple):
    """The visible profile of every slab; no part of it carries a gradient."""

    pieces: Pieces
    segments: Segments
    table: Int[Array, "slab candidate"]
    outline: Outline


def in_sonar_frame(mesh: Mesh, pose: Pose, sonar: Sonar) -> Scene:
    """The mesh at `pose` as seen from the sonar: vertices (vertex, 3) [m] in the sonar frame, aperture and floor."""
    rotation = rotation_y(sonar.tilt) @ rotation_x(sonar.roll)  # columns: the sonar's axes in the ground frame
    height = jnp.asarray(sonar.height, jnp.float32)
    head = jnp.stack([jnp.zeros_like(height), jnp.zeros_like(height), height])
    reach = jnp.tan(jnp.asarray(sonar.elevation_aperture, jnp.float32) / 2)
    view = View(-reach, reach, rotation[2], height)
    return Scene((pose.to_ground(mesh.vertices) - head) @ rotation, mesh.faces, view)


def find_visible(mesh: Mesh, scene: Scene, slabs: Slabs, sonar: Sonar, elevations: int) -> Visible:
    """The visible profile in the middle of each slab (all of it without a gradient)."""
    fixed = stop_gradient(scene)
    azimuth = stop_gradient(slabs.middle)
    seen = front_faces(fixed.vertices, fixed.faces, mesh.closed)
    # The barriers keep XLA from fusing a stage into each of its uses, which costs compile time and run time alike.
    table = optimization_barrier(candidates(fixed.vertices, fixed.faces, seen, azimuth, mesh.crossings))
    corners = corners_of(fixed, table)
    segments = cut(corners, jnp.broadcast_to(azimuth[:, None], table.shape), fixed.view)
    segments = optimization_barrier(segments._replace(hit=segments.hit & (table >= 0)))
    pieces = optimization_barrier(visible_pieces(segments, elevations))
    lit = jnp.ones(pieces.winner.shape, bool)
    if sonar.highlight_max_incidence < 90.0:
        lit = lit_pieces(incidence_cosine(pieces, segments, corners, azimuth), sonar.highlight_max_incidence)
    outline = optimization_barrier(find_outline(pieces, segments, table, lit, max_items(mesh.crossings)))
    return Visible(pieces, segments, table, outline)


def render_window(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, sub_beams: int, elevations: int) -> Layers:
    """Render one window of the image; layers that are not used cost nothing under `jax.jit`."""
    scene = in_sonar_frame(mesh, pose, sonar)
    rows, columns = window.shape
    azimuth_edges = _columns(jnp.asarray(sonar.azimuth_edges), window.column, columns + 1)
    azimuth = _columns(jnp.asarray(sonar.azimuth), window.column, columns)
    slabs = make_slabs(azimuth_edges, event_azimuths(scene.vertices, mesh.crease), sub_beams)
    visible = find_visible(mesh, scene, slabs, sonar, elevations)
    edges = sonar.range_min + sonar.range_bin * (window.row + jnp.arange(rows + 1, dtype=jnp.float32))
    nodes = slabs.middle + GAUSS * slabs.width * jnp.array([[-1.0], [1.0]])
    ranges = trace_ranges(visible.outline, nodes, scene)
    highlight = _highlight(visible.outline, ranges, slabs, sonar, edges)
    start, stop = patch_span(nodes, scene, sonar)
    shadow = _shadow(visible.outline, jnp.clip(ranges, start[..., None], stop[..., None]), slabs, sonar, edges)
    ends = all_ends(visible.pieces, visible.segments, visible.table)
    echo = _per_beam(slabs, object_energy(ends, slabs, scene, sonar, elevations, edges))
    floor = patch_lit(azimuth, scene, sonar, edges)
    bare = floor_energy(azimuth, scene, sonar, edges) * floor
    lit = (floor_lit(azimuth, scene, edges) & floor) | (highlight > 0.5)
    return Layers(jnp.maximum(echo, 0.0) + bare * (1 - shadow), highlight, shadow, lit)


def _columns(values: Float[Array, "beam"], first: Int[Array, ""] | int, count: int) -> Float[Array, "column"]:
    return jnp.take(values, first + jnp.arange(count), mode="clip")


def _per_beam(slabs: Slabs, values: Float[Array, "slab range"]) -> Float[Array, "range beam"]:
    return (slabs.weights @ values).T


def _highlight(
    outline: Outline,
    ranges: Float[Array, "node slab four item"],
    slabs: Slabs,
    sonar: Sonar,
    edges: Float[Array, "edge"],
) -> Float[Array, "range beam"]:
    """Share of each pixel's range cell that first hits cover; a run is no shorter than the pulse (at least a bin)."""
    bins = (ranges - edges[0]) / sonar.range_bin
    pulse = jnp.maximum(jnp.asarray(sonar.pulse_length, jnp.float32) / sonar.range_bin, 1.0)
    middle = (bins[:, :, 0] + bins[:, :, 1]) / 2
    half = jnp.maximum(bins[:, :, 1] - bins[:, :, 0], pulse) / 2
    share = covered(swept(middle - half), swept(middle + half), outline.runs, _bin_edges(edges))
    return jnp.clip(_per_beam(slabs, jnp.clip(share, 0.0, 1.0)), 0.0, 1.0)


def _shadow(
    outline: Outline,
    ranges: Float[Array, "node slab four item"],
    slabs: Slabs,
    sonar: Sonar,
    edges: Float[Array, "edge"],
) -> Float[Array, "range beam"]:
    """Share of each pixel's floor that is hidden behind an object."""
    bins = (ranges - edges[0]) / sonar.range_bin
    share = covered(swept(bins[:, :, 2]), swept(bins[:, :, 3]), outline.stretches, _bin_edges(edges))
    return jnp.clip(_per_beam(slabs, jnp.clip(share, 0.0, 1.0)), 0.0, 1.0)


def _bin_edges(edges: Float[Array, "edge"]) -> Float[Array, "edge"]:
    return jnp.arange(len(edges), dtype=jnp.float32)
