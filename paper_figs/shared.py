"""What the figure scripts share: rows of results, numbers beside the paper's, sonar images cropped to the object."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

import sonarjax as sj
from experiments.common.frames import sonar_for
from sonarjax.plot import plot_fan

BACKGROUND, TOUCHED = 0.5, 0.25  # of a semantic image, and how far off it an object or its shadow is


class Number(NamedTuple):
    """One number beside the paper's."""

    what: str
    """What it is, with its unit."""
    paper: float | None
    """What the paper prints, None where it says nothing."""
    ours: float | None
    """What the run gave, None where there is no run."""


Take = Callable[[dict[str, Any]], Any]
Line = tuple[str, float | None, Take] | tuple[str, float | None, Take, str]
"""One of a script's NUMBERS: what it is, what the paper has, how to take ours from the report, and from which of its
experiments, where that is not the first."""


def row_where(rows: Sequence[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    """The first of the rows with these values. Raises StopIteration when there is none."""
    return next(row for row in rows if all(row.get(key) == value for key, value in wanted.items()))


def in_order(rows: Sequence[dict[str, Any]], key: str) -> list[Any]:
    """The values of a column, each once, in the order in which they appear."""
    return list(dict.fromkeys(row[key] for row in rows))


# ---------------------------------------------------------------- sonar images


def in_frame(template: np.ndarray, offset: Sequence[int], sonar: sj.Sonar) -> np.ndarray:
    """A template (h, w) put where it lies in the frame (range, beam), background around it."""
    frame = np.full(sonar.shape, BACKGROUND, np.float32)
    (row, column), (height, width) = (int(v) for v in offset), template.shape
    frame[row : row + height, column : column + width] = template
    return frame


def center_of(clean: np.ndarray, sonar: sj.Sonar) -> tuple[float, float]:
    """Middle of object and shadow of a true map (range, beam): lateral and forward in the fan view [m]."""
    rows, columns = np.nonzero(np.abs(clean - BACKGROUND) > TOUCHED)
    ranges = np.linspace(float(sonar.range_min), float(sonar.range_max), sonar.n_ranges)
    azimuth = np.asarray(sonar.azimuth, float)
    away = (ranges[rows.min()] + ranges[rows.max()]) / 2
    bearing = (azimuth[columns.min()] + azimuth[columns.max()]) / 2
    return away * math.sin(bearing), away * math.cos(bearing)


def close_up(
    ax: Axes, image: np.ndarray, sonar: sj.Sonar, center: tuple[float, float], size: tuple[float, float], **how: Any
) -> None:
    """Draw an image (range, beam) as a fan, cut to a width and a height [m] around a place in it [m]."""
    plot_fan(ax, image, sonar, **how)
    (across, along), (width, height) = center, size
    ax.set(xlim=(across + width / 2, across - width / 2), ylim=(along - height / 2, along + height / 2))
    ax.spines[:].set_visible(True)
    ax.set(xlabel="", ylabel="")


def outer_labels(axes: np.ndarray, xlabel: str = "to port [m]", ylabel: str = "slant range [m]") -> None:
    """Name the axes of a grid of panels (row, column) at its left and foot alone, and take the ticks off inside."""
    for (row, column), ax in np.ndenumerate(axes):
        ax.set(xlabel=xlabel if row == len(axes) - 1 else "", ylabel=ylabel if column == 0 else "")
        ax.tick_params(labelbottom=row == len(axes) - 1, labelleft=column == 0)


def tank_sonar(tilt_deg: Any) -> sj.Sonar:
    """The sonar of §4.1 at a tilt [deg], whose axes an image has."""
    return sonar_for(float(tilt_deg))
