"""How well is the whole pose of an object found that leans and floats a little, in one frame and in two views?

python -m experiments.lean_pose [--objects N] [--preset smoke] [--help]

Objects lean by up to 15° in roll and pitch, their lowest point is up to 5 cm above the floor, the yaw is unknown; place
and pose are found from nothing, by banks over yaw, roll, pitch and lift. The second view is from 90° beside. Frames of
the package's own simulator are those on which settings were chosen; those of the independent judge are drawn with its
usual slack of tilt (1°) and height (1 cm), and with the geometry known. Means count all that went astray.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.launch import Report, Skipped, launch
from experiments.common.leaning import Case, Leaning, errors, is_angle, rotation, target_cases
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.sets import target
from sonarjax.refine import PoseFinder

ASTRAY_DEG, ASTRAY_CM = 20.0, 10.0
"""A pose that is further off than one of these is another hypothesis; standard deviations are judged on the rest."""
HEADS = {
    "name": "frames", "views": "views", "objects": "objects", "mean_cm": "place, mean [cm]",
    "median_cm": "median [cm]", "mean_deg": "rotation, mean [°]", "median_deg": "median [°]", "astray": "astray",
    "within_1": "within 1 std", "within_2": "within 2", "observable": "observable", "time_s": "time [s]",
}  # fmt: skip
JUDGED = {"judge": False, "judge, geometry known": True}
"""Sets of the independent judge: whether tilt and height are known exactly."""
OWN = "own simulator (validation)"


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    objects: int = 16
    """Objects of each set, each with a pose of its own."""
    tilt_deg: float = 20.0
    """Tilt of the sonar [deg], one of those of §4.1."""
    lean_deg: float = 15.0
    """Largest roll and pitch [deg] of the package's own frames; the judge's are 15°."""
    lift_m: float = 0.05
    """Largest height of the lowest point above the floor [m] of the package's own frames; the judge's is 5 cm."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each set and number of views."""
    try:
        import experiments.judge.leaning  # noqa: F401
    except ImportError as error:
        raise Skipped(f"the judge needs Embree: pip install 'sonarjax[bench]' ({error})") from error
    names = {name: name for name in (*JUDGED, OWN)}
    found = job.map(lambda name: _measured(name, settings, job.seed), names, "sets")
    rows = [_row(name, views, parts[views]) for name, parts in found.items() for views in ("1", "2")]
    return {"rows": rows, "per_frame": found}


def _measured(name: str, settings: Settings, seed: int) -> dict[str, list[dict[str, Any]]]:
    """What is found of each object, from its first frame alone and from both, by the number of views."""
    how = Leaning(settings.tilt_deg, settings.lean_deg, settings.lift_m)
    own = name == OWN
    cases = target_cases(seed, settings.objects, how) if own else _judged(settings, seed, JUDGED[name])
    found: dict[str, list[dict[str, Any]]] = {"1": [], "2": []}
    finder: PoseFinder | None = None
    for case in cases:
        finder = finder or PoseFinder(target(), case.sonar, engine=engine())
        begun = time.perf_counter()
        alone = [finder(image) for image in case.images]
        each = (time.perf_counter() - begun) / len(alone)
        both = finder.views(case.images, case.sonar_poses, alone)
        times = each, time.perf_counter() - begun
        for views, estimate, took in zip(("1", "2"), (alone[0], both), times, strict=True):
            found[views].append(_errors(case.pose, estimate) | {"time": took})
    return found


def _errors(truth: sj.Pose, found: sj.PoseEstimate) -> dict[str, Any]:
    """How far the best hypothesis is off."""
    best = jax.tree.map(lambda v: np.asarray(v)[0], found)
    away = errors(truth, best)
    return {
        "cm": 100 * float(np.linalg.norm(away[~is_angle(best.free)])),
        "deg": math.degrees((rotation(truth).inv() * rotation(best.pose)).magnitude()),
        "z": np.abs(away / np.maximum(np.asarray(best.std, float), 1e-9)).tolist(),
        "observable": np.asarray(best.observable).tolist(),
    }


def _judged(settings: Settings, seed: int, geometry_known: bool) -> Iterator[Case]:
    """Frames of the independent judge."""
    from experiments.judge.leaning import leaning_frames

    for frame in leaning_frames(seed, settings.objects, settings.tilt_deg, geometry_known):
        x, y, z, yaw, roll, pitch = frame.pose
        sonars = sj.Pose(frame.sonars[:, 0], frame.sonars[:, 1], frame.sonars[:, 2])
        yield Case("target", frame.images, sj.Pose(x, y, yaw, z, roll, pitch), sonars, frame.sonar)


def _row(name: str, views: str, found: list[dict[str, Any]]) -> dict[str, Any]:
    place, angle = (np.array([one[key] for one in found]) for key in ("cm", "deg"))
    astray = (angle > ASTRAY_DEG) | (place > ASTRAY_CM)
    share = np.array([one["z"] for one, lost in zip(found, astray, strict=True) if not lost] or [[np.inf]], float)
    return {
        "name": name, "views": views, "objects": len(found), "mean_cm": float(place.mean()),
        "median_cm": float(np.median(place)), "mean_deg": float(angle.mean()),
        "median_deg": float(np.median(angle)), "astray": float(astray.mean()),
        "within_1": float((share <= 1).mean()), "within_2": float((share <= 2).mean()),
        "observable": float(np.mean([one["observable"] for one in found])),
        "time_s": float(np.median([one["time"] for one in found])),
    }  # fmt: skip


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"objects": 1})
