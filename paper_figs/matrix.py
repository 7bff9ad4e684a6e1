"""Tables 3 and 4 drawn: correlations of images with templates, the paper's beside ours."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.paper import ANGLES_DEG
from paper_figs import style

Block = tuple[str, np.ndarray | None, np.ndarray, np.ndarray]
"""Kind of image; the paper's values, ours, and ours with zeros (image, template)."""


def blocks(table: dict[str, Any], **paper: np.ndarray | None) -> list[Block]:
    """The halves of a table of reproduce_paper: `target` and `other`, with what the paper has of each."""
    return [
        ("target" if kind == "target" else "non-target", said, np.array(table[kind]), np.array(table[f"{kind}_shown"]))
        for kind, said in paper.items()
    ]


def draw_blocks(found: list[Block], limit: float) -> Figure:
    """A row for each kind of image, the paper's table left and ours right; `limit` is Otsu's threshold on ours."""
    figure = style.sheet(style.TWO_COLUMNS, 0.5 + 1.75 * len(found))
    axes = figure.subplots(len(found), 2, squeeze=False)
    for row, (kind, said, ours, shown) in zip(axes, found, strict=True):
        _matrix(row[0], said, said, kind)
        _matrix(row[1], ours, shown, kind)
    axes[0, 0].set_title("published")
    axes[0, 1].set_title(f"ours (Otsu's threshold {limit:.3f})")
    for ax in axes[-1]:
        ax.set_xlabel("template")
    return figure


def _matrix(ax: Axes, values: np.ndarray | None, shown: np.ndarray | None, kind: str) -> None:
    """One table; what is below the threshold is 0, with the number under the zero in grey."""
    if values is None or shown is None:
        style.bare(ax)
        ax.text(0.5, 0.5, "not in the paper", transform=ax.transAxes, ha="center", va="center", color=style.GREY)
        return
    colors = matplotlib.colormaps["Blues"]
    ax.imshow(np.where(shown > 0, shown, np.nan), cmap=colors, vmin=0.3, vmax=1.0, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        kept = shown[row, column] > 0
        dark = kept and value > 0.7
        text, color = (f"{value:.3f}", "white" if dark else "black") if kept else ("0", "black")
        weight = "bold" if row == column and kept and kind == "target" else "normal"
        lift = -0.16 if not kept and value > 0 else 0.0
        ax.text(column, row + lift, text, ha="center", va="center", color=color, weight=weight)
        if lift:
            ax.text(column, row + 0.24, f"{value:.3f}", ha="center", va="center", color="0.5")
    named = [f"{angle}°" for angle in ANGLES_DEG]
    ax.set(xticks=range(4), xticklabels=named, yticks=range(4), yticklabels=named, ylabel=f"{kind} image")
    ax.tick_params(length=0)
    ax.spines[:].set_visible(True)
