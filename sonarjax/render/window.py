"""The simulator's core: one window of a sonar image from a surface in the sonar frame (§2.1, eq. 1–2).

Its stages, a file each: azimuth `slabs`; the triangles that each may see, cut by its half-plane (`candidates`,
`segments`); their visible intervals (`visibility`); echo spans and occluded spans with differentiable ends (`spans`);
and how much of each range bin these cover (`rasterise`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from sonarjax.render.candidates import candidates, front_faces
from sonarjax.render.energy import floor_energy, floor_lit, object_energy
from sonarjax.render.frame import RenderQuality, SonarFrame, Window
from sonarjax.render.materialise import materialised
from sonarjax.render.platform import platform_lit, platform_span
from sonarjax.render.rasterise import covered, spread
from sonarjax.render.segments import Segments, View, cut
from sonarjax.render.slabs import Slabs, event_azimuths, make_slabs
from sonarjax.render.spans import (
    Scene,
    Spans,
    all_ends,
    corners_of,
    facet_width,
    find_spans,
    incidence_cosine,
    lit_intervals,
    max_items,
    trace_ranges,
)
from sonarjax.render.visibility import VisibleIntervals, is_sampled, visible_intervals
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sonar import Sonar

STEEPEST = 2.0  # slope in range per arc length [1] up to which a facet stands for its neighbours in the slab


class VisibleProfile(NamedTuple):
    """The visible profile of every slab; no part of it carries a gradient."""

    intervals: VisibleIntervals
    """Which candidate is nearest at which elevations."""
    segments: Segments
    """The candidates, cut by the slab's half-plane: fields (slab, candidate, ...)."""
    table: Int[Array, "slab candidate"]
    """Triangle that each candidate is, or -1."""
    spans: Spans
    """Echo spans of the object, and spans of hidden floor."""
    overflow: Int[Array, ""]
    """Triangles for which the fullest slice had no room."""


def in_sonar_frame(mesh: Mesh, pose: Pose, sonar: Sonar) -> Scene:
    """The mesh at `pose` as seen from the sonar: vertices (vertex, 3) [m] in the sonar frame, aperture and floor."""
    rotation = rotation_y(sonar.tilt) @ rotation_x(sonar.roll)  # columns: the sonar's axes in the ground frame
    height = jnp.asarray(sonar.height, jnp.float32)
    head = jnp.stack([jnp.zeros_like(height), jnp.zeros_like(height), height])
    reach = jnp.tan(jnp.asarray(sonar.elevation_aperture, jnp.float32) / 2)
    view = View(-reach, reach, rotation[2], height)
    return Scene((pose.to_ground(mesh.vertices) - head) @ rotation, mesh.faces, view)


class Objects(NamedTuple):
    """Which of several objects in one mesh each of its triangles belongs to."""

    owner: Int[Array, "face"]
    """Number of the object, from 0."""
    total: int
    """How many there are."""


def find_visible(
    mesh: Mesh, scene: Scene, slabs: Slabs, sonar: Sonar, elevations: int, by_facet: Bool[Array, ""] | bool = False,
    objects: Objects | None = None,
) -> VisibleProfile:  # fmt: skip
    """The visible profile in the middle of each slab (none of it with a gradient); `by_facet` as in `find_spans`.

    With `objects`, no span is of two of them.
    """
    fixed = stop_gradient(scene)
    azimuth = stop_gradient(slabs.middle)
    seen = front_faces(fixed.vertices, fixed.faces, mesh.closed)
    # The barriers keep XLA from fusing a stage into each of its uses, which costs compile time and run time alike.
    table, overflow = candidates(fixed.vertices, fixed.faces, seen, azimuth, mesh.crossings, mesh.front)
    shared = corners_of(fixed, table) if len(table) == 1 else None  # of one list for all slabs: looked up once
    table = jnp.broadcast_to(table, (len(azimuth), table.shape[1]))

    def cut_slabs(azimuth: Array, table: Array) -> Segments:
        segments = cut(corners_of(fixed, table) if shared is None else shared, azimuth[:, None], fixed.view)
        return segments._replace(hit=segments.hit & (table >= 0))

    def spans_of(intervals: VisibleIntervals, segments: Segments, table: Array, azimuth: Array) -> Spans:
        lit = jnp.ones(intervals.winner.shape, bool)
        if sonar.highlight_max_incidence < 90.0:
            cosine = incidence_cosine(intervals, segments, corners_of(fixed, table), azimuth)
            lit = lit_intervals(cosine, sonar.highlight_max_incidence)
        items = max_items(mesh.crossings, by_facet is not False, 0 if objects is None else objects.total)
        owner = None
        if objects is not None:
            owner = objects.owner[jnp.take_along_axis(table, jnp.maximum(intervals.winner, 0), axis=1)]
        return find_spans(intervals, segments, table, lit, items, is_sampled(segments), by_facet, owner)

    segments = materialised(cut_slabs, azimuth, table)
    intervals = visible_intervals(segments, mesh.intersecting, elevations)
    spans = materialised(spans_of, intervals, segments, table, azimuth)
    return VisibleProfile(intervals, segments, table, spans, overflow)


def render_window(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality) -> SonarFrame:
    """Render one window of the image: slabs → candidates → visible intervals → spans → rasterise.

    Layers that are not used cost nothing under `jax.jit`.
    """
    return render_objects(mesh, None, pose, sonar, window, quality)[0]


class ObjectLayers(NamedTuple):
    """What each of several objects shows, and hides, in one frame: what another one hides of it is not there."""

    highlight: Float[Array, "object range beam"]
    """As in `SonarFrame`, of first hits of this object."""
    shadow: Float[Array, "object range beam"]
    """As in `SonarFrame`: floor that this object is the first to hide."""


def render_objects(
    mesh: Mesh, objects: Objects | None, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality
) -> tuple[SonarFrame, ObjectLayers | None]:
    """As `render_window`, and what each of the `objects` in the mesh adds to highlight and shadow."""
    elevations = quality.elevations
    rows, columns = window.shape
    scene = in_sonar_frame(mesh, pose, sonar)
    slabs = _slabs_of(mesh, scene, sonar, window, quality.sub_beams)
    visible = find_visible(mesh, scene, slabs, sonar, elevations, objects=objects)
    edges, azimuth = _edges_of(sonar, window), _columns(jnp.asarray(sonar.azimuth), window.column, columns)
    echo_spans, occluded_spans = _swept_ends(visible.spans, slabs, scene, sonar, edges)
    echo_spans = _pulsed(*echo_spans, sonar)
    highlight = _per_beam(slabs, covered(*echo_spans, visible.spans.echo_spans, rows))
    shadow = _per_beam(slabs, covered(*occluded_spans, visible.spans.occluded_spans, rows))
    ends = all_ends(visible.intervals, visible.segments, visible.table)
    echo = _per_beam(slabs, object_energy(ends, slabs, scene, sonar, elevations, edges, mesh.reflectivity))
    floor = platform_lit(azimuth, scene, sonar, edges)
    bare = floor_energy(azimuth, scene, sonar, edges) * floor
    lit = (floor_lit(azimuth, scene, edges) & floor) | (highlight > 0.5)
    intensity = jnp.maximum(echo, 0.0) + bare * jnp.maximum(1 - shadow, 0.0)
    frame = SonarFrame(intensity, highlight, shadow, lit, visible.overflow, sonar)
    if objects is None:
        return frame, None
    spans, n_echo, n_occluded = visible.spans, visible.spans.echo_spans.shape[1], visible.spans.occluded_spans.shape[1]
    owner = objects.owner[jnp.maximum(spans.ends.surface, 0)]
    of_echo, of_occluded = owner[:, :n_echo], owner[:, 2 * n_echo : 2 * n_echo + n_occluded]

    def layers(number: Array) -> ObjectLayers:
        shown = covered(*echo_spans, spans.echo_spans & (of_echo == number), rows)
        hidden = covered(*occluded_spans, spans.occluded_spans & (of_occluded == number), rows)
        return ObjectLayers(_per_beam(slabs, shown), _per_beam(slabs, hidden))

    return frame, jax.lax.map(layers, jnp.arange(objects.total))


class EchoLayers(NamedTuple):
    """What an object's facets send back, each (range, beam)."""

    echo: Float[Array, "range beam"]
    """Elevation [rad] that first hits of the object fill."""
    highlight: Float[Array, "range beam"]
    """As in `SonarFrame`; by facet, each shows at least a pulse."""
    shadow: Float[Array, "range beam"]
    """As in `SonarFrame`."""


def render_echo(
    mesh: Mesh,
    pose: Pose,
    sonar: Sonar,
    window: Window,
    quality: RenderQuality,
    by_facet: Bool[Array, ""] | bool = True,
) -> EchoLayers:
    """The object's echo facet by facet, its highlight and its shadow in a window of the image.

    The elevation that first hits fill, times the spreading that eq. 2 has for each range, is the object's energy as
    `render_window` has it, at the cost of its highlight: a facet's elevation is spread evenly over the ranges that it
    shows in a slab. How much elevation that is carries no gradient, only where it falls, and does not depend on
    incidence (`sonar.lambert` plays no part). Where `by_facet` is false, a smooth chain of facets is one: the highlight
    is then `render_window`'s, and the echo is even over the chain.
    """
    rows = window.shape[0]
    scene = in_sonar_frame(mesh, pose, sonar)
    slabs = _slabs_of(mesh, scene, sonar, window, quality.sub_beams)
    spans = find_visible(mesh, scene, slabs, sonar, quality.elevations, jnp.asarray(by_facet)).spans
    echo_spans, occluded_spans = _swept_ends(spans, slabs, scene, sonar, _edges_of(sonar, window))
    shown = _pulsed(*echo_spans, sonar)
    length = stop_gradient(shown[0][:, 1] - shown[0][:, 0])
    density = jnp.where(spans.echo_spans, spans.angle / jnp.maximum(length, 1.0), 0.0)
    echo = jnp.maximum(_per_beam(slabs, spread(*shown, density, rows)), 0.0)
    highlight = _per_beam(slabs, covered(*shown, spans.echo_spans, rows))
    return EchoLayers(echo, highlight, _per_beam(slabs, covered(*occluded_spans, spans.occluded_spans, rows)))


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
    spans: Spans, slabs: Slabs, scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Both ends (slab, 2, item) [bins] of echo spans mid-slab, and half their sweep; the same of occluded spans."""

    def bins(azimuth: Float[Array, "slab"]) -> Float[Array, "slab end"]:
        ranges = trace_ranges(spans, azimuth, scene)
        if sonar.floor is not None:  # only a floor that is there is hidden
            ranges = jnp.where(spans.on_object, ranges, jnp.clip(ranges, *platform_span(azimuth, scene, sonar)))
        return (ranges - edges[0]) / sonar.range_bin

    middle, slope = jax.jvp(bins, (slabs.middle,), (jnp.ones_like(slabs.middle),))
    # A facet narrower than the slab is followed only as far as it reaches, or as a surface of STEEPEST would be.
    half_width = (slabs.width / 2)[:, None]
    reach = facet_width(spans, slabs.middle, scene)
    steep = STEEPEST * (middle + edges[0] / sonar.range_bin) / jnp.maximum(jnp.abs(slope), 1e-6)
    half = slope * stop_gradient(jnp.minimum(half_width, jnp.maximum(reach, steep * half_width)))
    n_object = 2 * spans.echo_spans.shape[1]  # the first ends lie on the object, the others on the floor
    echo_spans = _pairs(middle[:, :n_object]), _pairs(half[:, :n_object])
    return echo_spans, (_pairs(middle[:, n_object:]), _pairs(half[:, n_object:]))


def _pulsed(
    middle: Float[Array, "slab 2 echo_span"], half: Float[Array, "slab 2 echo_span"], sonar: Sonar
) -> tuple[Float[Array, "slab 2 echo_span"], Float[Array, "slab 2 echo_span"]]:
    """Runs no shorter than the pulse (at least a bin)."""
    pulse = jnp.maximum(jnp.asarray(sonar.pulse_length, jnp.float32) / sonar.range_bin, 1.0)
    short = (middle[:, 1] - middle[:, 0] < pulse)[:, None]
    grown = middle.mean(axis=1, keepdims=True) + pulse * jnp.array([[-0.5], [0.5]])
    return jnp.where(short, grown, middle), jnp.where(short, half.mean(axis=1, keepdims=True), half)
