"""How many objects should get a closer look? Maps of drawn frames that show one object or several, by that number.

python -m experiments.fit_closer_looks [--count N] [--preset smoke] [--help]

The frames show objects and devices that occur in no test, in the beams of two sonars. What is found stands in
`sonarjax.segment.tiled`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sonarjax as sj
from experiments.common import several
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.several import Frames, frames_of, maps_of, scored
from sonarjax.segment.tiled import CLOSER

HEADS = {"shown": "objects in a frame", "frames": "frames", "looks": "closer looks", **several.HEADS, "used": ""}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    looks: tuple[int, ...] = (0, 1, 3, CLOSER, 10)
    """Numbers of closer looks."""
    sonars: tuple[str, ...] = ("didson-hf", "aris-3000")
    """Sonars, by the names of their presets."""
    count: int = 96
    """Frames of each kind and sonar; a multiple of 16."""
    several: int = 8
    """Most objects in a frame that shows several."""
    severity: float = 1.2
    """Severity of the devices [1]."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each kind of frames and number of closer looks.

    Raises SonarjaxError for a count of frames that are no full chunks.
    """

    def measure(shown: str) -> list[dict[str, Any]]:
        most = 1 if shown == "1" else settings.several
        frames = frames_of(settings.sonars, settings.count, most, settings.severity, job.seed)
        return _rows(frames, settings.looks)

    kinds = ("1", f"1 to {settings.several}")
    found = job.map(measure, kinds, "objects in a frame")
    return {"rows": [{"shown": kind} | row for kind in kinds for row in found[kind]]}


def _rows(frames: Frames, numbers: Sequence[int]) -> list[dict[str, Any]]:
    """A row for each number of closer looks."""
    weights = sj.load_segmenter().weights
    return [
        {"frames": len(frames), "looks": looks}
        | scored(maps_of(frames, weights, closer=looks), frames)
        | {"used": "used" if looks == CLOSER else ""}
        for looks in numbers
    ]


def table(report: Report) -> str:
    """The rows."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 16, "several": 2, "looks": (CLOSER,), "sonars": ("didson-hf",)})
