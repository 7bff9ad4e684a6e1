"""The simulator's core: render one window of a sonar image from a surface in the sonar frame (§2.1, eq. 1–2).

The stages, each in its own file: azimuth slabs (`slabs`); the triangles that each slab may see, cut by its half-plane
(`candidates`, `segments`); the visible intervals (`visibility`); echo spans and occluded spans with differentiable ends
(`spans`); the share of each range bin that the spans cover (`rasterise`).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from sonarjax.exact import check_single_precision, full_precision
from sonarjax.render.candidates import candidates, front_faces
from sonarjax.render.energy import floor_energy, floor_lit, object_energy
from sonarjax.render.frame import RenderQuality, SonarFrame, Window
from sonarjax.render.materialise import materialised
from sonarjax.render.platform import platform_lit, platform_span
from sonarjax.render.rasterise import covered, covered_and_spread, covered_by_each, covered_by_two, spread
from sonarjax.render.segments import Segments, View, cut
from sonarjax.render.slabs import Slabs, event_azimuths, make_slabs, per_beam
from sonarjax.render.spans import (
    Scene,
    Spans,
    all_ends,
    corners_of,
    facet_width,
    find_spans,
    incidence_cosine,
    kept_by_limit,
    max_items,
    trace_ranges,
)
from sonarjax.render.visibility import VisibleIntervals, is_sampled, visible_intervals
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sonar import Sonar

STEEPEST = 2.0  # up to this slope [m of range per m of arc], a facet narrower than its slab stands for its neighbours


class VisibleProfile(NamedTuple):
    """The visible profile of every slab. Nothing in it carries a gradient, save that of `Spans.kept`."""

    intervals: VisibleIntervals
    """Which candidate is nearest at which elevations."""
    segments: Segments
    """The candidates, cut by the slab's half-plane; fields are (slab, candidate, ...)."""
    table: Int[Array, "slab candidate"]
    """Triangle id of each candidate, or -1."""
    spans: Spans
    """Echo spans and occluded spans."""
    overflow: Int[Array, ""]
    """How many triangles the fullest slice had no room for."""


@full_precision
def in_sonar_frame(mesh: Mesh, pose: Pose, sonar: Sonar) -> Scene:
    """The mesh at `pose` seen from the sonar: vertices (vertex, 3) [m] in the sonar frame, aperture and floor."""
    check_single_precision()
    rotation = rotation_y(sonar.tilt) @ rotation_x(sonar.roll)  # columns: the sonar's axes in the ground frame
    height = jnp.asarray(sonar.height, jnp.float32)
    head = jnp.stack([jnp.zeros_like(height), jnp.zeros_like(height), height])
    reach = jnp.tan(jnp.asarray(sonar.elevation_aperture, jnp.float32) / 2)
    view = View(-reach, reach, rotation[2], height)
    return Scene((pose.to_ground(mesh.vertices) - head) @ rotation, mesh.faces, view)


class Objects(NamedTuple):
    """Which object each triangle belongs to, in a mesh that holds several."""

    owner: Int[Array, "face"]
    """Number of the object, from 0."""
    total: int
    """Number of objects."""


def find_visible(
    mesh: Mesh, scene: Scene, slabs: Slabs, sonar: Sonar, elevations: int, by_facet: Bool[Array, ""] | bool = False,
    objects: Objects | None = None,
) -> VisibleProfile:  # fmt: skip
    """Find the visible profile in the middle of each slab. Nothing in it carries a gradient, save that of `Spans.kept`.

    `by_facet` as in `find_spans`. If `objects` are given, no span joins two of them.
    """
    fixed = stop_gradient(scene)
    azimuth, limit = stop_gradient(slabs.middle), jnp.asarray(sonar.highlight_max_incidence, jnp.float32)
    seen = front_faces(fixed.vertices, fixed.faces, mesh.closed)
    # `materialised` keeps XLA from fusing a stage into each of its uses, which would cost compile time and run time.
    table, overflow = candidates(fixed.vertices, fixed.faces, seen, azimuth, mesh.crossings, mesh.front)
    shared = corners_of(fixed, table) if len(table) == 1 else None  # of one list for all slabs: looked up once
    table = jnp.broadcast_to(table, (len(azimuth), table.shape[1]))

    def cut_slabs(azimuth: Array, table: Array) -> Segments:
        segments = cut(corners_of(fixed, table) if shared is None else shared, azimuth[:, None], fixed.view)
        return segments._replace(hit=segments.hit & (table >= 0))

    def spans_of(intervals: VisibleIntervals, segments: Segments, table: Array, azimuth: Array) -> Spans:
        def limited() -> Array:
            return kept_by_limit(incidence_cosine(intervals, corners_of(fixed, table), azimuth), limit)

        kept = jax.lax.cond(limit < 90, limited, lambda: jnp.ones(intervals.winner.shape))
        items = max_items(mesh.crossings, by_facet is not False, 0 if objects is None else objects.total, mesh.n_faces)
        owner = None
        if objects is not None:
            owner = objects.owner[jnp.take_along_axis(table, jnp.maximum(intervals.winner, 0), axis=1)]
        return find_spans(intervals, segments, table, kept, items, is_sampled(segments), by_facet, owner)

    segments = materialised(cut_slabs, azimuth, table)
    intervals = visible_intervals(segments, mesh.intersecting, elevations)
    spans = materialised(spans_of, intervals, segments, table, azimuth)
    return VisibleProfile(intervals, segments, table, spans, overflow)


def render_window(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality) -> SonarFrame:
    """Render one window of the image: slabs → candidates → visible intervals → spans → rasterise.

    Under `jax.jit`, layers of the frame that are not used cost nothing. Unlike `render`, this does not render again if
    the mesh has too little room; see `overflow` of the frame.

    Args:
        mesh: One mesh, not stacked.
        pose: One pose [m, rad].
        sonar: The sonar that looks.
        window: The part of the image to render.
        quality: How finely to render.

    Returns:
        Frame of the window (range, beam).
    """
    seen = _look(mesh, None, pose, sonar, window, quality)
    return _frame_of(seen, _shares(seen), _echo(seen, mesh, quality), window)


def render_afloat(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality) -> SonarFrame:
    """As `render_window` for an object without a floor in view: no floor energy, and no shadow."""
    seen = _look(mesh, None, pose, sonar, window, quality)
    highlight = covered(*seen.echo_spans, seen.visible.spans.echo_spans, seen.slabs.weights, window.shape[0])
    echo = jnp.maximum(_echo(seen, mesh, quality), 0.0)
    return SonarFrame(echo, highlight, jnp.zeros_like(highlight), highlight > 0.5, seen.visible.overflow, sonar)


class ObjectLayers(NamedTuple):
    """What each of several objects shows and hides in one frame. Parts of it that another object hides are left out."""

    highlight: Float[Array, "object range beam"]
    """As in `SonarFrame`, for first hits of this object only."""
    shadow: Float[Array, "object range beam"]
    """As in `SonarFrame`, for floor that this object is the first to hide."""


def render_objects(
    mesh: Mesh, objects: Objects, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality,
    apart: Bool[Array, ""] | bool,
) -> tuple[SonarFrame, ObjectLayers]:  # fmt: skip
    """As `render_window`, and if `apart`, also the layers of each of the `objects` in the mesh.

    With `apart`, the frame's intensity leaves out the objects' echoes: labels do not need them, and they are a third of
    the work. Without it, the layers are zero.
    """
    seen = _look(mesh, objects, pose, sonar, window, quality)
    rows, beams = window.shape

    def told_apart() -> tuple[tuple[Array, Array], Array, ObjectLayers]:
        spans, owner = seen.visible.spans, objects.owner[jnp.maximum(seen.visible.spans.ends.surface, 0)]
        n_echo, n_occluded = spans.echo_spans.shape[1], spans.occluded_spans.shape[1]
        occluded = slice(2 * n_echo, 2 * n_echo + n_occluded)  # of all ends, those are the spans' lower ones

        def by_owner(ends: tuple[Array, Array], present: Array, owner: Array) -> tuple[Array, Array]:
            return covered_by_each(*ends, present, seen.slabs.weights, rows, owner, objects.total)

        shown, highlights = by_owner(seen.echo_spans, spans.echo_spans, owner[:, :n_echo])
        hidden, shadows = by_owner(seen.occluded_spans, spans.occluded_spans, owner[:, occluded])
        return (shown, hidden), jnp.zeros((rows, beams)), ObjectLayers(highlights, shadows)

    def together() -> tuple[tuple[Array, Array], Array, ObjectLayers]:
        none = jnp.zeros((objects.total, rows, beams))
        return _shares(seen), _echo(seen, mesh, quality), ObjectLayers(none, none)

    shares, echo, layers = jax.lax.cond(apart, told_apart, together)
    return _frame_of(seen, shares, echo, window), layers


class _Seen(NamedTuple):
    """What is visible in a window, before it is rasterised into range bins."""

    scene: Scene
    """The surface in the sonar frame."""
    slabs: Slabs
    """Azimuth slabs."""
    visible: VisibleProfile
    """The visible profile in the middle of each slab."""
    echo_spans: tuple[Array, Array]
    """Ends (slab, 2, item) [bins] of echo spans in the middle of the slab, and half of how far they sweep."""
    occluded_spans: tuple[Array, Array]
    """The same for occluded spans."""
    edges: Float[Array, "edge"]
    """Range bin edges [m]."""
    sonar: Sonar
    """The sonar."""


def _look(
    mesh: Mesh, objects: Objects | None, pose: Pose, sonar: Sonar, window: Window, quality: RenderQuality,
    by_facet: Bool[Array, ""] | bool = False,
) -> _Seen:  # fmt: skip
    """The first four stages; `by_facet` as in `find_spans`."""
    scene = in_sonar_frame(mesh, pose, sonar)
    slabs = _slabs_of(mesh, scene, sonar, window, quality.sub_beams)
    visible = find_visible(mesh, scene, slabs, sonar, quality.elevations, by_facet, objects)
    edges = _edges_of(sonar, window)
    echo_spans, occluded_spans = _swept_ends(visible.spans, slabs, scene, sonar, edges)
    return _Seen(scene, slabs, visible, _pulsed(*echo_spans, sonar), occluded_spans, edges, sonar)


def _shares(seen: _Seen) -> tuple[Float[Array, "range beam"], Float[Array, "range beam"]]:
    """Highlight and shadow, each (range, beam)."""
    spans, pixels = seen.visible.spans, (seen.slabs.weights, len(seen.edges) - 1)
    return covered_by_two((*seen.echo_spans, spans.echo_spans), (*seen.occluded_spans, spans.occluded_spans), *pixels)


def _echo(seen: _Seen, mesh: Mesh, quality: RenderQuality) -> Float[Array, "range beam"]:
    """Energy (range, beam) that first hits on objects send back (eq. 2)."""
    visible = seen.visible
    ends = all_ends(visible.intervals, visible.segments, visible.table, mesh.reflectivity, seen.sonar.lambert)
    energy = object_energy(ends, seen.slabs, seen.scene, seen.sonar, quality.elevations, seen.edges, mesh.reflectivity)
    return per_beam(seen.slabs.weights, energy[:, None])[0]


def _frame_of(seen: _Seen, shares: tuple[Array, Array], echo: Array, window: Window) -> SonarFrame:
    """The frame, given highlight and shadow (`shares`) and the objects' energy (`echo`); adds the floor's energy."""
    (highlight, shadow), scene, sonar, edges = shares, seen.scene, seen.sonar, seen.edges
    azimuth = _columns(jnp.asarray(sonar.azimuth), window.column, window.shape[1])
    floor = platform_lit(azimuth, scene, sonar, edges)
    bare = floor_energy(azimuth, scene, sonar, edges)
    lit = (floor_lit(azimuth, scene, edges) & floor) | (highlight > 0.5)
    intensity = jnp.maximum(echo, 0.0) + bare * jnp.maximum(1 - shadow, 0.0)
    return SonarFrame(intensity, highlight, shadow, lit, seen.visible.overflow, sonar)


class EchoLayers(NamedTuple):
    """An object's echo, highlight and shadow, each (range, beam)."""

    echo: Float[Array, "range beam"]
    """Elevation [rad] that first hits of the object fill."""
    highlight: Float[Array, "range beam"]
    """As in `SonarFrame`. If rendered by facet, every facet shows at least one pulse length."""
    shadow: Float[Array, "range beam"]
    """As in `SonarFrame`."""


def render_echo(
    mesh: Mesh,
    pose: Pose,
    sonar: Sonar,
    window: Window,
    quality: RenderQuality,
    by_facet: Bool[Array, ""] | bool = True,
    shares: Bool[Array, ""] | bool = True,
) -> EchoLayers:
    """Render an object's echo facet by facet, with its highlight and shadow, in a window of the image.

    The echo is the elevation that first hits fill. Multiplied by eq. 2's spreading for each range, it is the object's
    energy as in `render_window`, at the cost of a highlight: a facet's elevation is spread evenly over the ranges that
    it shows in a slab. The gradient covers where this elevation falls, not how much it is. Of the incidence, the echo
    only knows the limit `sonar.highlight_max_incidence` (`sonar.lambert` is not used): by facet it fades about the
    limit, with a gradient by it, else it ends there. On round bodies the gradient is right in sum, not pixel by pixel.

    Args:
        mesh: One mesh, not stacked.
        pose: One pose [m, rad].
        sonar: The sonar that looks.
        window: The part of the image to render.
        quality: How finely to render.
        by_facet: If false, a smooth chain of facets counts as one. The highlight is then that of `render_window`, and
            the echo is even over the chain.
        shares: If false, only the echo is rendered; highlight and shadow are zero.

    Returns:
        Layers of the window, each (range, beam): `echo` [rad], `highlight` and `shadow` [1].
    """
    seen = _look(mesh, None, pose, sonar, window, quality, jnp.asarray(by_facet))
    spans, shown, pixels = seen.visible.spans, seen.echo_spans, (seen.slabs.weights, window.shape[0])
    length = stop_gradient(shown[0][:, 1] - shown[0][:, 0])
    density = jnp.where(spans.echo_spans, spans.angle * spans.kept / jnp.maximum(length, 1.0), 0.0)
    highlighted = spans.echo_spans & (spans.kept >= 0.5)

    def all_three() -> EchoLayers:
        highlight, echo = covered_and_spread(*shown, highlighted, *pixels, density)
        return EchoLayers(echo, highlight, covered(*seen.occluded_spans, spans.occluded_spans, *pixels))

    def echo_alone() -> EchoLayers:
        echo = spread(*shown, *pixels, density)
        return EchoLayers(echo, jnp.zeros_like(echo), jnp.zeros_like(echo))

    return jax.lax.cond(jnp.asarray(shares), all_three, echo_alone)


def _slabs_of(mesh: Mesh, scene: Scene, sonar: Sonar, window: Window, sub_beams: int) -> Slabs:
    azimuth_edges = _columns(jnp.asarray(sonar.azimuth_edges), window.column, window.shape[1] + 1)
    events = event_azimuths(scene.vertices, scene.faces, mesh.crease, mesh.events)
    return make_slabs(azimuth_edges, events, sub_beams, window.object_columns)


def _edges_of(sonar: Sonar, window: Window) -> Float[Array, "edge"]:
    return sonar.range_min + sonar.range_bin * (window.row + jnp.arange(window.shape[0] + 1, dtype=jnp.float32))


def _columns(values: Float[Array, "beam"], first: Int[Array, ""] | int, count: int) -> Float[Array, "column"]:
    return jnp.take(values, first + jnp.arange(count), mode="clip")


def _pairs(ends: Float[Array, "slab end"]) -> Float[Array, "slab 2 item"]:
    return ends.reshape(len(ends), 2, -1)


def _swept_ends(
    spans: Spans, slabs: Slabs, scene: Scene, sonar: Sonar, edges: Float[Array, "edge"]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Both ends (slab, 2, item) [bins] of echo spans in the middle of a slab, and how far they move to its edge; then
    the same of occluded spans.
    """

    def bins(azimuth: Float[Array, "slab"]) -> Float[Array, "slab end"]:
        ranges = trace_ranges(spans, azimuth, scene)
        if sonar.floor is not None:  # beside the platform there is no floor to hide
            ranges = jnp.where(spans.on_object, ranges, jnp.clip(ranges, *platform_span(azimuth, scene, sonar)))
        return (ranges - edges[0]) / sonar.range_bin

    middle, slope = jax.jvp(bins, (slabs.middle,), (jnp.ones_like(slabs.middle),))
    # A facet narrower than the slab is followed only over its own width, or as far as a slope of STEEPEST allows.
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
    """Lengthen spans that are shorter than the pulse (at least one bin) to its length."""
    pulse = jnp.maximum(jnp.asarray(sonar.pulse_length, jnp.float32) / sonar.range_bin, 1.0)
    short = (middle[:, 1] - middle[:, 0] < pulse)[:, None]
    grown = middle.mean(axis=1, keepdims=True) + pulse * jnp.array([[-0.5], [0.5]])
    return jnp.where(short, grown, middle), jnp.where(short, half.mean(axis=1, keepdims=True), half)
