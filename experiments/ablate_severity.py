"""How does recognition fall as the sonar gets worse?

python -m experiments.ablate_severity [--preset smoke] [--help]

The frames of §4.1 at several severities of the sensor model, thresholds fixed beforehand at severity 1 on validation
frames: what a user meets whose sonar is worse or better than the one the threshold was set for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from experiments.common.frames import TILTS_DEG, TestFrame, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.scores import recognize_all, summary_of
from experiments.common.segmenters import Name

HEADS = {
    "severity": "severity",
    "segmenter": "segmenter",
    "accuracy": "accuracy",
    "best_accuracy": "at the test-optimal threshold",
    "bin_right": "yaw bin right",
    "score_target": "mean score of targets",
    "score_other": "of the other object",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    severities: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
    """Severities of the sensor model; 1 is calibrated to the paper's frames, training saw 0 to 2."""
    segmenters: tuple[Name, ...] = ("pix2pix", "none", "otsu")
    """Segmenters to compare."""
    step_deg: int = 20
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""


def run(settings: Settings, job: Job) -> Report:
    """One row for each severity and segmenter."""
    rows: list[dict[str, Any]] = []
    for severity in settings.severities:
        frames = paper_frames(job.seed, step_deg=settings.step_deg, severity=severity, tilts_deg=settings.tilts_deg)
        measure = partial(_measure, frames)
        measured = job.map(measure, settings.segmenters, f"severity {severity:g}")
        rows += [{"severity": severity, "segmenter": name} | values for name, values in measured.items()]
    return {"rows": rows}


def _measure(frames: list[TestFrame], segmenter: str) -> dict[str, float]:
    return summary_of(recognize_all(frames, segmenter))


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    small = {"severities": (1.0,), "segmenters": ("otsu",), "step_deg": 90, "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=small)
