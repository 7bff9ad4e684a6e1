"""Contact sheets: many frames in polar view on one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sonarjax as sj
from sonarjax.plot import draw_outline, plot_polar, save_figure

COLUMNS = 10


class Panel(NamedTuple):
    """One picture of a sheet."""

    image: np.ndarray
    """What is shown (range, beam), from 0 on."""
    brightest: float
    """Value that is drawn white."""
    title: str = ""
    """What stands above."""
    template: np.ndarray | None = None
    """Semantic image (range, beam) whose outline is drawn over it."""


def draw_sheet(path: Path, panels: Sequence[Panel | None], sonar: sj.Sonar, title: str) -> Path:
    """Write the panels as a PNG, `COLUMNS` in a row, None an empty place. Returns `path`."""
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.0 * columns, 2.4 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, panel in zip(axes, panels, strict=False):
        if panel is not None:
            plot_polar(ax, panel.image, sonar, vmin=0, vmax=panel.brightest)
            ax.set_title(panel.title, fontsize=8)
            if panel.template is not None:
                draw_outline(ax, panel.template, sonar, linewidth=0.9)
    figure.suptitle(title, fontsize=9)
    save_figure(figure, path, dpi=110)
    return path
