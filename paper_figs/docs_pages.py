"""The drawings of docs/files.md, docs/cluster.md and docs/export.md; nothing is computed for them.

`python -m paper_figs.docs_pages` writes docs_files.png, docs_cluster.png and docs_export.png into paper_figs/drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle, Wedge

from paper_figs import style

OPENING_DEG, BEAM_DEG, NEAR, FAR = 58.0, 18.0, 1.0, 3.0
"""The fan of the first drawing: its opening, the beam that is drawn (to port), and its window [m]."""
Point = tuple[float, float]


def files() -> Figure:
    """The axes of a ROS message beside ours, and the ranges that it holds beside the window's edges."""
    figure = style.sheet(style.TWO_COLUMNS, 2.9)
    message, ours, bins = figure.subplots(1, 3, width_ratios=(1, 1, 0.8))
    _fan(message, "Z: middle of the fan", "Y: starboard", 1.0, "azimuth = atan2(−y, z)")
    _fan(ours, "x: forward", "y: port", -1.0, "azimuth, growing to port")
    message.set_title("ROS message, X up")
    ours.set_title("sonarjax, z up")
    _bins(bins)
    style.letters([message, ours, bins])
    return figure


def _fan(ax: Axes, forward: str, aside: str, side: float, angle: str) -> None:
    """A fan from above, ahead up and port on the left; the second axis points to `side`, 1 for the right."""
    style.bare(ax)
    half = OPENING_DEG / 2
    ax.add_patch(Wedge((0, 0), FAR, 90 - half, 90 + half, width=FAR - NEAR, facecolor=style.LIGHT))
    _arrow(ax, (0, 0), (0, 3.6), style.BLUE)
    _arrow(ax, (0, 0), (1.5 * side, 0), style.BLUE)
    ax.annotate(forward, (0.1, 3.45), color=style.BLUE)
    ax.annotate(aside, (1.6 * side, 0.12), color=style.BLUE, ha="right" if side > 0 else "left")
    beam = math.radians(90 + BEAM_DEG)
    ax.plot([0, FAR * math.cos(beam)], [0, FAR * math.sin(beam)], color=style.ORANGE, linewidth=2)
    ax.add_patch(Wedge((0, 0), 1.9, 90, 90 + BEAM_DEG, width=0.02, facecolor=style.ORANGE))
    ax.annotate(angle, (0, -0.45), color=style.ORANGE, ha="center")
    ax.set(xlim=(-1.8, 1.8), ylim=(-0.6, 3.8), aspect="equal")


def _bins(ax: Axes) -> None:
    """Four range bins with their centres, and the window around them."""
    style.bare(ax)
    edges = np.arange(5.0)
    for edge in edges:
        ax.plot([0, 1], [edge, edge], color=style.GREY)
    for number, centre in enumerate((edges[1:] + edges[:-1]) / 2):
        ax.plot(0.5, centre, "o", color=style.ORANGE)
        ax.annotate(f"ranges[{number}]", (0.6, centre), va="center", color=style.ORANGE)
    for edge, name in ((edges[0], "range_min"), (edges[-1], "range_max")):
        ax.annotate(name, (1.08, edge), va="center", color=style.BLUE)
    ax.set(title="range bins", xlim=(-0.1, 1.9), ylim=(-0.4, 4.4))


def cluster() -> Figure:
    """Where work goes and how results come back; one worker is killed."""
    figure = style.sheet(style.TWO_COLUMNS, 2.5)
    ax = figure.subplots()
    style.bare(ax)
    _box(ax, (1.0, 1.5), "sonarjax … --cluster\n\nhands out items,\nwrites results\nin their order", style.BLUE)
    _box(ax, (4.0, 1.5), "scheduler\nof Dask", style.GREY)
    workers = ("worker\nat item 7", "worker, killed\nat item 8", "worker\nat item 8, again")
    for height, (text, color) in zip(
        (2.6, 1.5, 0.4), zip(workers, (style.GREEN, style.VERMILION, style.GREEN), strict=True), strict=True
    ):  # fmt: skip
        _box(ax, (7.0, height), text, color, height=0.8)
        dashed = color == style.VERMILION
        _arrow(ax, (4.9, 1.5), (6.1, height), style.VERMILION if dashed else style.BLACK, "--" if dashed else "-")
    _arrow(ax, (1.9, 1.7), (3.1, 1.7))
    _arrow(ax, (3.1, 1.3), (1.9, 1.3))
    ax.annotate("items", (2.5, 1.78), ha="center")
    ax.annotate("results", (2.5, 1.02), ha="center")
    _box(ax, (9.5, 1.5), "compiled programs,\none cache\non each machine", style.GREY)
    for height in (2.6, 0.4):
        _arrow(ax, (8.6, 1.5 + (height - 1.5) / 2), (7.9, height))
    ax.set(xlim=(0, 10.5), ylim=(-0.1, 3.1))
    return figure


def export() -> Figure:
    """A frame in tiles that overlap by half, one of them through the network, and the answers joined."""
    figure = style.sheet(style.TWO_COLUMNS, 1.7)
    frame, crop, network, weight, whole = figure.subplots(1, 5)
    for ax, title in zip(
        (frame, crop, network, weight, whole),
        ("frame in tiles", "one, 128 × 128", "ONNX file", "weight", "joined"), strict=True,
    ):  # fmt: skip
        style.bare(ax)
        ax.set(title=title, xlim=(-0.1, 1.1), ylim=(-0.1, 1.1), aspect="equal")
    for ax in (frame, whole):
        ax.add_patch(Rectangle((0.2, 0), 0.6, 1, facecolor="none", edgecolor=style.BLACK))
    for number, low in enumerate((0.0, 0.25, 0.5)):
        color = style.ORANGE if number == 1 else style.GREY
        frame.add_patch(
            Rectangle((0.2, low), 0.6, 0.5, facecolor="none", edgecolor=color, linestyle="--", linewidth=1.5)
        )
    _object(frame, 0.45, 0.4, 0.5)
    _object(crop, 0.4, 0.35, 1.0)
    crop.add_patch(Rectangle((0, 0), 1, 1, facecolor="none", edgecolor=style.ORANGE, linestyle="--", linewidth=1.5))
    network.annotate("image\n↓\nsegmenter.onnx\n↓\nsemantic", (0.5, 0.5), ha="center", va="center")
    ramp = 1 - np.abs(np.linspace(-1, 1, 64))
    weight.imshow(np.outer(ramp, ramp), extent=(0, 1, 0, 1), cmap="Greys", vmax=1.3)
    whole.add_patch(Rectangle((0.2, 0), 0.6, 1, facecolor="0.7"))
    _object(whole, 0.45, 0.4, 0.5, sharp=True)
    return figure


def _object(ax: Axes, left: float, low: float, scale: float, sharp: bool = False) -> None:
    """A highlight with its shadow behind it; `sharp` as a semantic map has them."""
    light, dark = ("1.0", "0.0") if sharp else (style.LIGHT, style.GREY)
    ax.add_patch(Rectangle((left, low), 0.25 * scale, 0.12 * scale, facecolor=light, edgecolor=style.BLACK))
    ax.add_patch(Rectangle((left, low + 0.12 * scale), 0.25 * scale, 0.35 * scale, facecolor=dark))


def _box(ax: Axes, middle: Point, text: str, color: str, width: float = 1.7, height: float = 1.6) -> None:
    corner = middle[0] - width / 2, middle[1] - height / 2
    ax.add_patch(
        FancyBboxPatch(corner, width, height, boxstyle="round,pad=0.05", facecolor="white", edgecolor=color)
    )  # fmt: skip
    ax.annotate(text, middle, ha="center", va="center")


def _arrow(ax: Axes, start: Point, end: Point, color: str = style.BLACK, line: str = "-") -> None:
    ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": color, "linestyle": line})


DRAWINGS: dict[str, Callable[[], Figure]] = {"docs_files": files, "docs_cluster": cluster, "docs_export": export}
"""The drawings by the names of their files."""


def main() -> None:
    """Write all of them."""
    style.write_drawings(DRAWINGS)


if __name__ == "__main__":
    main()
