"""Yaw of a real object on a turntable: errors alone, for the frames are others' to publish."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import row_where

ITEM = "Ext. 12"
CAPTION = (
    "Refined yaw of a pipe on a turntable, real frames of an ARIS Explorer 3000, modulo 180° and after one constant "
    "offset. (a) Share of frames whose error is below a value: `recognize`, told no place (solid), and one bank at the "
    "platform's centre (dashed); the truth is good to 1–2° (grey). (b) Error of `recognize` over the frame's true "
    "yaw, whose zero is arbitrary: linear to ±10° (grey lines), logarithmic beyond. `none`: a median filter alone."
)
EXPERIMENTS = ("real_turntable",)
SEGMENTERS = ("pix2pix", "none", "otsu")
SEARCHES = {"recognize": ("-", "recognize"), "fixed window": ("--", "known place")}
TRUTH_DEG = (1.0, 2.0)
LEAST_DEG, LINEAR_DEG, MOST_DEG = 0.05, 10.0, 90.0
MARKS = {
    "none": {"markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 1.0},
    "pix2pix": {"markersize": 3.5, "markeredgecolor": "white", "markeredgewidth": 0.3},
}
"""Of the errors over yaw: the network's on top, and the others still seen around them."""
TICKS_DEG = (-90, -30, -10, -5, 0, 5, 10, 30, 90)
Errors = dict[tuple[str, str], np.ndarray]


def draw(run: Run) -> Figure:
    """Cumulative errors, and errors over the true yaw."""
    report = run.report
    errors, truth = _refined(report["per_frame"]), np.array(report["per_frame"]["truth_deg"], float)
    figure = style.sheet(style.TWO_COLUMNS, 3.0)
    axes = figure.subplots(1, 2, width_ratios=(1, 1.15))
    _shares(axes[0], errors)
    _over_yaw(axes[1], errors, truth)
    style.letters(axes)
    return figure


def _refined(per_frame: dict[str, Any]) -> Errors:
    """Errors of the refined yaw (frame,) [deg] by segmenter and search, of those that were run."""
    cases = {(name, search): f"{name}, {search}, refined" for name in SEGMENTERS for search in SEARCHES}
    return {case: np.array(per_frame[key]["error_deg"], float) for case, key in cases.items() if key in per_frame}


def _shares(ax: Axes, errors: Errors) -> None:
    ax.axvspan(*TRUTH_DEG, color="0.93", linewidth=0)
    for (name, search), values in errors.items():
        at = np.append(np.maximum(np.sort(np.abs(values)), LEAST_DEG), MOST_DEG)
        share = np.minimum(np.arange(1, len(at) + 1) / len(values), 1)
        wide = 1.3 if search == "recognize" else 1.0
        ax.step(at, share, SEARCHES[search][0], where="post", color=style.look(name)["color"], linewidth=wide)
    ax.set(title="yaw error", xlabel="absolute yaw error [°]", ylabel="share of frames", xscale="log", ylim=(0, 1.02),
           xlim=(LEAST_DEG, MOST_DEG))  # fmt: skip
    ax.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    ax.set_yticks([0, 0.25, 0.5, 0.75, 0.9, 1], ["0", "0.25", "0.5", "0.75", "0.9", "1"])
    ax.grid(True)
    names, searches = ([key[k] for key in errors] for k in (0, 1))
    shown = [(name, style.look(name)["color"], "-") for name in SEGMENTERS if name in names]
    shown += [(label, style.GREY, line) for key, (line, label) in SEARCHES.items() if key in searches]
    for label, color, line in shown:
        ax.plot([], [], line, color=color, label=label)
    ax.legend(*ax.get_legend_handles_labels(), loc="lower right")  # given: there may be none


def _over_yaw(ax: Axes, errors: Errors, truth: np.ndarray) -> None:
    for bound in (-LINEAR_DEG, LINEAR_DEG):
        ax.axhline(bound, color="0.75", linewidth=0.8, zorder=0)
    for name, how in MARKS.items():
        if (name, "recognize") in errors:
            look = style.look(name) | how
            ax.plot(truth, errors[name, "recognize"], **look, linestyle="none", clip_on=False, label=name)
    ax.set(title="error of recognize", xlabel="true yaw [°]", ylabel="yaw error [°]", xlim=(0, 180))
    ax.set_yscale("symlog", linthresh=LINEAR_DEG, linscale=1.5)
    ax.set_yticks(TICKS_DEG, [f"{value:+d}".replace("+0", "0").replace("-", "−") for value in TICKS_DEG])
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set(xticks=range(0, 181, 45), ylim=(-1.2 * MOST_DEG, 1.2 * MOST_DEG))
    ax.grid(True)
    ax.legend(*ax.get_legend_handles_labels(), loc="lower center", handletextpad=0.1)


def _of_recognize(name: str, key: str, report: dict[str, Any]) -> Any:
    return row_where(report["rows"], segmenter=name, search="recognize", yaw="refined")[key]


COLUMNS = {"median_deg": "median error", "p90_deg": "90 % of errors below"}
NUMBERS = [
    (f"{name}, refined, {what} [°]", None, partial(_of_recognize, name, key))
    for name in SEGMENTERS for key, what in COLUMNS.items()
]  # fmt: skip
"""Median and 90th percentile of the refined error of `recognize` with each segmenter."""
