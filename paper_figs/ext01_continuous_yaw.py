"""Yaw beyond the 10° grid: errors, error bars and cost."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import row_where

ITEM = "Ext. 1"
CAPTION = (
    "Yaw between the bins. (a) Share of target frames whose yaw error is below a value: refined (solid), best "
    "template of the 10° grid (dashed), and what the nearest template leaves (dotted). (b) Share of frames whose "
    "error is below a multiple of the reported yaw_std, of those within 10°; a normal variate in grey. (c) Time a "
    "frame."
)
EXPERIMENTS = ("continuous_yaw",)
ASTRAY_DEG = 10.0


def draw(run: Run) -> Figure:
    """Cumulative errors, calibration of the error bars, cost."""
    errors, names = run.arrays("errors"), run.report["settings"]["segmenters"]
    figure = style.sheet(style.TWO_COLUMNS, 2.8)
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1, 0.9))
    _errors(axes[0], errors, names)
    _bars(axes[1], errors, names)
    _cost(axes[2], run.report["cost"])
    style.letters(axes)
    return figure


def _errors(ax: Axes, errors: dict[str, Any], names: list[str]) -> None:
    def curve(values: np.ndarray, **how: Any) -> None:
        ax.step(np.maximum(values, 1e-3), np.arange(1, len(values) + 1) / len(values), where="post", **how)

    curve(errors["sorted_floor_deg"], color=style.GREY, linestyle=":", label="nearest bin")
    for name in names:
        color = style.look(name)["color"]
        curve(errors[f"sorted_{name}_error_deg"], color=color, label=name)
        curve(errors[f"sorted_{name}_bin_error_deg"], color=color, linestyle="--", linewidth=0.9)
    ax.set(title="yaw error", xlabel="absolute yaw error [°]", ylabel="share of frames", xscale="log", ylim=(0, 1.02),
           xlim=(0.01, 180))  # fmt: skip
    ax.set_xticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
    ax.grid(True)
    ax.legend(loc="lower right", handlelength=1.2)


def _bars(ax: Axes, errors: dict[str, Any], names: list[str]) -> None:
    multiples = np.linspace(0, 4, 81)
    normal = [math.erf(value / math.sqrt(2)) for value in multiples]
    ax.plot(multiples, normal, color="0.75", linewidth=4, label="normal")
    for name in names:
        near = np.abs(errors[f"{name}_error_deg"]) <= ASTRAY_DEG
        z = np.abs(errors[f"{name}_error_deg"] / errors[f"{name}_std_deg"])[near]
        if len(z):
            ax.plot(
                multiples, [(z <= value).mean() for value in multiples], color=style.look(name)["color"], label=name
            )
    ax.set(
        title="error bars", xlabel="multiple of yaw_std", ylabel="share of frames below", ylim=(0, 1.02), xlim=(0, 4)
    )
    ax.grid(True)
    ax.legend(loc="lower right", handlelength=1.2)


def _cost(ax: Axes, rows: list[dict[str, Any]]) -> None:
    place = np.arange(len(rows))[::-1]
    single, each = ([row[key] for row in rows] for key in ("single", "each"))
    ax.plot(single, place, "o", color=style.BLUE, label="alone")
    ax.plot(each, place, "s", color=style.ORANGE, markerfacecolor="none", label="in a batch")
    for row, y in zip(rows, place, strict=True):
        ax.text(
            0.02,
            y + 0.22,
            row["what"].removeprefix("recognize, "),
            transform=ax.get_yaxis_transform(),
            va="bottom",
            fontsize=8,
        )
    ax.set(title="time of recognize", xlabel="ms a frame", xscale="log", yticks=[], ylim=(-1.6, len(rows) - 0.1))
    ax.set_xlim(0.5 * min(single + each), 2 * max(single + each))
    style.plain_log(ax.xaxis)
    ax.grid(True, axis="x")
    ax.legend(loc="lower center", ncols=2, columnspacing=0.8, handlelength=0.6, handletextpad=0.3)


NUMBERS = [
    (f"{name}, {yaw}, median error [°]", None,
     lambda report, name=name, yaw=yaw: row_where(report["errors"], segmenter=name, yaw=yaw)["median"])
    for name in ("pix2pix", "none") for yaw in ("best of the grid", "refined")
]  # fmt: skip
"""Errors of each segmenter's best bin and refined yaw."""
