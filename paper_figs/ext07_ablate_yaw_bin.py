"""How wide the bins of yaw may be."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 7"
CAPTION = (
    "Width of a yaw bin (the paper's: 10°): (a) median yaw error of the best bin (dashed) and refined (solid), and "
    "what always finding the nearest bin would leave (grey); (b) share of frames more than 20° off; (c) time a frame."
)
EXPERIMENTS = ("ablate_yaw_bin",)
PANELS = {"median": "median error [°]", "astray": "over 20° off", "ms": "time a frame [ms]"}


def draw(runs: Path) -> Figure:
    """Error, frames astray and time."""
    rows = load(runs, "ablate_yaw_bin").report["rows"]
    figure = style.sheet(style.TWO_COLUMNS, 2.5)
    axes = figure.subplots(1, len(PANELS))
    widths = sorted(in_order(rows, "bin_deg"))
    axes[0].plot(widths, [width / 4 for width in widths], color="0.75", linewidth=4, label="nearest bin", zorder=0)
    for ax, (key, title) in zip(axes, PANELS.items(), strict=True):
        for name in in_order(rows, "segmenter"):
            own = sorted((row for row in rows if row["segmenter"] == name), key=lambda row: row["bin_deg"])
            at, look = [row["bin_deg"] for row in own], style.look(name)
            ax.plot(at, [row[f"bin_{key}"] for row in own], **look, linestyle="--", markerfacecolor="white")
            ax.plot(at, [row[f"yaw_{key}"] for row in own], **look, label=name)
        ax.set(title=title, xlabel="width of a bin [°]", xscale="log")
        ax.set_xticks(widths, [str(width) for width in widths])
        ax.minorticks_off()
        ax.grid(True)
        if key == "median":
            ax.set_yscale("log")
            style.plain_log(ax.yaxis)
        else:
            ax.set_ylim(bottom=0)
    axes[1].legend(*axes[0].get_legend_handles_labels(), loc="upper left", handlelength=1.4)  # room is there
    style.letters(axes)
    return figure


def numbers(runs: Path) -> list[Number]:
    """Median errors of the network by width of the bins."""
    return listed(runs, "ablate_yaw_bin", [
        (f"pix2pix, bins of {width}°: {what} [°]", None, lambda report, width=width, key=key: row_where(
            report["rows"], bin_deg=width, segmenter="pix2pix")[key])
        for width in (2, 10, 30) for key, what in (("bin_median", "bin error"), ("yaw_median", "refined"))
    ])  # fmt: skip
