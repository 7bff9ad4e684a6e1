"""Fig. 3: template images from a 3D model."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import center_of, close_up, in_frame, outer_labels, tank_sonar
from paper_figs.solid import draw_solid

ITEM = "Fig. 3"
CAPTION = (
    "Simulated template images, given the 3D model of the object: highlight white, shadow black. The floor's grid has "
    "a pitch of 0.1 m; x looks away from the sonar at a yaw of 0°."
)
EXPERIMENTS = ("paper_scenes",)
SIZE_M, SHOWN = (0.62, 0.95), 4


def draw(run: Run) -> Figure:
    """The target's model and some of its templates."""
    bank, meshes = run.arrays("fig03"), run.arrays("fig04")
    sonar, picked = tank_sonar(bank["tilt_deg"]), np.arange(SHOWN) * len(bank["templates"]) // SHOWN
    figure = style.sheet(style.TWO_COLUMNS, 2.3)
    model, *others = figure.subplots(1, 1 + SHOWN, width_ratios=(2.2, *[1] * SHOWN))
    draw_solid(model, meshes["target/vertices"], meshes["target/faces"])
    model.set_title("3D model", loc="center")
    frames = [in_frame(bank["templates"][k], bank["offset"], sonar) for k in picked]
    center = np.mean([center_of(frame, sonar) for frame in frames], axis=0)
    axes = np.array([others])
    for ax, k, frame in zip(others, picked, frames, strict=True):
        close_up(ax, frame, sonar, tuple(center), SIZE_M)
        ax.set_title(f"yaw {bank['yaw_deg'][k]:.0f}°")
    outer_labels(axes)
    return figure
