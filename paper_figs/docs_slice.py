"""The drawing of docs/renderer.md: one slice through two boxes, and the envelope that the renderer finds in it.

`python -m paper_figs.docs_slice` writes paper_figs/drawn/docs_slice.png. Segments and visible intervals come from the
renderer's own functions, so the drawing shows what they do.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import style
from sonarjax.render.segments import Segments, View, cut
from sonarjax.render.vector import Vector
from sonarjax.render.visibility import VisibleIntervals, visible_intervals
from sonarjax.scene import objects

HEIGHT_M = 0.9
LOWEST, HIGHEST = math.radians(-33.0), math.radians(-12.0)
BOXES = (((0.18, 0.4, 0.12), 1.95), ((0.22, 0.4, 0.34), 2.3))
"""Size (length, width, height) [m] and distance [m] of each box."""


def slice_of_boxes() -> tuple[Segments, VisibleIntervals]:
    """Segments of all triangles in the half-plane straight ahead, and its visible intervals, one slab each."""
    corners = []
    for size, distance in BOXES:
        vertices, faces = objects.box(size, (distance, 0.0, size[2] / 2 - HEIGHT_M))
        corners.append(np.asarray(vertices)[np.asarray(faces)])
    view = View(
        jnp.float32(math.tan(LOWEST)), jnp.float32(math.tan(HIGHEST)), jnp.array([0.0, 0.0, 1.0]), jnp.float32(HEIGHT_M)
    )
    # A little off the middle, where the diagonals of the boxes' faces cross it in one point each.
    around = jnp.asarray(np.concatenate(corners), jnp.float32)[None]
    triangles = tuple(Vector(*jnp.moveaxis(around[..., k, :], -1, 0)) for k in range(3))
    segments = cut(triangles, jnp.full((1, 1), 0.013), view)
    return segments, visible_intervals(segments, False, 16)


def draw() -> Figure:
    """The slice seen from the side, the same in the renderer's plane, and what falls into the range bins."""
    segments, intervals = slice_of_boxes()
    figure = style.sheet(style.TWO_COLUMNS, 4.6)
    side, plane, bins = figure.subplot_mosaic([["side", "plane"], ["bins", "bins"]], height_ratios=(1, 0.32)).values()
    lines = _lines(segments)
    visible = _visible(intervals, segments)
    _draw_side(side, lines, visible)
    _draw_plane(plane, lines, visible)
    _draw_bins(bins, visible)
    style.letters([side, plane, bins])
    return figure


def _lines(segments: Segments) -> list[np.ndarray]:
    """(tau, s) [1, 1/m] of both ends of each segment that the slice cuts."""
    tau, line, hit = (np.asarray(v[0], np.float64) for v in (segments.tau, segments.line, segments.hit))
    return [np.stack([t, a + b * t], axis=-1) for t, (a, b), cuts in zip(tau, line, hit, strict=True) if cuts]


def _visible(intervals: VisibleIntervals, segments: Segments) -> list[np.ndarray]:
    """(tau, s) of both ends of each visible interval that shows a triangle, in ascending elevation."""
    winner, tau, line = (np.asarray(v[0], np.float64) for v in (intervals.winner, intervals.tau, segments.line))
    found = []
    for number, ends in zip(winner.astype(int), tau, strict=True):
        if number >= 0 and ends[1] - ends[0] > 1e-6:
            a, b = line[number]
            found.append(np.stack([ends, a + b * ends], axis=-1))
    return found


def _point(tau_s: np.ndarray) -> np.ndarray:
    """(planar range, height over the floor) [m] of (tau, s)."""
    planar = 1 / tau_s[..., 1]
    return np.stack([planar, HEIGHT_M + tau_s[..., 0] * planar], axis=-1)


def _floor(tau: float) -> np.ndarray:
    """The floor at an elevation, as (tau, s)."""
    return np.array([tau, -tau / HEIGHT_M])


def _shadow(visible: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the floor that the boxes hide, as (tau, s): what lies behind all that is seen is one stretch here."""
    return _floor(visible[0][0, 0]), _floor(min(visible[-1][1, 0], math.tan(HIGHEST)))


def _draw_side(ax: Axes, lines: list[np.ndarray], visible: list[np.ndarray]) -> None:
    ax.plot([0, 4.2], [0, 0], color=style.GREY, linewidth=1)
    ax.plot(0, HEIGHT_M, "o", color=style.BLACK)
    ax.annotate("sonar", (0, HEIGHT_M), (0.1, HEIGHT_M + 0.03))
    for angle in (LOWEST, HIGHEST):
        far = min(4.2, HEIGHT_M / -math.tan(angle))
        ax.plot([0, far], [HEIGHT_M, HEIGHT_M + far * math.tan(angle)], "--", color=style.GREY, linewidth=0.7)
    for line in lines:
        ax.plot(*_point(line).T, color=style.LIGHT, linewidth=1.5)
    for piece in visible:
        ax.plot(*_point(piece).T, color=style.ORANGE, linewidth=2.5)
        for end in _point(piece):
            ax.plot([0, end[0]], [HEIGHT_M, end[1]], color=style.ORANGE, linewidth=0.4)
    near, far = (_point(end)[0] for end in _shadow(visible))
    ax.plot([near, far], [0, 0], color=style.BLUE, linewidth=2.5)
    ax.annotate("hidden floor", (far, -0.07), ha="right", color=style.BLUE)
    ax.set(
        xlabel="planar range [m]", ylabel="height over the floor [m]", title="the slice from the side", ylim=(-0.1, 1)
    )


def _draw_plane(ax: Axes, lines: list[np.ndarray], visible: list[np.ndarray]) -> None:
    ends = np.stack([_floor(math.tan(LOWEST)), _floor(math.tan(HIGHEST))])
    ax.plot(*ends.T, color=style.GREY, linewidth=1, label="floor")
    for number, line in enumerate(lines):
        ax.plot(*line.T, color=style.LIGHT, linewidth=1.5, label="" if number else "triangles")
    for number, piece in enumerate(visible):
        ax.plot(*piece.T, color=style.ORANGE, linewidth=2.5, label="" if number else "upper envelope: what is seen")
    ax.plot(*np.stack(_shadow(visible)).T, color=style.BLUE, linewidth=2.5, label="hidden floor", zorder=1)
    ax.set(
        xlabel="τ = tan(elevation)", ylabel="s = 1 / planar range [1/m]", title="the same where all lines are straight"
    )
    ax.legend(loc="upper right")


def _draw_bins(ax: Axes, visible: list[np.ndarray]) -> None:
    for piece in visible:
        slant = np.hypot(1 / piece[:, 1], piece[:, 0] / piece[:, 1])
        ax.fill_between(np.sort(slant), 1.1, 1.9, color=style.ORANGE, alpha=0.6, linewidth=0.8)
    near, far = (float(np.hypot(1 / s, t / s)) for t, s in _shadow(visible))
    ax.fill_between([near, far], 0.1, 0.9, color=style.BLUE, alpha=0.6)
    for edge in np.arange(1.6, 4.01, 0.05):
        ax.axvline(edge, color=style.LIGHT, linewidth=0.4, zorder=0)
    ax.set(
        xlabel="slant range [m]; grey: range bins, drawn ten times as wide as a DIDSON's", yticks=(0.5, 1.5),
        yticklabels=("shadow", "highlight"), ylim=(0, 2), xlim=(1.6, 4.0),
        title="spans in range, and the bins that they fall into",
    )  # fmt: skip


def main() -> None:
    """Write the drawing."""
    style.write_drawings({"docs_slice": draw})


if __name__ == "__main__":
    main()
