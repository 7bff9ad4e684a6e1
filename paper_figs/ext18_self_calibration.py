"""What calibration changes: the target's templates on frames, with the nominal and with the fitted geometry."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.frames import sonar_for
from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import row_where
from sonarjax import Sonar
from sonarjax.plot import draw_outline, plot_polar

ITEM = "Ext. 18"
CAPTION = (
    "Frames of one drawn device, with the outlines of the target's templates for the nominal geometry (above) and for "
    "the fitted one (below), at the poses that the fit found."
)
EXPERIMENTS = ("self_calibration",)
BACKGROUND = 0.5
"""Grey of a template where there is neither highlight nor shadow."""
MARGIN = 0.08, 1.5
"""What is shown around both templates: range [m] and azimuth [°]."""


def draw(run: Run) -> Figure:
    """A column a frame."""
    found, sonar = run.arrays("before_after"), sonar_for(20.0)
    figure = style.sheet(style.TWO_COLUMNS, 4.2)
    axes = figure.subplots(2, len(found["image"]), squeeze=False)
    for k, image in enumerate(found["image"]):
        both = np.stack([found["nominal"][k], found["fitted"][k]])
        for ax, name in zip(axes[:, k], ("nominal", "fitted"), strict=True):
            plot_polar(ax, image, sonar)
            draw_outline(ax, found[name][k], sonar)
            _crop(ax, (both != BACKGROUND).any(axis=0), sonar)
            ax.set_title(name)
            if ax is not axes[1, k]:
                ax.set_xlabel("")
            if k:
                ax.set_ylabel("")
    return figure


def _crop(ax: Axes, shown: np.ndarray, sonar: Sonar) -> None:
    """Show only the part of the axes around the pixels `shown` (range, beam)."""
    rows, beams = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    edges, azimuth = np.asarray(sonar.range_edges), np.degrees(np.asarray(sonar.azimuth_edges))
    ax.set_ylim(edges[rows[0]] - MARGIN[0], edges[rows[-1] + 1] + MARGIN[0])
    ax.set_xlim(azimuth[beams[-1] + 1] + MARGIN[1], azimuth[beams[0]] - MARGIN[1])


NUMBERS = [
    (f"{name}: median error", None, lambda report, name=name: row_where(report["rows"], number=name)["median"])
    for name in ("tilt [°]", "height [cm]", "range scale [%]", "azimuth scale [%]")
]
"""Median errors over the drawn devices."""
