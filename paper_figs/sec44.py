"""§4.4: recognition: accuracy, and how well the scores tell the objects apart."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from paper_figs import style

ITEM = "§4.4"
CAPTION = (
    "(a) Target and yaw identification accuracy, at a threshold fixed beforehand on validation frames and at the one "
    "that is best on these frames, as the paper's is. (b) Receiver operating characteristic of identification. (c) "
    "Scores of target and non-target frames; dashed: the fixed threshold."
)
EXPERIMENTS = ("reproduce_paper",)


def draw(run: Run) -> Figure:
    """Accuracy, ROC and scores."""
    figure = style.sheet(style.TWO_COLUMNS, 2.9)
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1, 1.1))
    _accuracy(axes[0], run)
    for row in run.report["segmenters"]:
        grid, color = run.arrays(f"grid_{row['segmenter']}"), style.look(row["segmenter"])["color"]
        axes[1].plot(grid["false_positive"], grid["true_positive"], color=color,
                     label=f"{row['segmenter']}: {row['auc']:.3f}")  # fmt: skip
    axes[1].plot([0, 1], [0, 1], ":", color=style.GREY)
    axes[1].set(title="identification", xlabel="false positive rate", ylabel="true positive rate")
    axes[1].legend(loc="lower right", title="area", handlelength=0.8, frameon=True, framealpha=1, edgecolor="none")
    _scores(axes[2], run)
    style.letters(axes)
    return figure


def _accuracy(ax: Axes, run: Run) -> None:
    rows = run.report["segmenters"]
    place = np.arange(len(rows))
    for shift, key, label, alpha in ((-0.2, "accuracy", "fixed", 1.0), (0.2, "best_accuracy", "best", 0.5)):
        values = [row[key] for row in rows]
        colors = [style.look(row["segmenter"])["color"] for row in rows]
        bars = ax.bar(place + shift, values, 0.38, color=colors, alpha=alpha)
        for text, color in zip(ax.bar_label(bars, [f"{label}: {value:.3f}" for value in values],
                                            label_type="center", rotation=90), colors, strict=True):  # fmt: skip
            text.set_color("white" if alpha == 1 and color == style.BLUE else "black")
    ax.axhline(paper.ACCURACY, color=style.PAPER, linestyle="--", label=f"published: {paper.ACCURACY:.4f}")
    ax.legend(loc="upper right")
    ax.set(title="accuracy", ylim=(0, 1.19), yticks=np.arange(0, 1.01, 0.2))
    style.name_columns(ax, place, [row["segmenter"] for row in rows])


def _scores(ax: Axes, run: Run) -> None:
    """Scores of both objects, a column for each segmenter, spread at random for the eye."""
    aside = np.random.default_rng(0)
    for number, row in enumerate(run.report["segmenters"]):
        grid = run.arrays(f"grid_{row['segmenter']}")
        for shift, own, color, marker in ((-0.2, True, style.BLUE, "o"), (0.2, False, style.ORANGE, "s")):
            values = grid["score"][grid["is_target"] == own]
            place = number + shift + aside.uniform(-0.13, 0.13, len(values))
            ax.plot(place, values, marker, color=color, markersize=1.8, alpha=0.6, markeredgewidth=0,
                    label=("target" if own else "non-target") if number == 0 else None)  # fmt: skip
        ax.plot([number - 0.42, number + 0.42], [row["threshold"]] * 2, "--", color=style.BLACK, linewidth=1)
    names = [row["segmenter"] for row in run.report["segmenters"]]
    ax.set(title="scores", ylabel="largest correlation (eq. 5)", ylim=(0, 1))
    style.name_columns(ax, range(len(names)), names)
    ax.legend(loc="lower left", markerscale=2.5, handlelength=0.8)


NUMBERS = [("area under the ROC", None, lambda report: report["segmenters"][0]["auc"])]
