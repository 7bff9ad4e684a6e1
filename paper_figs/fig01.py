"""Fig. 1: the pipeline, on one frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.common.runs import Run
from experiments.reproduce_paper import EXAMPLES
from paper_figs import style
from paper_figs.shared import center_of, close_up, in_frame, outer_labels, tank_sonar
from sonarjax.plot import draw_outline, plot_scores

ITEM = "Fig. 1"
CAPTION = (
    "The pipeline: a sonar frame, the semantic map that the network makes of it, the template of the best yaw bin "
    "(its outline also on the map: highlight orange, shadow blue), and the correlation (eq. 4) with the templates of "
    "all yaws, whose largest value is the yaw (eq. 5)."
)
EXPERIMENTS = ("reproduce_paper", "paper_scenes")
SIZE_M = (0.62, 1.0)


def draw(run: Run, paper_scenes: Run) -> Figure:
    """Frame → map → template → score over yaw."""
    scenes = paper_scenes.arrays("fig03")
    name, limit = run.report["segmenters"][0]["segmenter"], run.report["segmenters"][0]["threshold"]
    maps, grid = run.arrays(f"maps_{name}"), run.arrays(f"grid_{name}")
    shown = _example(maps, float(scenes["tilt_deg"]))
    sonar, scores = tank_sonar(scenes["tilt_deg"]), grid["scores"][_frame(grid, shown)]
    yaws = np.arange(len(scores)) * 2 * np.pi / len(scores)
    best = int(np.abs(scenes["yaw_deg"] - np.degrees(yaws[scores.argmax()])).argmin())
    template = in_frame(scenes["templates"][best], scenes["offset"], sonar)
    figure = style.sheet(style.TWO_COLUMNS, 2.45)
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.9))
    center = center_of(maps["truth"][shown], sonar)
    titles = "sonar frame", f"map, {name}", f"template, {scenes['yaw_deg'][best]:.0f}°"
    images = maps["image"][shown], maps["semantic"][shown], template
    for ax, image, title in zip(axes, images, titles, strict=False):
        close_up(ax, image, sonar, center, SIZE_M)
        ax.set_title(title)
    draw_outline(axes[1], scenes["templates"][best], sonar, offset=tuple(map(int, scenes["offset"])), view="fan")
    outer_labels(axes[None, :3])
    plot_scores(axes[3], yaws, scores, threshold=limit)
    axes[3].set_title("score over yaw")
    axes[3].set_ylim(top=1.0)
    style.letters(axes)
    for ax in axes[:-1]:
        ax.annotate("", (1.09, 0.5), (1.0, 0.5), "axes fraction", annotation_clip=False,
                    arrowprops={"arrowstyle": "-|>", "color": style.GREY, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
    return figure


def _example(maps: dict[str, Any], tilt_deg: float) -> int:
    """The first of the kept target frames at this tilt [deg]."""
    return int(np.flatnonzero(maps["is_target"] & (maps["tilt_deg"] == tilt_deg))[0])


def _frame(grid: dict[str, Any], shown: int) -> int:
    """The number among all frames of one whose pictures were kept: one a set, a quarter turn and a bit apart."""
    own = np.flatnonzero(grid["is_target"])
    size = len(own) // EXAMPLES
    return int(own[shown * size + shown * (size // 4 + 1) % size])
