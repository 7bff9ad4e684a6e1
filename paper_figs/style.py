"""How every figure looks: sizes, fonts, colours, and how it is saved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cycler import cycler
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from sonarjax.io.outputs import make_folder
from sonarjax.plot import save_figure

ONE_COLUMN, TWO_COLUMNS = 3.5, 7.2
"""Widths of a figure in print [inch]."""
DPI = 180
SMOKE = "smoke preset"

# Okabe and Ito's palette: the colour-blind can tell its colours apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
PAPER, GREY, LIGHT = VERMILION, "0.45", "0.85"
"""What the paper reports, what only helps to read, and what lies behind."""
PALETTE = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
NAMED = {
    "truth": (BLACK, "X"), "labels": (BLACK, "X"), "pix2pix": (BLUE, "o"), "pix2pix-tiles": (SKY, "v"),
    "discriminative": (PURPLE, "D"), "paper-cpu": (SKY, "*"), "paper": (SKY, "P"), "none": (ORANGE, "s"),
    "otsu": (GREEN, "^"), "otsu1": (YELLOW, "<"), "otsu3": (GREY, ">"), "median-otsu": (VERMILION, "P"),
}  # fmt: skip
"""Colour and marker of each segmenter or kind of map: the same in every figure."""
SEQUENTIAL = "cividis"

RC: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 8, "axes.titlesize": 9, "axes.labelsize": 8, "xtick.labelsize": 8,
    "ytick.labelsize": 8, "legend.fontsize": 8, "figure.titlesize": 9, "axes.titlelocation": "left",
    "axes.linewidth": 0.7, "xtick.major.width": 0.7, "ytick.major.width": 0.7, "lines.linewidth": 1.3,
    "lines.markersize": 4, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "legend.handlelength": 1.6, "grid.color": "0.9", "grid.linewidth": 0.6, "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=PALETTE), "pdf.fonttype": 42, "svg.fonttype": "path",
}  # fmt: skip
"""matplotlib's settings, for drawing and for saving."""


def sheet(width: float, height: float) -> Figure:
    """An empty figure of a width and height in print [inch]."""
    return Figure(figsize=(width, height), layout="constrained")


def look(name: str) -> dict[str, Any]:
    """Colour and marker of a segmenter or kind of map, as keywords of `plot`."""
    color, marker = NAMED.get(name, (PURPLE, "D"))
    return {"color": color, "marker": marker}


def name_columns(ax: Axes, place: Sequence[float] | np.ndarray, names: Sequence[str]) -> None:
    """Name the columns at `place` under the axis, slanted so that long names do not run into each other."""
    ax.set_xticks(place, names, rotation=25, ha="right", rotation_mode="anchor")


def letters(axes: Any) -> None:
    """Put (a), (b), … before the titles of panels."""
    for letter, ax in zip("abcdefghijklmnopqrstuvwxyz", axes, strict=False):
        ax.set_title(f"({letter}) {ax.get_title(loc='left')}".rstrip())


def plain_log(axis: Axis) -> None:
    """A logarithmic axis with ticks at 1, 2, 5, … written as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def bare(ax: Axes) -> None:
    """No ticks and no frame."""
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def mark_smoke(figure: Figure) -> None:
    """Say in small grey letters at the foot of a figure that its run was a short one."""
    engine = figure.get_layout_engine()
    strip = 0.16 / figure.get_figheight()
    if engine is not None:
        engine.set(rect=(0, strip, 1, 1 - strip))  # type: ignore[call-arg]
    figure.text(0.995, 0.02 / figure.get_figheight(), SMOKE, color="0.6", ha="right", va="bottom", gid="smoke")


def save(figure: Figure, path: Path, dpi: float = DPI) -> None:
    """Write a figure at its size in print."""
    make_folder(str(path.parent))
    save_figure(figure, path, dpi)


def write_drawings(drawings: Mapping[str, Callable[[], Figure]]) -> None:
    """Write drawings of the docs to `paper_figs/drawn`, by the names of their files without the ending."""
    with rc_context(RC):
        for name, draw in drawings.items():
            save_figure(draw(), str(Path(__file__).resolve().parent / "drawn" / f"{name}.png"))
            print(f"{name}.png")
