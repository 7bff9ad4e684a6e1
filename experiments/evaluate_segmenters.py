"""What is each segmenter worth? Maps, correlations, accuracy and yaw on simulated frames (§4.3, 4.4 in depth).

python -m experiments.evaluate_segmenters [--preset smoke] [--help]

One table a set of frames, with the definition of every column. Objects and frames were never trained on; thresholds are
fixed beforehand on validation frames (experiments/fit_threshold.py), the test-optimal one stands beside for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import sonarjax as sj
from experiments.common.frames import TILTS_DEG, TestFrame
from experiments.common.launch import Report, launch
from experiments.common.maps import map_metrics
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.scores import Found, recognize_all, summary_of
from experiments.common.segmenters import Name, available
from experiments.common.sets import SETS, SetName, frames_of

REFINED = "offset yaw"
COLUMNS = {
    "segmenter": ("segmenter", "truth is the true map, what no segmenter can pass"),
    "accuracy": ("accuracy", "target frames identified with the right yaw bin and others refused, threshold fixed"),
    "best_accuracy": ("best", "the same at the threshold that is best on this very set, as in the paper's 0.9201"),
    "bin_right": ("bin", "target frames whose best template, turned to where it was found, is within 5.5° of the yaw"),
    "identification": ("identification", "frames of both objects on the right side of the threshold"),
    "score_own": ("NCC own", "mean correlation (eq. 4) of target frames with the template of their own yaw bin"),
    "score_other": ("NCC other", "mean correlation of the other object's frames with the best of the templates"),
    "score_other_largest": ("largest", "the largest of those"),
    "iou": ("IoU", "of the 128 × 128 crop's labels, all frames together, mean of highlight and shadow"),
    "psnr": ("PSNR", "of the map on that crop against the true map [dB], mean over frames"),
    "psnr_gain": ("gain", "that, less the PSNR of the raw crop [dB]"),
    "psnr_gain_wide": ("gain, wide", "the gain on crops of twice the margin around the object [dB]"),
}
YAW_COLUMNS = {
    "yaw_median": ("yaw median", "refined yaw error [°]: on the map first, then on the frame"),
    "yaw_p95": ("yaw 95 %", "its 95th percentile [°]"),
}


@dataclass(frozen=True)
class Settings:
    """What is evaluated."""

    segmenters: tuple[Name, ...] = available()
    """Segmenters to compare; truth is the true map, pix2pix-tiles the network without its closer looks."""
    sets: tuple[SetName, ...] = tuple(SETS)  # type: ignore[assignment]
    """Sets of frames."""
    step_deg: int = 10
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""


def row(found: Found, frames: list[TestFrame]) -> dict[str, float]:
    """The metrics of one segmenter on one set."""
    own = [_own_score(result, frame) for result, frame in zip(found.results, frames, strict=True) if frame.is_target]
    maps = map_metrics([result.semantic for result in found.results], frames)
    return summary_of(found) | maps | {"score_own": float(np.mean(own))}


def _own_score(result: sj.Recognition, frame: TestFrame) -> float:
    scores = result.scores_by_yaw
    return float(scores[round(frame.yaw * len(scores) / (2 * np.pi)) % len(scores)])


def run(settings: Settings, job: Job) -> Report:
    """Rows by set of frames."""
    sets: dict[str, list[dict[str, Any]]] = {}
    for title in settings.sets:
        frames = frames_of(title, job.seed, settings.step_deg, settings.tilts_deg)

        def measure(name: str, frames: list[TestFrame] = frames, title: str = title) -> dict[str, float]:
            return row(recognize_all(frames, name, refine=title == REFINED), frames)

        rows = job.map(measure, settings.segmenters, title)
        sets[title] = [{"segmenter": name} | values for name, values in rows.items()]
    return {"sets": sets}


SUMMARY = {
    "segmenter": ("severity 1", "segmenter", "segmenter"),
    "accuracy": ("severity 1", "accuracy", "accuracy"),
    "hard": ("severity 1.5", "accuracy", "at severity 1.5"),
    "devices": ("other devices", "accuracy", "other devices"),
    "mirror": ("mirror image", "identification", "mirror image told apart"),
    "own": ("severity 1", "score_own", "NCC own"),
    "other": ("severity 1", "score_other", "NCC other"),
    "iou": ("severity 1", "iou", "IoU"),
    "gain": ("severity 1", "psnr_gain", "PSNR gain"),
    "median": (REFINED, "yaw_median", "yaw median [°]"),
    "p95": (REFINED, "yaw_p95", "yaw 95 % [°]"),
}
"""Columns of the summary: from which set, which number, under which head."""


def summary(report: Report) -> str:
    """One row a segmenter, from all sets, for README; a set that was left out is a dash."""
    names = [row["segmenter"] for row in next(iter(report["sets"].values()))]
    found = {(title, row["segmenter"]): row for title, rows in report["sets"].items() for row in rows}
    rows = [{key: found.get((title, name), {}).get(of) for key, (title, of, _) in SUMMARY.items()} for name in names]
    return columns(rows, {key: head for key, (_, _, head) in SUMMARY.items()})


def table(report: Report) -> str:
    """The summary, all rows as a table for each set, and what the columns mean."""
    heads = {title: COLUMNS | (YAW_COLUMNS if title == REFINED else {}) for title in report["sets"]}
    tables = [
        f"{title}\n{columns(rows, {key: head for key, (head, _) in heads[title].items()})}\n"
        for title, rows in report["sets"].items()
    ]
    return "\n".join(
        [f"{summary(report)}\n", *tables, *(f"{head}: {what}" for head, what in (COLUMNS | YAW_COLUMNS).values())]
    )


if __name__ == "__main__":
    smoke = {"step_deg": 90, "sets": ("severity 1",), "segmenters": ("pix2pix", "otsu"), "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=smoke)
