"""How well tilt and distance must be known."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.shared import Number, in_order, listed, load, row_where

ITEM = "Ext. 9"
CAPTION = (
    "Banks rendered for a wrong tilt (left) or a wrong ground range (right): (above) accuracy at the best threshold "
    "(solid) and yaw bins right (dashed); (below) mean correlation with the right template (solid), the best one of "
    "other yaws (dashed) and with the other object (dotted)."
)
EXPERIMENTS = ("ablate_geometry",)
WRONG = {"tilt": ("tilt_error_deg", "error of the tilt [°]"), "distance": ("distance_error_m", "error of distance [m]")}
SHARES = (("best_accuracy", "-"), ("bin_right", "--"))
SCORES = (("score_own", "-"), ("score_wrong", "--"), ("score_other", ":"))


def draw(runs: Path) -> Figure:
    """Shares above, correlations below."""
    rows = load(runs, "ablate_geometry").report["rows"]
    figure = style.sheet(style.TWO_COLUMNS, 3.9)
    axes = figure.subplots(2, len(WRONG), sharex="col", sharey="row")
    for column, (wrong, (key, label)) in zip(axes.T, WRONG.items(), strict=True):
        for name in in_order(rows, "map"):
            own = sorted((r for r in rows if r["wrong"] == wrong and r["map"] == name), key=lambda r: r[key])
            at, look = [row[key] for row in own], style.look(name)
            for ax, curves in zip(column, (SHARES, SCORES), strict=True):
                for number, (value, line) in enumerate(curves):
                    ax.plot(at, [row[value] for row in own], **look, linestyle=line, markersize=3.5 - number,
                            label=name if number == 0 else None)  # fmt: skip
        column[1].set_xlabel(label)
        column[0].set_title(f"recognition, wrong {wrong}")
        column[1].set_title(f"correlation, wrong {wrong}")
    for ax in axes.flat:
        ax.set_ylim(top=1.02)
        ax.grid(True)
    axes[0, 0].set_ylabel("share of frames")
    axes[1, 0].set_ylabel("correlation")
    axes[0, 0].legend(loc="lower center")
    style.letters(axes.flat)
    return figure


def numbers(runs: Path) -> list[Number]:
    """Accuracy on the network's maps, right and wrong by a little."""
    cases = (("right geometry", "tilt", 0.0), ("tilt 5° too steep", "tilt", 5.0), ("0.3 m too far", "distance", 0.3))
    return listed(runs, "ablate_geometry", [
        (f"pix2pix, {what}: accuracy, best threshold", None, lambda report, wrong=wrong, off=off: row_where(
            report["rows"], map="pix2pix", wrong=wrong, **{WRONG[wrong][0]: off})["best_accuracy"])
        for what, wrong, off in cases
    ])  # fmt: skip
