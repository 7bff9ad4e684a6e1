"""Fig. 7: the templates of all yaws."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import center_of, close_up, in_frame, outer_labels, tank_sonar

ITEM = "Fig. 7"
CAPTION = (
    "Simulated template images of the target at all yaws of the bank, in fan view, each 0.52 m wide: highlight white, "
    "shadow black. The sonar is below."
)
EXPERIMENTS = ("paper_scenes",)
COLUMNS, SIZE_M = 12, (0.52, 0.84)


def draw(run: Run) -> Figure:
    """One small panel for each yaw."""
    bank = run.arrays("fig03")
    sonar, count = tank_sonar(bank["tilt_deg"]), len(bank["templates"])
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = style.sheet(style.TWO_COLUMNS, 0.42 + 0.99 * rows)
    axes = figure.subplots(rows, columns, squeeze=False)
    frames = [in_frame(template, bank["offset"], sonar) for template in bank["templates"]]
    center = np.mean([center_of(frame, sonar) for frame in frames], axis=0)
    for k, ax in enumerate(axes.flat):
        ax.set_visible(k < count)
        if k < count:
            close_up(ax, frames[k], sonar, tuple(center), SIZE_M)
            ax.set_title(f"{bank['yaw_deg'][k]:.0f}°", loc="center", fontsize=8, pad=2)
    outer_labels(axes, xlabel=f"{SIZE_M[0]:g} m")
    for ax in axes.flat:
        ax.set_xticks([])
    figure.get_layout_engine().set(w_pad=0.015, h_pad=0.015, wspace=0.02, hspace=0.02)
    return figure
