"""How large are the errors of a whole pose? The error bar of `PoseFinder`, from validation frames.

python -m experiments.fit_pose_std [--count N] [--preset smoke] [--help]

Validation objects lean and float a little, and are seen by drawn devices whose tilt and height are a little off
(`experiments.common.leaning`). Each pose is found from nothing, in each of two frames and in both together. The error
bar's three numbers are those under which the errors are most likely. The rows say how often errors are within 1 and 2
standard deviations, as the curvature alone has them, with the error bar, and with one fitted without the object that is
judged. What is found stands in `sonarjax.refine.errorbar`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.leaning import Leaning, errors, is_angle, sonar_rows, validation_leaning_cases
from experiments.common.likelihood import log_widening, unlikeliness
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.validation import scenes
from sonarjax.refine import PoseErrorBar, PoseFinder, in_view

ASTRAY_RAD, ASTRAY_M = math.radians(20.0), 0.1
"""A pose with an error beyond one of these is another hypothesis: no error bar is fitted to it."""
HEADS = {
    "numbers": "numbers", "views": "views", "count": "count", "rms": "RMS error [cm, °]",
    "curvature_1": "within 1 std, curvature alone", "curvature_2": "within 2",
    "bar_1": "within 1 std, error bar", "bar_2": "within 2",
    "left_out_1": "within 1, object left out", "left_out_2": "within 2, object left out",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is drawn."""

    count: int = 15
    """Objects with a pose and a device of their own, of the validation's kinds in turn."""
    tilt_deg: float = 20.0
    """Tilt of the sonar [deg], one of those of §4.1."""


@dataclass(frozen=True)
class Measured:
    """The six numbers of the poses that did not go astray; arrays (number,)."""

    error: np.ndarray
    """Size of the error [m, rad]."""
    std: np.ndarray
    """Standard deviation from the curvature [m, rad]."""
    angle: np.ndarray
    """Whether it is an angle."""
    name: np.ndarray
    """Which object it is of."""
    views: np.ndarray
    """In how many frames the pose was found."""

    def of(self, chosen: np.ndarray) -> Measured:
        """Those that are chosen (number,)."""
        return Measured(**{name: values[chosen] for name, values in vars(self).items()})


def run(settings: Settings, job: Job) -> Report:
    """The error bar, and what it reaches."""
    how = Leaning(tilt_deg=settings.tilt_deg)
    found = job.map(lambda name: _found(name, settings.count, how, job.seed), tuple(scenes()), "objects")
    poses = [pose for parts in found.values() for pose in parts]
    values = _numbers([pose for pose in poses if not _astray(pose)])
    bar = fit_pose_error_bar(values)
    left_out = np.zeros(len(values.error))
    for name in np.unique(values.name):
        rest, mine = values.of(values.name != name), values.name == name
        left_out[mine] = _std(fit_pose_error_bar(rest) if len(rest.error) else bar, values.of(mine))
    stds = {"curvature": values.std, "bar": _std(bar, values), "left_out": left_out}
    rows = [
        {"numbers": kind, "views": views} | _row(values, stds, (values.angle == angle) & (values.views == views))
        for kind, angle in (("x, y, z", False), ("yaw, roll, pitch", True))
        for views in (1, 2)
    ]
    astray = float(np.mean([_astray(pose) for pose in poses]))
    return {"error_bar": bar._asdict(), "rows": rows, "poses": len(poses), "astray": astray, "per_frame": found}


def _found(name: str, count: int, how: Leaning, seed: int) -> list[dict[str, Any]]:
    """What is found of one object, in each frame alone and in both."""
    names = list(scenes())
    numbers = range(names.index(name), count, len(names))
    poses: list[dict[str, Any]] = []
    finder: PoseFinder | None = None
    cases = validation_leaning_cases(seed, numbers, how)
    for case in tqdm(cases, desc=name, total=len(numbers), unit="object", leave=False, disable=None):
        finder = finder or PoseFinder(scenes()[name].target, case.sonar, error_bar=None, engine=engine())
        alone = [finder(image) for image in case.images]
        both = finder.views(case.images, case.sonar_poses, alone)
        sonars = sonar_rows(case.sonar_poses)
        truths = [(1, in_view(case.pose, sonar)) for sonar in sonars] + [(len(sonars), case.pose)]
        for (views, truth), estimate in zip(truths, (*alone, both), strict=True):
            best = jax.tree.map(lambda v: np.asarray(v)[0], estimate)
            poses.append(_pose(name, views, truth, best))
    return poses


def _pose(name: str, views: int, truth: sj.Pose, found: sj.PoseEstimate) -> dict[str, Any]:
    values = {"error": errors(truth, found), "std": np.asarray(found.std, float), "angle": is_angle(found.free)}
    plain = {key: value.tolist() for key, value in values.items()}
    return {"name": name, "views": views, "observable": np.asarray(found.observable).tolist(), **plain}


def _astray(pose: dict[str, Any]) -> bool:
    error, angle = np.abs(pose["error"]), np.array(pose["angle"])
    return bool((error[angle] > ASTRAY_RAD).any() or (error[~angle] > ASTRAY_M).any())


def _numbers(poses: list[dict[str, Any]]) -> Measured:
    """The observable numbers of all poses in one list."""
    stds = [np.array(pose["std"], float) for pose in poses]  # NaN for None, which JSON has for infinity
    chosen = [np.array(pose["observable"], bool) & np.isfinite(std) for pose, std in zip(poses, stds, strict=True)]

    def listed(values: list[Any]) -> np.ndarray:
        return np.concatenate([np.broadcast_to(v, c.shape)[c] for v, c in zip(values, chosen, strict=True)])

    of = {key: listed([pose[key] for pose in poses]) for key in ("angle", "name", "views")}
    return Measured(std=listed(stds), error=listed([np.abs(pose["error"]) for pose in poses]), **of)


def fit_pose_error_bar(values: Measured) -> PoseErrorBar:
    """The error bar under which the errors are most likely, scaled by `log_widening`."""

    def bar(beta: np.ndarray) -> PoseErrorBar:
        return PoseErrorBar(*(float(v) for v in np.exp(beta)))

    def loss(beta: np.ndarray) -> float:
        return unlikeliness(values.error, _std(bar(beta), values))

    beta = minimize(loss, np.log([2.0, 0.002, math.radians(1.0)]), method="Nelder-Mead", options={"maxiter": 2000}).x
    return bar(beta + log_widening(values.error, _std(bar(beta), values)))


def _std(bar: PoseErrorBar, values: Measured) -> np.ndarray:
    """Standard deviations (number,) [m, rad]."""
    return np.hypot(bar.factor * values.std, np.where(values.angle, bar.angle, bar.place))


def _row(values: Measured, stds: dict[str, np.ndarray], chosen: np.ndarray) -> dict[str, Any]:
    error, angle = values.error[chosen], values.angle[chosen]
    shown = np.where(angle, np.degrees(error), 100 * error)
    shares = {
        f"{name}_{most}": float((error <= most * std[chosen]).mean()) for name, std in stds.items() for most in (1, 2)
    }
    return {"count": len(error), "rms": float(np.sqrt((shown**2).mean()))} | shares


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    bar = ", ".join(f"{name} {value:.4g}" for name, value in report["error_bar"].items())
    astray = f"{report['poses']} poses, astray {report['astray']:.3f}"
    return f"error bar: {bar}\n\n{astray}\n\n{columns(report['rows'], HEADS)}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 1})
