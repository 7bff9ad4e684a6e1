"""What is found for objects that look alike at several yaws."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import in_order, row_where

ITEM = "Ext. 4"
CAPTION = (
    "Yaws found less the true one, for objects that look the same every 90° or 180° (grey lines): the best hypothesis "
    "filled, the second hollow."
)
EXPERIMENTS = ("symmetric_objects",)


def draw(run: Run) -> Figure:
    """A panel for each object."""
    rows, found = run.report["rows"], run.arrays("hypotheses")
    objects = in_order(rows, "object")
    figure = style.sheet(style.TWO_COLUMNS, 2.7)
    axes = figure.subplots(1, len(objects), squeeze=False, sharey=True)[0]
    for ax, name in zip(axes, objects, strict=True):
        key, period = name.replace(" ", "_"), row_where(rows, object=name)["period_deg"]
        true = found[f"{key}_true_yaw_deg"]
        for line in np.arange(-180, 181, period):
            ax.axhline(line, color=style.LIGHT, linewidth=3, zorder=0)
        for segmenter in in_order(rows, "segmenter"):
            yaws, look = found[f"{key}_{segmenter}_yaw_deg"], style.look(segmenter)
            for number in reversed(range(yaws.shape[1])):
                off = (yaws[:, number] - true + 180 + period / 4) % 360 - 180 - period / 4
                face = look["color"] if number == 0 else "none"
                ax.plot(true % 360, off, linestyle="none", markerfacecolor=face, markeredgewidth=0.8, **look,
                        label=segmenter if number == 0 else None)  # fmt: skip
        ax.set(title=f"{name}, {period:.0f}°", xlabel="true yaw [°]", xlim=(0, 360), xticks=range(0, 361, 90))
        ax.set(ylim=(-245, 200), yticks=range(-180, 181, 90))
    axes[0].set_ylabel("yaw found less true yaw [°]")
    axes[0].legend(loc="lower center", ncols=2, columnspacing=0.8, handletextpad=0.2)
    style.letters(axes)
    return figure


NUMBERS = [
    (f"{name}, pix2pix: two hypotheses, both right", None,
     lambda report, name=name: row_where(report["rows"], object=name, segmenter="pix2pix")["two_within"])
    for name in ("square box", "lying cylinder", "two-fold pile")
]  # fmt: skip
"""How often both hypotheses are there and right."""
