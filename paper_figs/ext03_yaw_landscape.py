"""The loss that refinement descends, and its derivative."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style

ITEM = "Ext. 3"
CAPTION = (
    "The loss 1 − NCC over yaw and x off the truth, for each blur from coarse to fine, and the ways that refinement "
    "takes (dots: starts, diamonds: ends, cross: truth). Right: the derivative by yaw that it follows against central "
    "differences of the loss of a converged render, along lines of yaw through the truth, at the finest blur."
)
EXPERIMENTS = ("yaw_landscape",)


def draw(run: Run) -> Figure:
    """A row for each kind of map: landscapes by blur, then derivatives."""
    names, slopes = run.report["settings"]["maps"], run.arrays("derivatives")
    blurs = slopes["blur"]
    figure = style.sheet(style.TWO_COLUMNS, 0.45 + 2.15 * len(names))
    axes = figure.subplots(len(names), len(blurs) + 1, squeeze=False, width_ratios=(*[1] * len(blurs), 1.15))
    for row, name in zip(axes, names, strict=True):
        land = run.arrays(f"landscape_{name}")
        for k, (ax, blur) in enumerate(zip(row, blurs, strict=False)):
            _landscape(ax, land, k)
            ax.set_title(f"{name}, blur {blur:g}")
            ax.tick_params(labelleft=k == 0)
            ax.set_ylabel("x off by [m]" if k == 0 else "")
        _derivatives(row[-1], slopes, name)
    style.letters(axes.flat)
    return figure


def _landscape(ax: Axes, land: dict[str, Any], blur: int) -> None:
    ax.contourf(land["yaw_deg"], land["x_m"], land["loss"][..., blur].T, levels=14, cmap=style.SEQUENTIAL)
    for way in np.moveaxis(land["path"], 1, 0):
        ax.plot(*way.T, color="white", linewidth=0.8)
        ax.plot(*way[0], "o", color="white", markersize=3, markeredgecolor="black", markeredgewidth=0.5)
    ax.plot(*land["end"].T, "D", color=style.ORANGE, markersize=4, markeredgecolor="black", markeredgewidth=0.5)
    ax.plot(0, 0, "+", color="black", markersize=7)
    reach = land["yaw_deg"][-1]
    ax.set(
        xlabel="yaw off by [°]",
        xticks=np.array([-0.75, 0, 0.75]) * reach,
        xlim=land["yaw_deg"][[0, -1]],
        ylim=land["x_m"][[0, -1]],
    )


def _derivatives(ax: Axes, slopes: dict[str, Any], name: str) -> None:
    ours, finer = (slopes[f"{name}_{key}"][..., -1].ravel() for key in ("derivative", "differences"))
    limit = 1.05 * np.percentile(np.abs(finer), 99.5)
    ax.plot([-limit, limit], [-limit, limit], color=style.GREY, linewidth=0.8)
    ax.plot(finer, ours, ".", markersize=2, color=style.BLUE, alpha=0.5, markeredgewidth=0, rasterized=True)
    ax.set(title="derivative", xlabel="central differences [1/rad]", ylabel="ours [1/rad]",
           xlim=(-limit, limit), ylim=(-limit, limit))  # fmt: skip


NUMBERS = [
    (f"{name}: {what}", None,
     lambda report, name=name, key=key: [row for row in report["derivatives"] if row["map"] == name][-1][key])
    for name in ("labels", "pix2pix")
    for key, what in (("error", "derivative's RMS error over its RMS"), ("sign", "sign right"))
]  # fmt: skip
"""Errors and signs of the derivative at the finest blur."""
