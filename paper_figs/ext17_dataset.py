"""Frames of a data set, and what is in them: highlight and shadow of each object."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style

ITEM = "Ext. 17"
CAPTION = (
    "Frames of `sonarjax dataset --scenes 3`, a device drawn for each (above), and what is seen of each object "
    "(below): its highlight in a colour of its own, its shadow darker. Polar view, near below, port on the left."
)
EXPERIMENTS = ("bench_dataset",)
COLORS = (style.ORANGE, style.SKY, style.GREEN)
SHADE = 0.55
"""How much darker a shadow is."""


def draw(run: Run) -> Figure:
    """Frames above, instances below."""
    found = run.arrays("frames")
    count = len(found["image"])
    figure = style.sheet(style.TWO_COLUMNS, 4.2)
    axes = figure.subplots(2, count, squeeze=False)
    for k, (frame, below) in enumerate(axes.T):
        _show(frame, np.repeat(found["image"][k][..., None], 3, axis=2))
        _show(below, _colored(found["instances"][k], found["labels"][k]))
    return figure


def _colored(instances: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Colours (range, beam, 3) of the objects' numbers, shadow darker, background white."""
    palette = np.array([to_rgb(color) for color in COLORS])
    own = palette[(instances.astype(int) - 1) % len(palette)] * np.where(labels == 2, SHADE, 1.0)[..., None]
    return np.where((instances > 0)[..., None], own, 0.96)


def _show(ax: Axes, picture: np.ndarray) -> None:
    ax.imshow(picture[::-1, ::-1], aspect="auto", interpolation="nearest")
    ax.set(xticks=(), yticks=())


NUMBERS = [
    ("COCO, one object: frames a second, made", None, lambda report: _coco(report)["made"]),
    ("COCO, one object: made over written alone", None, lambda report: _coco(report)["share"]),
]
"""Frames a second of one format."""


def _coco(report: dict[str, Any]) -> dict[str, Any]:
    return next(row for row in report["rows"] if row["format"] == "coco" and row["scenes"] == 1)
