"""What recognition depends on: the figures of `experiments.ablate`, all drawn alike from the table `SCRIPTS`.

A panel has a line over a varied number, or a row for each varied name; each map has its colour. The first measure of a
panel is solid and filled, the second dashed and hollow, the third dotted and a cross.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.ablate import EVERYTHING, NOTHING, SWEEPS
from experiments.common import paper
from experiments.common.runs import Run
from paper_figs import style
from paper_figs.shared import Line, in_order, row_where

LINES = ("-", "--", ":")
WAY = "curve"
"""In place of a measure: the IoU on the way of each training."""
TRUE_GAIN = ("truth", "psnr_gain")
"""No gain at all but the most that PSNR counts: it would dwarf the others."""
SHARES = {"share of frames": ("best_accuracy", "bin_right")}
CORRELATIONS = {"correlation": ("score_own", "score_wrong", "score_other")}


def told(what: str, vary: str, value: Any, key: str, of: str = "pix2pix") -> Line:
    """A number for the index: measure `key` of the map `of` at one of the values of a sweep."""
    return what, None, lambda report: row_where(report["rows"], value=value, map=of)[key], f"ablate --vary {vary}"


@dataclass(frozen=True)
class Ablation:
    """One figure: a row of panels for each sweep. It has what each script has."""

    ITEM: str
    CAPTION: str
    sweeps: tuple[str, ...]
    """What was varied: names of `SWEEPS`."""
    panels: Mapping[str, Sequence[str]]
    """Measures by the panel's title."""
    NUMBERS: Sequence[Line]
    log: Sequence[str] = ()
    """Panels whose upward axis is logarithmic."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """The paper's value by panel."""

    @property
    def EXPERIMENTS(self) -> tuple[str, ...]:
        """What makes the runs."""
        return tuple(f"ablate --vary {vary}" for vary in self.sweeps)

    def draw(self, *runs: Run) -> Figure:
        """The panels, (a) to the last."""
        tables = [run.report["rows"] for run in runs]
        names = 0 if _numeric(tables[0]) else len(in_order(tables[0], "value"))
        figure = style.sheet(style.TWO_COLUMNS, max(2.6, 1.1 + 0.2 * names) + 1.8 * (len(tables) - 1))
        axes = figure.subplots(len(tables), len(self.panels), squeeze=False)
        for line, vary, run, rows in zip(axes, self.sweeps, runs, tables, strict=True):
            for ax, (title, keys) in zip(line, self.panels.items(), strict=True):
                if WAY in keys:
                    _way(ax, rows, run.report["settings"].get("width"))
                elif _numeric(rows):
                    _over_numbers(ax, rows, keys, title in self.log)
                    ax.set_xlabel(SWEEPS[vary].varied)
                else:
                    _by_name(ax, rows, keys, first=ax is line[0])
                if title in self.paper:
                    ax.axvline(self.paper[title], color=style.PAPER, linestyle="--", linewidth=1)
                ax.set_title(title)
                ax.grid(True)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        style.letters(axes.flat)
        return figure


def _numeric(rows: Sequence[dict[str, Any]]) -> bool:
    return isinstance(rows[0]["value"], float)


def _over_numbers(ax: Axes, rows: Sequence[dict[str, Any]], keys: Sequence[str], log: bool) -> None:
    """A line for each map and measure; what always finding the nearest bin would leave is the same for all maps."""
    for name in in_order(rows, "map"):
        own, look = sorted((row for row in rows if row["map"] == name), key=lambda row: row["value"]), style.look(name)
        at = [row["value"] for row in own]
        for number, key in enumerate(keys):
            drawn = [row[key] for row in own]
            if key.startswith("floor"):
                ax.plot(at, drawn, color="0.75", linewidth=4, zorder=0)
            else:
                face = {"markerfacecolor": "white"} if number else {"label": name}
                ax.plot(at, drawn, **look, linestyle=LINES[number], markersize=3.5, **face)
    if log:
        ax.set_yscale("log")
        style.plain_log(ax.yaxis)


def _by_name(ax: Axes, rows: Sequence[dict[str, Any]], keys: Sequence[str], first: bool) -> None:
    """A row for each value, the first of which is the usual: a line goes through it, unless there would be many."""
    names, maps = in_order(rows, "value"), in_order(rows, "map")
    for of in maps:
        own, look = [row for row in rows if row["map"] == of], style.look(of)
        for number, key in enumerate(keys):
            how = (look | {"label": of}, look | {"markerfacecolor": "white"}, look | {"marker": "x"})[number]
            known = [None if (of, key) == TRUE_GAIN else row[key] for row in own]
            ax.plot(known, [-names.index(row["value"]) for row in own], linestyle="none", **how)
            if number == 0 and len(maps) <= 3:
                ax.axvline(known[0], color=look["color"], linewidth=0.8)
    ax.set_yticks([-k for k in range(len(names))], names if first else [""] * len(names))


def _way(ax: Axes, rows: Sequence[dict[str, Any]], width: int | None) -> None:
    """The IoU of each training, of networks of this width, over the images that it has seen."""
    for number, row in enumerate(rows):
        color, line = style.PALETTE[number % len(style.PALETTE)], LINES[number // len(style.PALETTE) % len(LINES)]
        ax.plot(row[WAY]["images"], row[WAY]["iou_mean"], color=color, linestyle=line, label=row["value"], linewidth=1)
    ax.set_xlabel("images seen" if width is None else f"images seen, width {width}")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.4)


SCRIPTS = {
    "ext05_frames": Ablation(
        "Ext. 5",
        "Segmenters side by side: accuracy at the fixed threshold, yaw bins right, IoU and gain in PSNR, on the frames "
        "of §4.1 and on four harder or other sets. `truth` matches the true maps; the paper's values are dashed.",
        ("frames",),
        {"accuracy": ("accuracy",), "yaw bin right": ("bin_right",), "IoU": ("iou",), "PSNR gain [dB]": ("psnr_gain",)},
        [told(f"pix2pix, {title}: {what}", "frames", title, key)
         for title in ("severity 1", "severity 1.5", "mirror image", "offset yaw", "other devices")
         for key, what in (("accuracy", "accuracy"), ("iou", "IoU"))],
        paper={"accuracy": paper.ACCURACY, "IoU": paper.IOU, "PSNR gain [dB]": paper.PSNR_GAIN},
    ),
    "ext06_severity": Ablation(
        "Ext. 6",
        "Severity of the sensor model (1: calibrated to the paper's frames): (a) accuracy at the threshold that was "
        "fixed at severity 1 (solid) and at the best one on the same frames (dashed), (b) mean score of target (solid) "
        "and non-target (dashed).",
        ("severity",),
        {"accuracy": ("accuracy", "best_accuracy"), "score": ("score_target", "score_other")},
        [told(f"pix2pix, severity {value:g}: accuracy", "severity", value, "accuracy") for value in (0.0, 1.0, 2.0)],
    ),
    "ext07_yaw_bin": Ablation(
        "Ext. 7",
        "Width of a yaw bin (the paper's: 10°): (a) median yaw error refined (solid), of the best bin (dashed), and "
        "what always finding the nearest bin would leave (grey); (b) share of frames more than 20° off; (c) time a "
        "frame.",
        ("yaw_bin",),
        {"median error [°]": ("yaw_median", "bin_median", "floor_median"), "over 20° off": ("yaw_astray", "bin_astray"),
         "time a frame [ms]": ("yaw_ms", "bin_ms")},
        [told(f"pix2pix, bins of {width:g}°: {what} [°]", "yaw_bin", width, key) for width in (2.0, 10.0, 30.0)
         for key, what in (("bin_median", "bin error"), ("yaw_median", "refined"))],
        log=("median error [°]",),
    ),
    "ext08_template": Ablation(
        "Ext. 8",
        "Templates of highlight, shadow and both, on the true maps, the network's and the raw frames: (a) accuracy at "
        "the best threshold (filled) and yaw bins right (hollow), (b) mean correlation with the right template "
        "(filled), the best one of other yaws (hollow) and with the other object (×). Lines: both.",
        ("template",),
        SHARES | CORRELATIONS,
        [told(f"pix2pix, template of {part}: accuracy, best threshold", "template", part, "best_accuracy")
         for part in SWEEPS["template"].values],
    ),
    "ext09_geometry": Ablation(
        "Ext. 9",
        "Banks rendered for a wrong tilt (above) or a wrong ground range (below): (left) accuracy at the best "
        "threshold (solid) and yaw bins right (dashed); (right) mean correlation with the right template (solid), the "
        "best one of other yaws (dashed) and with the other object (dotted).",
        ("tilt", "distance"),
        SHARES | CORRELATIONS,
        [told(f"pix2pix, {what}: accuracy, best threshold", vary, off, "best_accuracy") for what, vary, off in (
            ("right geometry", "tilt", 0.0), ("tilt 5° too steep", "tilt", 5.0), ("0.3 m too far", "distance", 0.3))],
    ),
    "ext10_sensor": Ablation(
        "Ext. 10",
        "Parts of the sensor model switched off one at a time, and all of them: correlation of target frames with "
        "their own template, PSNR and IoU of the maps, and accuracy at the best threshold. Lines: the whole sensor.",
        ("sensor",),
        {"NCC own": ("score_own",), "PSNR [dB]": ("psnr",), "IoU": ("iou",), "accuracy": ("best_accuracy",)},
        [told(f"NCC own of raw frames, {part} switched off", "sensor", part, "score_own", of="none")
         for part in (NOTHING, "speckle", EVERYTHING)],
    ),
    "ext11_training": Ablation(
        "Ext. 11",
        "Trainings that differ in one thing from the first (eq. 3 as the paper has it), of the width and length that "
        "the last panel says: IoU (filled), that of highlight (hollow) and of shadow (×) and PSNR gain on the same "
        "validation pairs at the end, and the IoU on the way. Lines: the first.",
        ("training",),
        {"IoU": ("iou_mean", "iou_highlight", "iou_shadow"), "PSNR gain [dB]": ("psnr_gain_db",),
         "IoU on the way": (WAY,)},
        [told(f"{name}: IoU", "training", name, "iou_mean")
         for name in ("eq. 3", "no discriminator", "no skips", "shipped loss")],
    ),
}  # fmt: skip
"""The figures by name."""
