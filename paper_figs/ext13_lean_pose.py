"""How far off the pose of a leaning object is, in one frame and in two views."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import row_where

ITEM = "Ext. 13"
CAPTION = (
    "Objects that lean by up to 15°, up to 5 cm above the floor: error of rotation against error of place, one marker "
    "an object, from one frame (a) and from two views 90° apart (b); lines are the bars that were set for the means."
)
EXPERIMENTS = ("lean_pose",)
BARS = {"1": (3.0, 8.0), "2": (1.0, 3.0)}
"""Largest mean errors that were aimed at, by the number of views: place [cm] and rotation [°]."""
MARKERS = "os^"


def draw(run: Run) -> Figure:
    """One view left, two right."""
    found = run.report["per_frame"]
    figure = style.sheet(style.TWO_COLUMNS, 2.5)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, (views, (place, angle)) in zip(axes, BARS.items(), strict=True):
        for (name, parts), marker in zip(found.items(), MARKERS, strict=False):
            errors = [[one[key] for one in parts[views]] for key in ("cm", "deg")]
            ax.plot(*errors, marker, label=name, markersize=4, alpha=0.8)
        ax.axvline(place, color="0.5", linewidth=0.8, linestyle=":")
        ax.axhline(angle, color="0.5", linewidth=0.8, linestyle=":")
        title = "one frame" if views == "1" else "two views"
        ax.set(title=title, xlabel="place [cm]", ylabel="rotation [°]", xscale="log", yscale="log")
        ax.grid(True)
    axes[1].legend(loc="upper left")
    style.letters(axes)
    return figure


NUMBERS = [
    (f"judge, views: {views}, {what}", None, lambda report, views=views, key=key: row_where(
        report["rows"], name="judge", views=views)[key])
    for views in ("1", "2") for what, key in (("place, mean [cm]", "mean_cm"), ("rotation, mean [°]", "mean_deg"))
]  # fmt: skip
"""Mean errors on the judge's frames."""
