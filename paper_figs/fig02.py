"""Fig. 2: the same object looks different from every side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import center_of, close_up, outer_labels, tank_sonar

ITEM = "Fig. 2"
CAPTION = (
    "Shapes of the same object changing according to its yaw: simulated frames of the target (above) and the same "
    "without noise (below), in fan view. The sonar is below, looking up."
)
EXPERIMENTS = ("paper_scenes",)
SIZE_M = (0.8, 0.95)


def draw(run: Run) -> Figure:
    """Four yaws, with and without noise."""
    scene = run.arrays("fig02")
    sonar, count = tank_sonar(scene["tilt_deg"]), min(4, len(scene["image"]))
    figure = style.sheet(style.TWO_COLUMNS, 4.3)
    axes = figure.subplots(2, count, squeeze=False)
    center = np.mean([center_of(clean, sonar) for clean in scene["clean"][:count]], axis=0)
    for k in range(count):
        for ax, image in zip(axes[:, k], (scene["image"][k], scene["clean"][k]), strict=True):
            close_up(ax, image, sonar, tuple(center), SIZE_M)
        axes[0, k].set_title(f"yaw {scene['yaw_deg'][k]:.0f}°")
    outer_labels(axes)
    return figure
