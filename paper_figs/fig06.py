"""Fig. 6: the objects that are told apart, and the set-up to scale."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.frames import GROUND_RANGE_M
from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import tank_sonar
from paper_figs.solid import draw_solid

ITEM = "Fig. 6"
CAPTION = (
    "(a) Target and non-target, each of three bricks; the floor's grid has a pitch of 0.1 m. (b) Side view of the "
    "set-up, to scale: the sonar's vertical aperture at the three tilts, and the target where it stands at each of "
    "them. Table 1's 1.6 m (dotted) would lie outside the aperture at 15° and 20°."
)
EXPERIMENTS = ("paper_scenes",)
TABLE_1_RANGE_M, FAR_M = 1.6, 4.2
LINES = {15.0: (style.BLUE, "-"), 20.0: (style.VERMILION, "--"), 25.0: (style.GREEN, "-.")}


def draw(run: Run) -> Figure:
    """Both objects above, the side view below."""
    meshes = run.arrays("fig04")
    figure = style.sheet(style.TWO_COLUMNS, 4.6)
    axes = figure.subplot_mosaic([["target", "non-target"], ["side"] * 2], height_ratios=(1.1, 1))
    for name, color in (("target", style.ORANGE), ("non-target", style.SKY)):
        draw_solid(axes[name], meshes[f"{name}/vertices"], meshes[f"{name}/faces"], color)
        axes[name].set_title(f"(a) {name}", loc="center")
    top = max(axes[name].get_ylim()[1] for name in ("target", "non-target"))
    for name in ("target", "non-target"):
        axes[name].set_ylim(top=top)
    _side_view(axes["side"], meshes)
    return figure


def _side_view(ax: Axes, meshes: dict[str, Any]) -> None:
    for tilt_deg, (color, line) in LINES.items():
        sonar = tank_sonar(tilt_deg)
        height, half = float(sonar.height), math.degrees(float(sonar.elevation_aperture)) / 2
        away = GROUND_RANGE_M[tilt_deg]
        ends = [_end(height, math.radians(tilt_deg + side * half)) for side in (1, -1)]
        corner = [(FAR_M, 0.0)] if ends[1][1] > 0 else []
        ax.fill(*zip((0.0, height), ends[0], *corner, ends[1], strict=True), color=color, alpha=0.1, linewidth=0)
        for x, z in ends:
            ax.plot([0, x], [height, z], color=color, linestyle=line, linewidth=1)
        ax.plot([], [], color=color, linestyle=line, label=f"tilt {tilt_deg:.0f}°, target at {away:.2f} m")
        vertices, faces = meshes["target/vertices"], meshes["target/faces"]
        for triangle in vertices[faces]:
            ax.fill(triangle[:, 0] + away, triangle[:, 2], color=color, linewidth=0)
    ax.axhline(0, color="black", linewidth=1)
    ax.plot(0, height, "s", color="black", markersize=7)
    ax.annotate(f"sonar, {height:g} m\nabove the floor", (0, height), (-0.05, 0.42), ha="left", va="center")
    ax.plot([TABLE_1_RANGE_M] * 2, [0, 0.12], ":", color="black", linewidth=1)
    ax.text(TABLE_1_RANGE_M, 0.13, "Table 1: 1.6 m", ha="center", va="bottom",
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 0.5})  # fmt: skip
    title = f"(b) set-up from the side, vertical aperture {2 * half:.0f}°"
    ax.set(xlim=(-0.1, FAR_M), ylim=(-0.03, 1.0), aspect="equal", xlabel="forward over the floor [m]",
           ylabel="height [m]", yticks=np.arange(0, 1.0, 0.3), title=title)  # fmt: skip
    ax.legend(loc="upper right")


def _end(height: float, down: float) -> tuple[float, float]:
    """Where a ray that looks down by an angle [rad] meets the floor, or leaves the picture [m]."""
    floor = height / math.tan(down)
    return (floor, 0.0) if floor <= FAR_M else (FAR_M, height - FAR_M * math.tan(down))
