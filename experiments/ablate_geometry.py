"""How well must tilt and distance be known?

python -m experiments.ablate_geometry [--preset smoke] [--help]

Frames of §4.1 matched (eq. 4) with banks that are rendered for a wrong tilt of the sonar or a wrong ground range, one
of them at a time, on the true maps and on those of a segmenter. The template may lie anywhere in the frame, so a wrong
distance costs by what it does to the template's shape alone. The threshold is the best one on these very frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

import sonarjax as sj
from experiments.ablate_template import YAWS, judged_at_place, scores_at_place
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, TestFrame, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.common.segmenters import map_of

HEADS = {
    "map": "matched on",
    "wrong": "what is wrong",
    "tilt_error_deg": "tilt [°]",
    "distance_error_m": "distance [m]",
    "best_accuracy": "accuracy at the test-optimal threshold",
    "bin_right": "yaw bin right",
    "score_own": "NCC own",
    "score_wrong": "other yaws",
    "score_other": "other object",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    maps: tuple[str, ...] = ("truth", "pix2pix")
    """What is matched: truth is the true map, none the raw frame, else a segmenter's map."""
    tilts_deg: tuple[float, ...] = (-5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0)
    """Errors of the bank's tilt [deg], positive where it looks down too steeply."""
    distances_m: tuple[float, ...] = (-0.3, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.3)
    """Errors of the bank's ground range [m], positive where it is too far."""
    step_deg: int = 10
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    yaw_offset_deg: float = 5.0
    """Uniform offset of each yaw within ± this [deg]."""
    sonar_tilts_deg: tuple[float, ...] = TILTS_DEG
    """True tilts of the sonar [deg], of those of §4.1."""


class Error(NamedTuple):
    """What a bank was rendered wrongly for."""

    wrong: str
    """`tilt` or `distance`."""
    tilt_error_deg: float
    """Tilt of the bank less the frame's [deg]."""
    distance_error_m: float
    """Ground range of the bank less the object's [m]."""


def run(settings: Settings, job: Job) -> Report:
    """One row for each kind of map and each error; the right geometry stands in both series."""
    step, offset, tilts = settings.step_deg, settings.yaw_offset_deg, settings.sonar_tilts_deg
    frames = paper_frames(job.seed, step_deg=step, yaw_offset_deg=offset, tilts_deg=tilts)
    errors = [Error("tilt", off, 0.0) for off in settings.tilts_deg]
    errors += [Error("distance", 0.0, off) for off in settings.distances_m]
    cases = {f"{error.wrong} {error.tilt_error_deg + error.distance_error_m:+g}": error for error in errors}
    maps = {name: [map_of(name, frame) for frame in frames] for name in settings.maps}
    measured = job.map(partial(_measure, maps, frames), cases, "geometry")
    rows = [
        {"map": name} | cases[case]._asdict() | values[name]
        for name in settings.maps
        for case, values in measured.items()
    ]
    return {"rows": rows}


def _measure(
    maps: Mapping[str, Sequence[np.ndarray]], frames: Sequence[TestFrame], error: Error
) -> dict[str, dict[str, float]]:
    banks = {tilt: bank_with(error, tilt) for tilt in {frame.tilt_deg for frame in frames}}
    return {name: judged_at_place(scores_at_place(of, frames, banks), frames) for name, of in maps.items()}


def bank_with(error: Error, tilt_deg: float) -> sj.TemplateBank:
    """The target's bank for frames of `tilt_deg` [deg], rendered for a geometry with this error."""
    sonar = sonar_for(tilt_deg).replace(tilt=math.radians(tilt_deg + error.tilt_error_deg))
    x = GROUND_RANGE_M[tilt_deg] + error.distance_error_m
    return sj.template_bank(target(), sonar, YAWS, x=x, engine=engine())


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    errors = {"tilts_deg": (5.0,), "distances_m": (0.3,)}
    launch(run, Settings, table, smoke=errors | {"maps": ("truth",), "step_deg": 180, "sonar_tilts_deg": (20.0,)})
