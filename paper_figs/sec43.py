"""§4.3: how good the semantic maps are."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from paper_figs import style

ITEM = "§4.3"
CAPTION = (
    "Peak signal-to-noise ratio before and after segmentation, and intersection over union of the maps, on crops "
    "around the target. Both depend on the crop's margins, which the paper does not give."
)
EXPERIMENTS = ("reproduce_paper",)


def draw(run: Run) -> Figure:
    """PSNR left, IoU right."""
    rows = run.report["segmenters"]
    names = ["published", *(row["segmenter"] for row in rows)]
    figure = style.sheet(style.TWO_COLUMNS, 2.7)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    before, after = ([said, *(row[key] for row in rows)]
                     for said, key in ((paper.PSNR_RAW, "psnr_raw"), (paper.PSNR_MAP, "psnr")))  # fmt: skip
    place = np.arange(len(names))
    for shift, values, label, color in ((-0.2, before, "before", style.LIGHT), (0.2, after, "after", style.BLUE)):
        _bars(left, place + shift, values, 0.38, color, "{:.1f}")
        left.bar(0, 0, color=color, label=f"{label} segmentation")
    left.set(title="PSNR", ylabel="PSNR [dB]", ylim=(0, 1.3 * max(before + after)))
    left.legend(loc="upper right", ncols=2)
    _bars(right, place, [paper.IOU, *(row["iou"] for row in rows)], 0.6, style.BLUE, "{:.3f}")
    right.set(title="IoU, mean of highlight and shadow", ylabel="IoU", ylim=(0, 1))
    for ax in (left, right):
        style.name_columns(ax, place, names)
        ax.get_xticklabels()[0].set_color(style.PAPER)
    style.letters((left, right))
    return figure


def _bars(ax: Axes, place: np.ndarray, values: list[float], width: float, color: str, form: str) -> None:
    """Bars with their values, the first of them edged in the paper's colour."""
    bars = ax.bar(place, values, width, color=color)
    bars[0].set(edgecolor=style.PAPER, linewidth=1.3)
    ax.bar_label(bars, [form.format(value) for value in values], padding=1)
