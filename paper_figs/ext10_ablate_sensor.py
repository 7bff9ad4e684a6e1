"""Which part of the sensor makes its frames hard."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 10"
CAPTION = (
    "Parts of the sensor model switched off one at a time, and all of them: correlation of target frames with their "
    "own template, PSNR and IoU of the maps, and accuracy at the best threshold. Lines: the whole sensor."
)
EXPERIMENTS = ("ablate_sensor",)
WHOLE = "nothing"
PANELS = {"score_own": "NCC own", "psnr": "PSNR [dB]", "iou": "IoU", "best_accuracy": "accuracy"}


def draw(runs: Path) -> Figure:
    """A panel for each measure, a line for each part."""
    rows = load(runs, "ablate_sensor").report["rows"]
    parts = in_order(rows, "part")
    figure = style.sheet(style.TWO_COLUMNS, max(2.0, 0.9 + 0.2 * len(parts)))
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for ax, (key, title) in zip(axes, PANELS.items(), strict=True):
        for name in in_order(rows, "segmenter"):
            own, look = [row for row in rows if row["segmenter"] == name], style.look(name)
            ax.plot([row[key] for row in own], [-parts.index(row["part"]) for row in own], linestyle="none", **look,
                    label=name)  # fmt: skip
            for row in own:
                if row["part"] == WHOLE:
                    ax.axvline(row[key], color=look["color"], linewidth=0.8)
        ax.set_title(title)
        ax.grid(True)
    axes[0].set_yticks([-k for k in range(len(parts))], parts)
    axes[0].set_ylabel("switched off")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    style.letters(axes)
    return figure


def numbers(runs: Path) -> list[Number]:
    """Raw correlation of the whole sensor, without speckle, and without everything."""
    return listed(runs, "ablate_sensor", [
        (f"NCC own of raw frames, {part} switched off", None, lambda report, part=part: row_where(
            report["rows"], part=part, segmenter="none")["score_own"])
        for part in (WHOLE, "speckle", "all of them")
    ])  # fmt: skip
