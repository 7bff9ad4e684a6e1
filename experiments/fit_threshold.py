"""Which least score identifies a target (eq. 5)? The threshold that errs least on validation frames.

python -m experiments.fit_threshold [--segmenters FILE --store] [--preset smoke] [--help]

Validation frames show other objects than any test, each beside one much like it and its own mirror image, seen by
devices of the family that the paper's sonar is of (`experiments.common.validation`). The thresholds found stand in
`sonarjax.segment.classical`, in the network's weights file and in `experiments.common.segmenters`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.common.frames import TILTS_DEG
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.segmenters import NAMES, available, map_of
from experiments.common.validation import Case, scenes, validation_cases
from sonarjax.io.safetensors import read_safetensors, write_safetensors

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

    count: int = 480
    """Validation frames, of which those of odd devices are left out."""
    segmenters: tuple[str, ...] = available()
    """Segmenters by name, or weights files: each is given a threshold of its own."""
    store: bool = False
    """Write the thresholds into the weights files among them."""
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
    """One row for each segmenter. Raises SonarjaxError for one that is not there, or cannot be written."""
    cases = validation_cases(job.seed, settings.count, tilts_deg=settings.tilts_deg)
    family = [case for case in cases if not case.odd]
    found = job.map(partial(_measure, family), settings.segmenters, "segmenters")
    if settings.store:
        for file in set(settings.segmenters) - set(NAMES):
            arrays, about = read_safetensors(file)
            write_safetensors(file, arrays, about | {"threshold": found[file]["threshold"]})
    return {"rows": [{"segmenter": name} | values for name, values in found.items()]}


def _measure(cases: list[Case], name: str) -> dict[str, Any]:
    made = {sought: recognizers(scene.target, refine=None) for sought, scene in scenes().items()}
    scores: dict[bool, list[float]] = {True: [], False: []}
    for case in tqdm(cases, desc=name, unit="frame", leave=False):
        result = made[case.sought](case.tilt_deg)(case.image, semantic=map_of(name, case), threshold=0.0)
        scores[case.is_target].append(result.score)
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
    launch(run, Settings, table, smoke={"count": 16, "segmenters": ("otsu",), "tilts_deg": (20.0,)})
