"""How many pixels of a frame count as independent? Errors of the mean yaw on validation frames, by that number.

python -m experiments.fit_mean_yaw [--count N] [--preset smoke] [--help]

`recognize` takes the mean of the yaws near the best fit, weighted by their likelihood, and this number says how sharp
the likelihood is. With 0 the yaw is that of the best fit. In half of the frames the walls of a drawn tank are in view.
What is found stands in `sonarjax.refine.mean_yaw`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers, refined_starts
from experiments.common.runs import Job
from experiments.common.validation import Case, scenes, validation_cases
from experiments.common.walled import walled_cases
from sonarjax.refine import on_frame
from sonarjax.refine.mean_yaw import INDEPENDENT, mean_turn, scores_near

NUMBERS = (0.0, 30.0, 100.0, 200.0, INDEPENDENT, 500.0, 1000.0, 3000.0)
"""Numbers of independent pixels."""
ASTRAY_DEG = 30.0
"""Frames with a larger error are left out: no mean mends these."""
SETS = {"open floor": validation_cases, "walls in view": walled_cases}
HEADS = {
    "frames": "frames", "count": "count", "independent": "independent pixels", "median": "yaw, median [°]",
    "mean": "mean [°]", "p95": "95 % [°]", "used": "",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    count: int = 240
    """Frames of each set, half of which show the target."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""


class Fit(NamedTuple):
    """The best fit to one frame."""

    yaw: float
    """Refined yaw [rad]."""
    truth: float
    """True yaw [rad]."""
    scores: np.ndarray
    """NCC of the poses near it, as `scores_near` gives them."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each set of frames and number of independent pixels."""

    def measure(name: str) -> list[Fit]:
        # Another seed than those of the frames on which decision and starts are fitted.
        return _measured(SETS[name](job.seed + 2, settings.count), settings.segmenter)

    found = {name: [Fit(*fit) for fit in fits] for name, fits in job.map(measure, tuple(SETS), "sets").items()}
    return {"rows": [_row(name, fits, number) for name, fits in found.items() for number in NUMBERS]}


def _measured(cases: list[Case], segmenter: str) -> list[Fit]:
    loaded = sj.load_segmenter(segmenter)
    made = {name: recognizers(scene.target, segmenter=loaded) for name, scene in scenes().items()}
    targets = [case for case in cases if case.is_target]
    return [
        _fit(made[case.sought](case.tilt_deg), case)
        for case in tqdm(targets, desc="fitting", unit="frame", leave=False, disable=None)
    ]


def _fit(recognizer: sj.Recognizer, case: Case) -> Fit:
    assert recognizer.refine is not None
    best = refined_starts(recognizer, case.image)[0]
    search, how = best.start.candidate.search, (on_frame(recognizer.refine), best.size, engine())
    scores = scores_near(case.image, None, search.mesh, search.sonar, best.pose, best.drawn, *how)
    return Fit(float(best.pose.yaw), case.yaw, scores)


def _row(name: str, fits: list[Fit], independent: float) -> dict[str, Any]:
    near = [fit for fit in fits if yaw_error_deg(fit.yaw, fit.truth) <= ASTRAY_DEG]
    errors = [float(yaw_error_deg(fit.yaw + mean_turn(np.asarray(fit.scores), independent), fit.truth)) for fit in near]
    row = {"frames": name, "count": len(near), "independent": independent}
    numbers = {"median": np.median(errors), "mean": np.mean(errors), "p95": np.percentile(errors, 95)} if near else {}
    row |= {head: float(numbers[head]) if near else None for head in ("median", "mean", "p95")}
    return row | {"used": "used" if independent == INDEPENDENT else ""}


def table(report: Report) -> str:
    """The rows."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 5, "segmenter": "none"})
