"""§3.2: how long the paper's training takes."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import in_order, row_where

ITEM = "§3.2"
CAPTION = (
    "Training time of the paper's recipe, 30 epochs of 6,780 pairs of 128 × 128 pixels, at the images/s measured "
    "here, with PyTorch's for the same networks and step in the same run on the same machine. The paper's 1.2 h are "
    "of width 64 on a Titan V."
)
EXPERIMENTS = ("bench_train",)
IMAGES, WIDTH = 30 * 6780, 64
SIDES = {"ours": ("sonarjax", style.BLUE, ""), "torch": ("PyTorch", style.ORANGE, "//")}


def hours(report: dict[str, Any], side: str, width: int = WIDTH) -> float:
    """What the recipe would take [h]. Raises StopIteration or KeyError where that was not timed."""
    return IMAGES / row_where(report["rows"], width=width, work="training")["images"][side] / 3600


def draw(run: Run) -> Figure:
    """Hours by width of the network."""
    report = run.report
    rows = [row for row in report["rows"] if row["work"] == "training"]
    widths = in_order(rows, "width")
    sides = [side for side in SIDES if all(side in row["images"] for row in rows)]
    figure = style.sheet(style.ONE_COLUMN, 2.5)
    ax = figure.subplots()
    for number, side in enumerate(sides):
        name, color, hatch = SIDES[side]
        taken = [hours(report, side, width) for width in widths]
        place = [k + 0.4 * (number - (len(sides) - 1) / 2) for k in range(len(widths))]
        bars = ax.bar(place, taken, 0.38, color=color, hatch=hatch, edgecolor="white", label=name)
        ax.bar_label(bars, [f"{value:.2g}" for value in taken], padding=1)
    ax.axhline(paper.TRAINING_HOURS, color=style.PAPER, linestyle="--", label="paper, Titan V: 1.2 h")
    cores = "one core" if report["cores"] == 1 else f"{report['cores']} cores"
    ax.set(xticks=range(len(widths)), xticklabels=widths, xlabel=f"width of the network ({report['device']}, {cores})",
           ylabel="training time [h]")  # fmt: skip
    ax.margins(y=0.4)
    ax.legend(loc="upper left")
    return figure


NUMBERS = [
    (f"training [h], width {WIDTH}", paper.TRAINING_HOURS, lambda report: hours(report, "ours")),
    (f"the same in PyTorch [h], width {WIDTH}", None, lambda report: hours(report, "torch")),
]  # fmt: skip
"""Hours at the paper's width."""
