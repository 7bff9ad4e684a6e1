"""Which least score identifies a target (eq. 5)? The threshold that errs least on validation frames.

python -m experiments.fit_threshold [--preset smoke] [--help]

Validation frames have another seed than the test's, which play no part. The thresholds found stand in
`sonarjax.segment.classical`, in the network's weights file and in `experiments.common.segmenters`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import TILTS_DEG, VALIDATION_SEED, TestFrame, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.segmenters import Name, available, map_of

HEADS = {
    "segmenter": "segmenter",
    "threshold": "threshold",
    "target": "mean score of targets",
    "least_target": "least",
    "other": "mean score of the other object",
    "largest_other": "largest",
}


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    step_deg: int = 20
    """Yaw step of the validation frames [deg]."""
    segmenters: tuple[Name, ...] = available()
    """Segmenters, each with a threshold of its own."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""


def best_threshold(target: np.ndarray, other: np.ndarray) -> float:
    """The middle of the widest run of thresholds with the fewest errors, from scores of both kinds."""
    edges = np.unique(np.concatenate([target, other]))
    cuts = (edges[1:] + edges[:-1]) / 2
    errors = np.array([(target < cut).sum() + (other >= cut).sum() for cut in cuts])
    least = np.flatnonzero(errors == errors.min())
    runs = np.split(least, np.flatnonzero(np.diff(least) > 1) + 1)
    widest = max(runs, key=lambda run: edges[run[-1] + 1] - edges[run[0]])
    return float((edges[widest[0]] + edges[widest[-1] + 1]) / 2)


def run(settings: Settings, job: Job) -> Report:
    """One row for each segmenter."""
    seed, step, tilts = VALIDATION_SEED + job.seed, settings.step_deg, settings.tilts_deg
    frames = paper_frames(seed, yaw_offset_deg=5.0, step_deg=step, tilts_deg=tilts)
    found = job.map(partial(_measure, frames), settings.segmenters, "segmenters")
    return {"rows": [{"segmenter": name} | values for name, values in found.items()]}


def _measure(frames: list[TestFrame], name: str) -> dict[str, Any]:
    recognizer_of = recognizers(sj.objects.target(), refine=None)
    scores: dict[bool, list[float]] = {True: [], False: []}
    for frame in tqdm(frames, desc=name, unit="frame", leave=False):
        result = recognizer_of(frame.tilt_deg)(map_of(name, frame), threshold=0.0)
        scores[frame.is_target].append(result.score)
    target, other = np.array(scores[True]), np.array(scores[False])
    return {
        "threshold": best_threshold(target, other),
        "target": float(target.mean()),
        "least_target": float(target.min()),
        "other": float(other.mean()),
        "largest_other": float(other.max()),
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"step_deg": 360, "segmenters": ("otsu",), "tilts_deg": (20.0,)})
