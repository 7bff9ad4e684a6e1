"""What carries the match: highlight, shadow or both?

python -m experiments.ablate_template [--preset smoke] [--help]

Frames of §4.1 matched (eq. 4) with templates of highlight alone, shadow alone and both: on the true maps, on those of a
segmenter, whose other half is taken away as the templates' is, and on the raw frames, of which nothing can be taken
away. The banks are rendered at the frame's known distance, the threshold is the best one on these very frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TestFrame, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import WITHIN_BIN_DEG, best_accuracy, columns, yaw_error_deg
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.common.segmenters import map_of
from sonarjax.match import prepare_bank

Part = Literal["both", "highlight", "shadow"]
BACKGROUND = 0.5
YAWS = np.arange(36) * (2 * np.pi / 36)
HEADS = {
    "map": "matched on",
    "part": "template",
    "best_accuracy": "accuracy at the test-optimal threshold",
    "bin_right": "yaw bin right",
    "score_own": "NCC own",
    "score_wrong": "other yaws",
    "score_other": "other object",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    maps: tuple[str, ...] = ("truth", "pix2pix", "none")
    """What is matched: truth is the true map, none the raw frame, else a segmenter's map."""
    parts: tuple[Part, ...] = ("both", "highlight", "shadow")
    """What the templates show."""
    step_deg: int = 10
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    yaw_offset_deg: float = 5.0
    """Uniform offset of each yaw within ± this [deg]."""


def run(settings: Settings, job: Job) -> Report:
    """One row for each kind of map and of template."""
    frames = paper_frames(job.seed, step_deg=settings.step_deg, yaw_offset_deg=settings.yaw_offset_deg)
    measured = job.map(partial(_measure, frames, settings.parts), settings.maps, "templates")
    rows = [{"map": name, "part": part} | values for name, parts in measured.items() for part, values in parts.items()]
    return {"rows": rows}


def _measure(frames: Sequence[TestFrame], parts: Sequence[Part], name: str) -> dict[str, dict[str, float]]:
    banks = {
        tilt: sj.template_bank(target(), sonar_for(tilt), YAWS, x=away, engine=engine())
        for tilt, away in GROUND_RANGE_M.items()
    }
    maps = [map_of(name, frame) for frame in frames]
    found = {}
    for part in parts:
        matched = maps if name == "none" else [only(part, image) for image in maps]
        cut = {tilt: replace(bank, templates=only(part, bank.templates)) for tilt, bank in banks.items()}
        found[part] = judged_at_place(scores_at_place(matched, frames, cut), frames)
    return found


def only(part: Part, grey: Any) -> Any:
    """A semantic grey image of any shape with one class put to background; of "both" as it is."""
    if part == "both":
        return grey
    return grey.clip(BACKGROUND, None) if part == "highlight" else grey.clip(None, BACKGROUND)


def scores_at_place(
    maps: Sequence[np.ndarray], frames: Sequence[TestFrame], banks: Mapping[float, sj.TemplateBank]
) -> np.ndarray:
    """Scores (frame, yaw) of eq. 4 of each map with the bank of its frame's tilt [deg].

    The template may lie anywhere in the frame.
    """
    prepared = {tilt: prepare_bank(bank, maps[0].shape) for tilt, bank in banks.items()}
    found = [sj.match_bank(image, prepared[frame.tilt_deg]) for image, frame in zip(maps, frames, strict=True)]
    return np.array(found)


def judged_at_place(scores: np.ndarray, frames: Sequence[TestFrame]) -> dict[str, float]:
    """Accuracy and correlations of scores (frame, yaw) whose yaws are spread evenly over the circle, from 0.

    `score_own` is the template's of the nearest bin, `score_wrong` the best of those 30° or more from it (as in Table
    4), `score_other` the best for frames of the other object.
    """
    own = np.array([frame.is_target for frame in frames])
    true, count = np.array([frame.yaw for frame in frames]), scores.shape[1]
    yaws = np.arange(count) * (2 * np.pi / count)
    right = yaw_error_deg(yaws[scores.argmax(axis=1)], true) <= WITHIN_BIN_DEG
    best, threshold = best_accuracy(scores.max(axis=1), right, own)
    off = yaw_error_deg(yaws, true[:, None])  # (frame, yaw)
    nearest = np.take_along_axis(scores, off.argmin(axis=1)[:, None], axis=1)[:, 0]
    return {
        "best_accuracy": best,
        "best_threshold": threshold,
        "bin_right": float(right[own].mean()),
        "score_own": float(nearest[own].mean()),
        "score_wrong": float(np.where(off > 25.0, scores, -1.0).max(axis=1)[own].mean()),
        "score_other": float(scores[~own].max(axis=1).mean()),
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"maps": ("truth",), "parts": ("highlight",), "step_deg": 180})
