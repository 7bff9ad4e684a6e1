"""Which of the refined starts is the target's? How much the map should count beside the frame, on validation frames.

python -m experiments.fit_start_choice [--count N] [--preset smoke] [--help]

Every start that matching finds is refined, as in `recognize`. The best one has the highest mean of its NCCs with frame
and map, and the rows say how often its yaw is far off, by the weight of the map. In half of the frames the walls of a
drawn tank are in view: these can look more like the target than the target does. What is found stands in
`sonarjax.refine.staged`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers, refined_starts
from experiments.common.runs import Job
from experiments.common.validation import Case, scenes, validation_cases
from experiments.common.walled import walled_cases
from sonarjax.refine import MAP_SHARE

SHARES = (0.0, 0.1, 0.2, MAP_SHARE, 0.4, 0.5, 0.7, 1.0)
"""Weights of the map [1]."""
FAR_DEG = 5.0, 30.0
"""Errors of yaw that count as far off [deg]."""
SETS = {"open floor": validation_cases, "walls in view": walled_cases}
HEADS = {
    "frames": "frames", "count": "count", "share": "weight of the map", "far": f"beyond {FAR_DEG[0]:.0f}°",
    "astray": f"beyond {FAR_DEG[1]:.0f}°", "median": "yaw, median [°]", "used": "",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    count: int = 240
    """Frames of each set, half of which show the target."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each set of frames and weight of the map; `possible` is what the best of all starts reaches."""

    def measure(name: str) -> list[list[tuple[float, float, float]]]:
        # Another seed than that of the frames on which the decision is fitted.
        return _measured(SETS[name](job.seed + 1, settings.count), settings.segmenter)

    found = job.map(measure, tuple(SETS), "sets")
    rows = [_row(name, frames, share) for name, frames in found.items() for share in SHARES]
    nearest = {name: np.array([min(one[2] for one in frame) for frame in frames]) for name, frames in found.items()}
    possible = {name: float((errors > FAR_DEG[0]).mean()) for name, errors in nearest.items()}
    return {"rows": rows, "possible": possible, "per_frame": found}


def _measured(cases: list[Case], segmenter: str) -> list[list[tuple[float, float, float]]]:
    """For each frame of a target and each of its starts: NCC with the frame, NCC with the map, error of yaw [deg]."""
    loaded = sj.load_segmenter(segmenter)
    made = {name: recognizers(scene.target, segmenter=loaded) for name, scene in scenes().items()}
    targets = [case for case in cases if case.is_target]
    found = []
    for case in tqdm(targets, desc="refining starts", unit="frame", leave=False, disable=None):
        starts = refined_starts(made[case.sought](case.tilt_deg), case.image)
        errors = [float(yaw_error_deg(float(one.pose.yaw), case.yaw)) for one in starts]
        found.append([(one.score, float(one.evidence.map_fit), e) for one, e in zip(starts, errors, strict=True)])
    return found


def _row(name: str, frames: list[list[tuple[float, float, float]]], share: float) -> dict[str, Any]:
    chosen = [max(frame, key=lambda one: (1 - share) * one[0] + share * one[1]) for frame in frames]
    error = np.array([one[2] for one in chosen])
    far, astray = (float((error > most).mean()) for most in FAR_DEG)
    row = {"frames": name, "count": len(error), "share": share, "far": far, "astray": astray}
    return row | {"median": float(np.median(error)), "used": "used" if share == MAP_SHARE else ""}


def table(report: Report) -> str:
    """The rows, and what the best choice would reach."""
    best = ", ".join(f"{name} {share:.3f}" for name, share in report["possible"].items())
    return f"{columns(report['rows'], HEADS)}\n\nno start within {FAR_DEG[0]:.0f}°: {best}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 5, "segmenter": "none"})
