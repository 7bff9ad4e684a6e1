"""Fig. 5: training pairs."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style

ITEM = "Fig. 5"
CAPTION = (
    "Samples of training pairs: a simulated sonar image, cropped around the objects and rescaled to 128 × 128 pixels "
    "(above), and its semantic map (below; highlight white, shadow black). Near ranges are below, port is left."
)
EXPERIMENTS = ("paper_scenes",)
GREY_OF = (0.5, 1.0, 0.0)  # background, highlight, shadow


def draw(run: Run) -> Figure:
    """Images above, maps below."""
    pairs = run.arrays("fig05")
    count, size = len(pairs["image"]), pairs["image"].shape[-1]
    figure = style.sheet(style.TWO_COLUMNS, 0.45 + 2 * 6.7 / max(count, 6))
    axes = figure.subplots(2, count, squeeze=False)
    for k in range(count):
        maps = [[GREY_OF[label] for label in row] for row in pairs["labels"][k]]
        for ax, image in zip(axes[:, k], (pairs["image"][k], maps), strict=True):
            ax.imshow(np.asarray(image)[:, ::-1], cmap="gray", vmin=0, vmax=1, origin="lower")
            ax.spines[:].set_visible(True)
            ax.set(xticks=[], yticks=[])
    axes[0, 0].set_ylabel("image")
    axes[1, 0].set_ylabel("semantic map")
    for ax in axes[1]:
        ax.set_xlabel(f"{size} px")
    return figure
