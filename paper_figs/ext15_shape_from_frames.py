"""The shape of a body from frames of it: what the search began with, what it found, and the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.solid import draw_solid

ITEM = "Ext. 15"
CAPTION = (
    "(a–c) A smooth body from 16 frames at known poses: the ball that the search begins with, what it finds, the "
    "truth. (d) NCC of template and frame over the search's steps; it falls where the blur gets finer."
)
EXPERIMENTS = ("shape_from_frames",)
BODIES = (("first", "first guess", "#999999"), ("found", "found", style.ORANGE),
          ("true", "truth", style.BLUE))  # fmt: skip


def draw(run: Run) -> Figure:
    """The first body that was run, and its search."""
    body = run.arrays("body_0")
    figure = style.sheet(style.TWO_COLUMNS, 2.0)
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.2))
    for ax, (name, title, color) in zip(axes, BODIES, strict=False):
        faces = body[f"{name}_faces"]
        draw_solid(ax, body[f"{name}_vertices"], faces[faces[:, 0] != faces[:, 1]], color, reach=0.13)
        ax.set_title(title)
    _search(axes[-1], body["score"])
    style.letters(axes)
    return figure


def _search(ax: Axes, score: np.ndarray) -> None:
    ax.plot(score, color=style.BLUE)
    ax.set(title="the search", xlabel="step", ylabel="mean NCC")


NUMBERS = [
    ("worst side of a brick, median error [range bins]", None,
     lambda report: max(row["median"] for row in report["bricks"])),
    ("smooth body, Chamfer distance before [mm]", None, lambda report: _mean(report, "a ball")),
    ("smooth body, Chamfer distance after [mm]", None, lambda report: _mean(report, "fitted")),
]  # fmt: skip
"""Worst side of a brick, and the bodies' distances."""


def _mean(report: dict[str, Any], when: str) -> float:
    return float(np.mean([row["chamfer_mm"] for row in report["bodies"] if row["when"] == when]))
