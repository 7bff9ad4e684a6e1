"""Fig. 4: objects of the training data."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.solid import draw_solid

ITEM = "Fig. 4"
CAPTION = "Objects used for the training data, all at one scale: the floor's grid has a pitch of 0.1 m."
EXPERIMENTS = ("paper_scenes",)
OBJECTS = {"concrete cylinder": style.SKY, "plastic ball": style.GREEN, "clay brick": style.VERMILION}


def draw(run: Run) -> Figure:
    """The three objects beside each other."""
    meshes = run.arrays("fig04")
    figure = style.sheet(style.TWO_COLUMNS, 2.1)
    axes = figure.subplots(1, len(OBJECTS))
    for ax, (name, color) in zip(axes, OBJECTS.items(), strict=True):
        vertices = meshes[f"{name}/vertices"]
        draw_solid(ax, vertices, meshes[f"{name}/faces"], color)
        size = " × ".join(f"{extent:.2f}".rstrip("0") for extent in np.ptp(vertices, axis=0))
        ax.set_title(f"{name}, {size} m", loc="center", fontsize=8)
    low, high = zip(*(ax.get_ylim() for ax in axes), strict=True)
    for ax in axes:
        ax.set_ylim(min(low), max(high))
    return figure
