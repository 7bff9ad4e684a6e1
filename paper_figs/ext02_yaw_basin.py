"""From how far off refinement finds the yaw."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import in_order, row_where

ITEM = "Ext. 2"
CAPTION = (
    "Basin of convergence: share of refinements that end within 1° (solid) and 2° (dashed) of the true yaw, over how "
    "far off they start, on labels of a converged render and on the network's maps of noisy frames. The default "
    "ladder of blurs, and the same without its widest."
)
EXPERIMENTS = ("yaw_basin",)
COLORS = (style.BLUE, style.ORANGE)


def draw(run: Run) -> Figure:
    """A panel for each kind of map."""
    rows = run.report["rows"]
    maps = in_order(rows, "map")
    figure = style.sheet(style.TWO_COLUMNS, 2.6)
    axes = figure.subplots(1, len(maps), squeeze=False, sharey=True)[0]
    for ax, name in zip(axes, maps, strict=True):
        for blurs, color in zip(in_order(rows, "blurs"), COLORS, strict=False):
            own = [row for row in rows if row["map"] == name and row["blurs"] == blurs]
            starts = [row["start_deg"] for row in own]
            ax.plot(starts, [row["within_1"] for row in own], "o-", color=color, label=f"blurs {blurs}")
            ax.plot(starts, [row["within_2"] for row in own], "--", color=color, linewidth=0.9)
        ax.axvspan(-5, 5, color=style.LIGHT, alpha=0.6, linewidth=0)
        ax.set(title=name, xlabel="start off by [°]", ylim=(0, 1.04))
        ax.grid(True)
    axes[0].set_ylabel("share of refinements")
    axes[-1].legend(loc="lower center")
    style.letters(axes)
    return figure


NUMBERS = [
    (f"{name}: within 1° from {start:+.0f}°", None,
     lambda report, name=name, start=start: row_where(report["rows"], map=name, start_deg=start)["within_1"])
    for name in ("labels", "pix2pix") for start in (-20.0, 20.0)
]  # fmt: skip
"""Shares that end within 1°, started 20° off."""
