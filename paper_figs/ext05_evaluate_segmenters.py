"""Segmenters side by side on all sets of frames."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import in_order, row_where

ITEM = "Ext. 5"
CAPTION = (
    "Segmenters side by side: accuracy at the fixed threshold, yaw bins right, IoU and gain in PSNR, on the frames of "
    "§4.1 and on four harder or other sets. `truth` matches the true maps; the paper's values are dashed."
)
EXPERIMENTS = ("evaluate_segmenters",)
TRUE_GAIN = ("psnr_gain", "truth")  # no gain at all but the most that PSNR counts: it would dwarf the others
PANELS = {
    "accuracy": ("accuracy", paper.ACCURACY),
    "bin_right": ("yaw bin right", None),
    "iou": ("IoU", paper.IOU),
    "psnr_gain": ("PSNR gain [dB]", paper.PSNR_GAIN),
}


def draw(run: Run) -> Figure:
    """A panel for each measure, a line of markers for each segmenter."""
    sets = run.report["sets"]
    names = in_order([row for rows in sets.values() for row in rows], "segmenter")
    figure = style.sheet(style.TWO_COLUMNS, 1.0 + 0.36 * len(names))
    axes = figure.subplots(1, len(PANELS), sharey=True)
    place = {name: len(names) - 1 - k for k, name in enumerate(names)}
    for ax, (key, (title, said)) in zip(axes, PANELS.items(), strict=True):
        for number, (label, rows) in enumerate(sets.items()):
            known = [np.nan if (key, row["segmenter"]) == TRUE_GAIN else row[key] for row in rows]
            values = np.array(known, float)
            at, look = (
                [place[row["segmenter"]] + 0.14 * (2 - number) for row in rows],
                (style.MARKERS[number], style.PALETTE[number]),
            )
            ax.plot(values, at, look[0], color=look[1], alpha=0.85, markeredgecolor="white", markeredgewidth=0.3,
                    label=label)  # fmt: skip
        if said is not None:
            ax.axvline(said, color=style.PAPER, linestyle="--", linewidth=1)
        ax.set_title(title)
        ax.grid(True)
    axes[0].set_yticks(list(place.values()), list(place))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, columnspacing=1.2,
                  handletextpad=0.2)  # fmt: skip
    style.letters(axes)
    return figure


NUMBERS = [
    (f"pix2pix, {title}: {what}", said,
     lambda report, title=title, key=key: row_where(report["sets"][title], segmenter="pix2pix")[key])
    for title in ("severity 1", "severity 1.5", "mirror image", "offset yaw", "other devices")
    for key, what, said in (("accuracy", "accuracy", None), ("iou", "IoU", None))
]  # fmt: skip
"""Accuracy and IoU of the network on each set."""
