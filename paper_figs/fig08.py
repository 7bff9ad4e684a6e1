"""Fig. 8: what segmentation makes of sonar images."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import center_of, close_up, tank_sonar

ITEM = "Fig. 8"
CAPTION = (
    "Results of the segmentation: simulated sonar images (above), the semantic maps that the network makes of them, "
    "and the true maps (below), of target and non-target in the four sets of §4.1; fan view around the object, each "
    "0.66 m × 1.05 m."
)
EXPERIMENTS = ("reproduce_paper",)
SIZE_M = (0.66, 1.05)


def draw(run: Run) -> Figure:
    """A column for each frame that was kept."""
    name = run.report["segmenters"][0]["segmenter"]
    maps = run.arrays(f"maps_{name}")
    count = len(maps["image"])
    figure = style.sheet(style.TWO_COLUMNS, 4.3)
    axes = figure.subplots(3, count, squeeze=False)
    for k in range(count):
        sonar = tank_sonar(maps["tilt_deg"][k])
        center = center_of(maps["truth"][k], sonar)
        for ax, layer in zip(axes[:, k], ("image", "semantic", "truth"), strict=True):
            close_up(ax, maps[layer][k], sonar, center, SIZE_M)
            ax.set(xticks=[], yticks=[])
        kind = "target" if maps["is_target"][k] else "non-target"
        axes[0, k].set_title(f"{kind}\ntilt {maps['tilt_deg'][k]:.0f}°", loc="center", fontsize=8)
    for ax, title in zip(axes[:, 0], ("sonar image", name, "truth"), strict=True):
        ax.set_ylabel(title)
    for ax in axes[-1]:
        ax.set_xlabel(f"{SIZE_M[0]:g} m")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    return figure
