"""Pictures of frames and results: polar and fan views with axes in metres and degrees. No computation of results.

Every function draws into a matplotlib `Axes` or returns a `Figure`; pyplot and its global state are never used. In both
views the sonar is at the bottom and port is on the left, so column 0 of an image (starboard-most) is on the right. The
colours can be told apart by colour-blind readers (Okabe and Ito) and in grey print.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Float, Real
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from sonarjax.io.atomic import write_atomic
from sonarjax.io.errors import SonarjaxError
from sonarjax.render import SonarFrame
from sonarjax.sonar import Sonar, range_edges_of

HIGHLIGHT_COLOR = "#E69F00"  # orange
SHADOW_COLOR = "#56B4E9"  # sky blue
MARK_COLOR = "#D55E00"  # vermilion
UNLIT_COLOR = "#1F2B4D"  # floor outside the vertical aperture; not a grey, which could be mistaken for a value
HIGHLIGHT_LEVEL, SHADOW_LEVEL = 0.75, 0.25  # in the semantic map: half-way between the background and each class

View = Literal["polar", "fan"]


def plot_polar(
    ax: Axes,
    image: Real[Array | np.ndarray, "range beam"],
    sonar: Sonar,
    *,
    cmap: str = "gray",
    vmin: float | int | None = 0,
    vmax: float | int | None = 1,
) -> QuadMesh:
    """Draw an image (range, beam) over azimuth [deg] and range [m], port on the left, near at the bottom.

    Args:
        ax: Axes to draw into.
        image: The image (range, beam). NaN is shown as unlit.
        sonar: Gives the axes.
        cmap: Name of the colour map.
        vmin: Value of the darkest colour; None for the image's smallest.
        vmax: Value of the brightest colour; None for the image's largest.

    Returns:
        What was drawn, for a colour bar.

    Raises:
        SonarjaxError: The image does not have the sonar's shape.
    """
    azimuth, ranges = np.meshgrid(np.degrees(_azimuth_edges(sonar)), range_edges_of(sonar))
    mesh = _mesh(ax, azimuth, ranges, image, sonar, cmap, vmin, vmax)
    ax.set(xlabel="azimuth, to port [°]", ylabel="range [m]")
    ax.set_xlim(azimuth.max(), azimuth.min())
    ax.set_ylim(ranges.min(), ranges.max())
    return mesh


def plot_fan(
    ax: Axes,
    image: Real[Array | np.ndarray, "range beam"],
    sonar: Sonar,
    *,
    cmap: str = "gray",
    vmin: float | int | None = 0,
    vmax: float | int | None = 1,
) -> QuadMesh:
    """Draw an image (range, beam) as a true fan in metres, port on the left, the sonar below at (0, 0).

    Lengths are slant ranges: forward is range · cos(azimuth), lateral is range · sin(azimuth) [m].

    Args:
        ax: Axes to draw into.
        image: The image (range, beam). NaN is shown as unlit.
        sonar: Gives the axes.
        cmap: Name of the colour map.
        vmin: Value of the darkest colour; None for the image's smallest.
        vmax: Value of the brightest colour; None for the image's largest.

    Returns:
        What was drawn, for a colour bar.

    Raises:
        SonarjaxError: The image does not have the sonar's shape.
    """
    lateral, forward = _fan(*np.meshgrid(_azimuth_edges(sonar), range_edges_of(sonar)))
    mesh = _mesh(ax, lateral, forward, image, sonar, cmap, vmin, vmax)
    ax.set(xlabel="lateral, to port [m]", ylabel="forward, slant range [m]")
    margin = 0.02 * float(np.ptp(forward))
    ax.set_xlim(lateral.max() + margin, lateral.min() - margin)
    ax.set_ylim(forward.min() - margin, forward.max() + margin)
    ax.set_aspect("equal")
    ax.spines[["top", "right"]].set_visible(False)
    return mesh


def plot_frame(frame: SonarFrame, sonar: Sonar) -> Figure:
    """Draw a rendered frame: its intensity [dB] above, its semantic map below, each in polar and fan view.

    Floor that is not insonified is blue.

    Args:
        frame: The frame.
        sonar: Gives the axes.

    Returns:
        The figure.

    Raises:
        SonarjaxError: The frame does not have the sonar's shape.
    """
    lit = np.asarray(frame.lit)
    rows: list[tuple[Any, float, float, str, str]] = [
        (decibel(np.asarray(frame.intensity)), -30.0, 0.0, "Intensity", "dB below the brightest"),
        (np.asarray(frame.semantic()), 0.0, 1.0, "Semantic image", "shadow 0, background 0.5, highlight 1"),
    ]
    figure = Figure(figsize=(10.0, 10.0), layout="constrained")
    axes = figure.subplots(len(rows), 2)
    for (polar, fan), (image, low, high, title, unit) in zip(axes, rows, strict=True):
        shown = np.where(lit, image, np.nan)
        plot_polar(polar, shown, sonar, vmin=low, vmax=high)
        mesh = plot_fan(fan, shown, sonar, vmin=low, vmax=high)
        polar.set_title(f"{title}, polar view")
        fan.set_title(f"{title}, fan view")
        figure.colorbar(mesh, ax=[polar, fan], label=unit, shrink=0.8, pad=0.02)
    if not lit.all():
        unlit = Patch(color=UNLIT_COLOR, label="floor outside the vertical aperture")
        figure.legend(handles=[unlit], loc="outside lower center", frameon=False)
    return figure


def plot_calibration(images: Sequence[Any], before: Sequence[Any], after: Sequence[Any], sonar: Sonar) -> Figure:
    """Draw frames with outlines of the target's templates: nominal geometry above, fitted geometry below.

    Args:
        images: Frames (range, beam).
        before, after: Templates (range, beam) of the nominal and of the fitted sonar, one for each frame.
        sonar: Gives the axes.

    Returns:
        The figure.

    Raises:
        SonarjaxError: There is not one template of each kind for each frame, a frame does not have the sonar's shape,
            or a template is larger.
    """
    if not len(images) == len(before) == len(after):
        counts = f"{len(images)}, {len(before)} and {len(after)}"
        raise SonarjaxError(f"plot_calibration: expected as many templates of each kind as frames, got {counts}")
    figure = Figure(figsize=(3.2 * max(len(images), 2), 8.0), layout="constrained")
    for row, (title, templates) in enumerate((("nominal", before), ("fitted", after))):
        for column, (image, template) in enumerate(zip(images, templates, strict=True)):
            ax = figure.add_subplot(2, len(images), row * len(images) + column + 1)
            plot_polar(ax, image, sonar)
            draw_outline(ax, template, sonar)
            ax.set_title(f"{title} geometry")
    return figure


def plot_scores(
    ax: Axes,
    yaws: Float[Array | np.ndarray, "yaw"],
    scores: Float[Array | np.ndarray, "yaw"],
    *,
    threshold: float | int | None = None,
) -> None:
    """Draw correlation scores over yaw, shown in degrees from 0 to 360; the best score is marked.

    Args:
        ax: Axes to draw into.
        yaws: Yaws of the templates (yaw,) [rad].
        scores: Correlation at each yaw (yaw,).
        threshold: Score at which a line is drawn; None for no line.
    """
    degrees, values = np.degrees(np.asarray(yaws, np.float64)) % 360.0, np.asarray(scores)
    order = np.argsort(degrees)
    ax.plot(degrees[order], values[order], ".-", color="#0072B2", markersize=4, linewidth=1)
    if np.isfinite(values).any():
        best = int(np.nanargmax(values))
        ax.plot(degrees[best], values[best], "D", color=MARK_COLOR, markersize=7, label=f"best: {degrees[best]:.0f}°")
    if threshold is not None:
        ax.axhline(threshold, color="0.4", linestyle="--", linewidth=1, label=f"threshold: {threshold:.2f}")
    ax.set(xlabel="yaw [°]", ylabel="correlation", xlim=(0, 360), xticks=range(0, 361, 60))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False)


def draw_outline(
    ax: Axes,
    template: Real[Array | np.ndarray, "h w"],
    sonar: Sonar,
    *,
    offset: tuple[int, int] = (0, 0),
    view: View = "polar",
    linewidth: float | int = 1.2,
) -> None:
    """Draw the outlines of a template (h, w) over a frame: highlight orange, shadow blue and dashed.

    Args:
        ax: Axes with the frame.
        template: Semantic map of the target (h, w).
        sonar: Gives the axes.
        offset: Row and column of the template's first pixel in the frame (`TemplateBank.offset`, or where it matched
            best).
        view: The view in which the frame was drawn.
        linewidth: Width of the lines [points].

    Raises:
        SonarjaxError: The template is not inside the sonar's image.
    """
    values = np.asarray(template, np.float64)
    (row, column), (height, width) = offset, values.shape
    if row < 0 or column < 0 or row + height > sonar.n_ranges or column + width > sonar.n_beams:
        raise SonarjaxError(f"outline: expected a template inside {sonar.shape}, got {values.shape} at {offset}")
    if min(values.shape) < 2:
        return  # one row or column has no outline
    edges = range_edges_of(sonar)
    ranges = (edges[1:] + edges[:-1])[row : row + height] / 2
    azimuth = np.asarray(sonar.azimuth, np.float64)[column : column + width]
    angle, distance = np.meshgrid(azimuth, ranges)
    across, along = (np.degrees(angle), distance) if view == "polar" else _fan(angle, distance)
    for level, color, style in ((HIGHLIGHT_LEVEL, HIGHLIGHT_COLOR, "-"), (SHADOW_LEVEL, SHADOW_COLOR, "--")):
        if values.min() < level < values.max():  # matplotlib warns about a level without a line
            ax.contour(across, along, values, levels=[level], colors=color, linestyles=style, linewidths=linewidth)


def save_figure(figure: Figure, path: str | os.PathLike[str], dpi: float | int = 150) -> None:
    """Write a figure to a file in one step.

    The same figure gives the same PNG.

    Args:
        figure: The figure.
        path: The file; PDF or SVG if its name ends so, else PNG.
        dpi: Resolution [dots per inch].

    Raises:
        SonarjaxError: The file cannot be written. What was at `path` is then unchanged.
    """
    ending = os.path.splitext(os.fspath(path))[1].lower()
    kind = ending[1:] if ending in (".pdf", ".svg") else "png"
    undated = {"png": "Software", "pdf": "CreationDate", "svg": "Date"}[kind]
    write_atomic(path, lambda file: figure.savefig(file, format=kind, dpi=dpi, metadata={undated: None}))


def decibel(intensity: Real[np.ndarray, "range beam"], floor: float = -60.0) -> Float[np.ndarray, "range beam"]:
    """Convert intensity to decibels relative to its maximum.

    Args:
        intensity: Intensity (range, beam), not in decibels.
        floor: Least level [dB]; lower levels are raised to it.

    Returns:
        Level (range, beam) [dB], 0 at the maximum; `floor` everywhere if the maximum is 0.
    """
    peak = float(np.max(intensity))
    if not peak > 0:
        return np.full(intensity.shape, floor)
    return 10 * np.log10(np.maximum(np.asarray(intensity, np.float64) / peak, 10 ** (floor / 10)))


def _mesh(
    ax: Axes,
    across: Float[np.ndarray, "range_edge beam_edge"],
    along: Float[np.ndarray, "range_edge beam_edge"],
    image: Any,
    sonar: Sonar,
    cmap: str,
    vmin: float | int | None,
    vmax: float | int | None,
) -> QuadMesh:
    values = np.asarray(image)
    if values.shape != sonar.shape:
        raise SonarjaxError(f"picture: expected an image of the sonar's shape {sonar.shape}, got {values.shape}")
    mesh = ax.pcolormesh(across, along, values, cmap=cmap, vmin=vmin, vmax=vmax, rasterized=True)
    mesh.set_cmap(mesh.get_cmap().with_extremes(bad=UNLIT_COLOR))
    return mesh


def _fan(
    azimuth: Float[np.ndarray, "row column"], ranges: Float[np.ndarray, "row column"]
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Lateral (to port) and forward coordinates [m] of image points at `azimuth` [rad] and `ranges` [m]."""
    return ranges * np.sin(azimuth), ranges * np.cos(azimuth)


def _azimuth_edges(sonar: Sonar) -> Float[np.ndarray, "beam_edge"]:
    return np.asarray(sonar.azimuth_edges, np.float64)
