"""What many views are worth: yaw errors after n views, and a real turn followed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from experiments.common.runs import Run
from paper_figs import style

ITEM = "Ext. 14"
CAPTION = (
    "(a) RMS error of the yaw after n views of a standing object, from one place and from known places around it; "
    "1.2 times what averaging would leave above the floor (grey). (b) Real frames of a pipe that turns, in order: "
    "error of each frame alone, and of the smoothed track, modulo 180° and after one constant offset; linear to ±10°."
)
EXPERIMENTS = ("track_views",)
LINEAR_DEG, MOST_DEG = 10.0, 90.0
TICKS_DEG = (-90, -30, -10, -5, 0, 5, 10, 30, 90)
LOOKS = {"one place": (style.BLUE, "o"), "around": (style.ORANGE, "s")}


def draw(run: Run) -> Figure:
    """Errors over the number of views; errors of the real frames, where they were run."""
    figure = style.sheet(style.TWO_COLUMNS, 2.8)
    axes = figure.subplots(1, 2, width_ratios=(1, 1.6))
    _views(axes[0], run.report["rows"])
    _real(axes[1], run.arrays("real") if run.report["real"] else {})
    style.letters(axes)
    return figure


def _views(ax: Axes, rows: list[dict[str, Any]]) -> None:
    for name, (color, marker) in LOOKS.items():
        own = [row for row in rows if row["name"] == name]
        counts = [row["count"] for row in own]
        ax.plot(counts, [row["rms"] for row in own], color=color, marker=marker, label=name)
        if name == "one place":
            ax.plot(counts, [row["bar"] for row in own], color=style.GREY, linestyle="--", label="bar")
    ax.set(title="yaw after n views", xlabel="views", ylabel="RMS error [°]", xscale="log", yscale="log")
    counts = sorted({row["count"] for row in rows})
    ax.set_xticks(counts, [str(count) for count in counts])
    ax.xaxis.set_minor_locator(NullLocator())
    style.plain_log(ax.yaxis)
    ax.legend()


def _real(ax: Axes, errors: dict[str, np.ndarray]) -> None:
    for bound in (-LINEAR_DEG, LINEAR_DEG):
        ax.axhline(bound, color="0.75", linewidth=0.8, zorder=0)
    looks = {"alone": (style.ORANGE, "s", "each frame alone"), "smoothed": (style.BLUE, "o", "track, smoothed")}
    for name, (color, marker, label) in looks.items():
        if name in errors:
            ax.plot(errors[name], color=color, marker=marker, markersize=3, linestyle="none", label=label)
    ax.set(title="a real turn", xlabel="frame", ylabel="yaw error [°]")
    ax.set_yscale("symlog", linthresh=LINEAR_DEG, linscale=1.5)
    ax.set_yticks(TICKS_DEG, [f"{value:+d}".replace("+0", "0").replace("-", "−") for value in TICKS_DEG])
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set(ylim=(-1.2 * MOST_DEG, 1.2 * MOST_DEG))
    ax.grid(True)
    ax.legend(*ax.get_legend_handles_labels(), loc="lower center", handletextpad=0.1)


NUMBERS = [
    ("one view, RMS error [°]", None, lambda report: report["rows"][0]["rms"]),
    ("16 views from one place, RMS error [°]", None, lambda report: _of(report, "one place")),
    ("16 views from around, RMS error [°]", None, lambda report: _of(report, "around")),
    ("floor of one place [°]", None, lambda report: report["floor_deg"]),
]  # fmt: skip
"""Errors of one view and of the most, beside the floor."""


def _of(report: dict[str, Any], name: str) -> Any:
    return next(row["rms"] for row in report["rows"] if row["name"] == name and row["count"] == 16)
