"""What matters in pix2pix's training."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 11"
CAPTION = (
    "Short trainings of thin networks that differ in one thing from the first (eq. 3 as the paper has it): IoU of "
    "highlight and shadow and PSNR gain on the same validation pairs at the end, and the IoU on the way. Lines: the "
    "first."
)
EXPERIMENTS = ("ablate_training",)
IOU = {"iou_mean": ("mean", "o", style.BLUE), "iou_highlight": ("highlight", "^", style.ORANGE),
       "iou_shadow": ("shadow", "s", style.SKY)}  # fmt: skip
LINES = ("-", "--", "-.", ":")


def draw(runs: Path) -> Figure:
    """IoU and gain by variant, and curves."""
    rows = load(runs, "ablate_training").report["rows"]
    names = in_order(rows, "variant")
    place = [-k for k in range(len(names))]
    figure = style.sheet(style.TWO_COLUMNS, max(2.6, 1.0 + 0.22 * len(names)))
    axes = figure.subplots(1, 3, width_ratios=(1, 0.7, 1.2))
    for key, (label, marker, color) in IOU.items():
        axes[0].plot([row[key] for row in rows], place, marker, color=color, label=label)
    axes[1].plot([row["psnr_gain_db"] for row in rows], place, "o", color=style.BLUE)
    for ax, key, title in zip(axes, ("iou_mean", "psnr_gain_db"), ("IoU", "PSNR gain"), strict=False):
        ax.axvline(rows[0][key], color=style.GREY, linewidth=0.8)
        ax.set(title=title, yticks=place, yticklabels=names if ax is axes[0] else [])
        ax.grid(True)
    axes[1].set_xlabel("[dB]")
    axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, handletextpad=0.1, columnspacing=0.6)
    for number, row in enumerate(rows):
        color, line = style.PALETTE[number % len(style.PALETTE)], LINES[number // len(style.PALETTE) % len(LINES)]
        axes[2].plot(row["curve"]["images"], row["curve"]["iou_mean"], color=color, linestyle=line,
                     label=row["variant"], linewidth=1)  # fmt: skip
    axes[2].set(title="IoU on the way", xlabel="images seen")
    axes[2].grid(True)
    axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.4)
    style.letters(axes)
    return figure


def numbers(runs: Path) -> list[Number]:
    """IoU of the first and of what takes most away from it."""
    return listed(runs, "ablate_training", [
        (f"{name}: IoU", None, lambda report, name=name: row_where(report["rows"], variant=name)["iou_mean"])
        for name in ("eq. 3", "no discriminator", "no skips", "shipped loss")
    ])  # fmt: skip
