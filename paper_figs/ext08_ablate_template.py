"""What carries the match: highlight, shadow or both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 8"
CAPTION = (
    "Templates of highlight, shadow and both, on the true maps, the network's and the raw frames: (a) accuracy at the "
    "best threshold, (b) yaw bins right, (c) mean correlation with the right template (filled), the best one of other "
    "yaws (hollow) and with the other object (×)."
)
EXPERIMENTS = ("ablate_template",)
COLORS = {"both": style.BLUE, "highlight": style.ORANGE, "shadow": style.SKY}


def draw(runs: Path) -> Figure:
    """Bars of two shares, and correlations."""
    rows = load(runs, "ablate_template").report["rows"]
    maps, parts = in_order(rows, "map"), in_order(rows, "part")
    figure = style.sheet(style.TWO_COLUMNS, 2.6)
    axes = figure.subplots(1, 3)
    place, width = np.arange(len(maps)), 0.8 / len(parts)
    for number, part in enumerate(parts):
        at = place + width * (number - (len(parts) - 1) / 2)
        own = [row_where(rows, map=name, part=part) for name in maps]
        for ax, key in zip(axes, ("best_accuracy", "bin_right"), strict=False):
            ax.bar(at, [row[key] for row in own], 0.92 * width, color=COLORS[part], label=part)
        for key, marker, face in (("score_own", "o", COLORS[part]), ("score_wrong", "o", "white"),
                                  ("score_other", "x", COLORS[part])):  # fmt: skip
            axes[2].plot(at, [row[key] for row in own], marker, color=COLORS[part], markerfacecolor=face)
    for ax, title in zip(axes, ("accuracy", "yaw bin right", "correlation"), strict=True):
        ax.set(title=title, ylim=(0, 1.04))
        ax.set_xticks(place, maps)
        ax.grid(True, axis="y")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, title="template")
    style.letters(axes)
    return figure


def numbers(runs: Path) -> list[Number]:
    """Accuracy of each kind of template on the network's maps."""
    return listed(runs, "ablate_template", [
        (f"pix2pix, template of {part}: accuracy, best threshold", None, lambda report, part=part: row_where(
            report["rows"], map="pix2pix", part=part)["best_accuracy"])
        for part in COLORS
    ])  # fmt: skip
