"""How recognition falls as the sonar gets worse."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 6"
CAPTION = (
    "Severity of the sensor model (1: calibrated to the paper's frames): (a) accuracy at the threshold that was fixed "
    "at severity 1 (solid) and at the best one on the same frames (dashed), (b) mean score of target (filled) and "
    "non-target (hollow)."
)
EXPERIMENTS = ("ablate_severity",)


def draw(runs: Path) -> Figure:
    """Accuracy left, scores right."""
    rows = load(runs, "ablate_severity").report["rows"]
    figure = style.sheet(style.TWO_COLUMNS, 2.5)
    axes = figure.subplots(1, 2)
    for name in in_order(rows, "segmenter"):
        own = [row for row in rows if row["segmenter"] == name]
        at, look = [row["severity"] for row in own], style.look(name)
        axes[0].plot(at, [row["accuracy"] for row in own], **look, label=name)
        axes[0].plot(at, [row["best_accuracy"] for row in own], "--", color=look["color"], linewidth=0.9)
        axes[1].plot(at, [row["score_target"] for row in own], **look, label=name)
        axes[1].plot(at, [row["score_other"] for row in own], **look, linestyle=":", markerfacecolor="white")
    for ax, title in zip(axes, ("accuracy", "score"), strict=True):
        ax.set(title=title, xlabel="severity", ylim=(0, 1.04), xticks=in_order(rows, "severity"))
        ax.grid(True)
    axes[0].legend(loc="lower left")
    style.letters(axes)
    return figure


def numbers(runs: Path) -> list[Number]:
    """Accuracy of the network at some severities."""
    return listed(runs, "ablate_severity", [
        (f"pix2pix, severity {severity:g}: accuracy", None, lambda report, severity=severity: row_where(
            report["rows"], severity=severity, segmenter="pix2pix")["accuracy"])
        for severity in (0.0, 1.0, 2.0)
    ])  # fmt: skip
