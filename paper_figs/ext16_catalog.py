"""Which object of a catalogue of 24 is found for which: confusion matrices."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import row_where

ITEM = "Ext. 16"
CAPTION = (
    "Objects found (across) for objects shown (down) in a catalogue of 24, in numbers of frames; boxes hold an object "
    "and its near-duplicates. Left our simulator's drawn devices, right the independent judge."
)
EXPERIMENTS = ("catalog",)
SETS = ("drawn devices", "the judge")
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


def draw(run: Run) -> Figure:
    """A matrix for each set that was run."""
    report = run.report
    names, alike = report["objects"], report["alike"]
    found = {source: np.array(report["confusion"][source]) for source in SETS if source in report["confusion"]}
    figure = style.sheet(style.TWO_COLUMNS, 4.1)
    axes = figure.subplots(1, len(found), squeeze=False, sharey=True)[0]
    for ax, (source, counts) in zip(axes, found.items(), strict=True):
        _matrix(ax, counts, names, alike)
        ax.set(title=f"{source}: {counts.trace()} of {counts.sum()} right", xlabel="found")
    axes[0].set_ylabel("shown")
    style.letters(axes)
    return figure


def _matrix(ax: Axes, counts: np.ndarray, names: list[str], alike: list[list[str]]) -> None:
    right = np.eye(len(names), dtype=bool)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    shades = np.where(counts > 0, np.where(right, 0.25 + 0.5 * shares, shares), np.nan)
    ax.imshow(np.where(right, shades, np.nan), cmap=matplotlib.colormaps["Blues"], vmin=0, vmax=1, aspect="auto")
    ax.imshow(np.where(right, np.nan, shades), cmap=matplotlib.colormaps["Oranges"], vmin=-0.3, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            ax.text(column, row, str(count), ha="center", va="center_baseline")
    for group in alike:
        places = [names.index(name) for name in group]
        first, size = min(places) - 0.5, max(places) - min(places) + 1
        ax.add_patch(Rectangle((first, first), size, size, fill=False, edgecolor=style.GREY, linewidth=0.8))
    ax.set(xticks=range(len(names)), yticks=range(len(names)))
    ax.set_xticklabels(LETTERS[: len(names)])
    ax.set_yticklabels([f"{name}  {letter}" for name, letter in zip(names, LETTERS, strict=False)])
    ax.tick_params(length=0)
    ax.spines[:].set_visible(True)


NUMBERS = [
    (f"{source}: {what}", None, lambda report, source=source, key=key: _of(report, source)[key])
    for source in SETS for what, key in (("object right", "top_1"), ("others refused", "refused"))
]  # fmt: skip
"""Shares of right names, and of strangers that were refused."""


def _of(report: dict[str, Any], source: str) -> dict[str, Any]:
    return row_where(report["rows"], frames_of=source)
