"""How wide may the bins of yaw be?

python -m experiments.ablate_yaw_bin [--preset smoke] [--help]

Target frames of §4.1 with yaws spread evenly over the circle, so that no bin's middle is favoured. A bank that always
picks the nearest of its bins would still err uniformly within half a bin: its statistics stand beside what was reached.
Refinement may go 10° from the best bin, or a bin's width where bins are wider.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

import sonarjax as sj
from experiments.common.frames import TILTS_DEG, TestFrame, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.metrics import WITHIN_BIN_DEG, columns, summary_deg, yaw_error_deg
from experiments.common.recognizers import recognizers, unrefined
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.common.segmenters import Name, map_of, threshold_of

ASTRAY_DEG = 20.0  # farther off than any bin's half: another aspect of the object was taken for this one
HEADS = {
    "segmenter": "segmenter",
    "bin_deg": "bin [°]",
    "bin_right": "nearest bin found",
    "bin_astray": "over 20° off",
    "bin_median": "bin error, median [°]",
    "bin_mean": "mean",
    "bin_rms": "RMS",
    "bin_p95": "95 %",
    "floor_mean": "floor: median, mean",
    "floor_rms": "RMS",
    "floor_p95": "95 %",
    "yaw_astray": "refined, over 20° off",
    "yaw_median": "refined error, median [°]",
    "yaw_mean": "mean",
    "yaw_rms": "RMS",
    "yaw_p95": "95 %",
    "bin_ms": "time a frame [ms]",
    "yaw_ms": "with refinement",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    bins_deg: tuple[int, ...] = (2, 5, 10, 15, 30)
    """Widths of a yaw bin [deg], divisors of 360; the paper's is 10."""
    segmenters: tuple[Name, ...] = ("truth", "pix2pix", "none")
    """Segmenters to compare; truth is the true map, drawn by the renderer that refines: it shows the bins alone."""
    step_deg: int = 20
    """Yaw step of each set [deg]; each frame's yaw is drawn anywhere in its step."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""

    def __post_init__(self) -> None:
        """Raises ValueError for bins that do not close the circle."""
        if any(width < 1 or 360 % width for width in self.bins_deg):
            raise ValueError(f"--bins-deg: expected divisors of 360, got {self.bins_deg}")


class Yaw(NamedTuple):
    """A yaw that was found, and how long that took."""

    yaw: float
    """Yaw [rad]."""
    milliseconds: float
    """Time of segmentation and recognition [ms]."""


def run(settings: Settings, job: Job) -> Report:
    """One row for each segmenter and bin width."""
    step, tilts = settings.step_deg, settings.tilts_deg
    every = paper_frames(job.seed, step_deg=step, yaw_offset_deg=step / 2, tilts_deg=tilts)
    frames = [frame for frame in every if frame.is_target]
    cases = {f"{name}, {width}°": (name, width) for name in settings.segmenters for width in settings.bins_deg}
    measured = job.map(partial(_measure, frames), cases, "yaw bins")
    labels = ({"segmenter": name, "bin_deg": width} for name, width in cases.values())
    return {"rows": [label | values for label, values in zip(labels, measured.values(), strict=True)]}


def _measure(frames: Sequence[TestFrame], case: tuple[str, int]) -> dict[str, float]:
    segmenter, width = case
    true = [frame.yaw for frame in frames]
    recognizer_of = recognizers(target(), search=sj.SearchConfig(yaw_bins=360 // width))
    values = {f"floor_{name}": value for name, value in floor_deg(width).items()}
    for stage, refine in (("bin", False), ("yaw", True)):
        found = [_find(recognizer_of, frame, segmenter, refine) for frame in frames]
        error = yaw_error_deg([one.yaw for one in found], true)
        values |= {f"{stage}_{name}": value for name, value in summary_deg(error).items()}
        values[f"{stage}_right"] = float((error <= WITHIN_BIN_DEG * width / 10).mean())
        values[f"{stage}_astray"] = float((error > ASTRAY_DEG).mean())
        # The median, since the first frames of a sonar render its banks, which are kept.
        values[f"{stage}_ms"] = float(np.median([one.milliseconds for one in found]))
    return values


def _find(recognizer_of: Callable[[float], sj.Recognizer], frame: TestFrame, segmenter: str, refine: bool) -> Yaw:
    recognizer, threshold = recognizer_of(frame.tilt_deg), threshold_of(segmenter)
    recognizer = recognizer if refine else unrefined(recognizer)
    started = time.perf_counter()
    found = recognizer(frame.image, semantic=map_of(segmenter, frame), threshold=threshold)
    return Yaw(found.yaw, 1e3 * (time.perf_counter() - started))


def floor_deg(width_deg: float) -> dict[str, float]:
    """Statistics [deg] of the error's size when the nearest bin of `width_deg` is always found: uniform in ± half."""
    return {
        "median": width_deg / 4,
        "mean": width_deg / 4,
        "rms": width_deg / math.sqrt(12),
        "p95": 0.95 * width_deg / 2,
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    small = {"bins_deg": (10,), "segmenters": ("none",), "step_deg": 180, "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=small)
