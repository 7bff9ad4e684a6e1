"""What does `recognize` say of objects that look alike at several yaws?

python -m experiments.symmetric_objects [--preset smoke] [--help]

A square box (the same every 90°), a cylinder lying down and a pile of bricks that is the same after half a turn, at
random yaws and places on noisy frames. `recognize` gives up to two yaws: for such objects it should say so by
two of them, each right but for the object's symmetry, so all errors here are taken modulo that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.runs import Job
from experiments.common.segmenters import loaded
from sonarjax.scene.objects import BRICK_M, box, cylinder_arrays, join
from sonarjax.sensor import SensorModel

TILT_DEG = 20.0
PLACE_M = (0.05, 0.15)  # largest distance from the usual place, in x and in y
HEADS = {
    "object": "object",
    "period_deg": "same every [°]",
    "segmenter": "segmenter",
    "two": "two hypotheses",
    "best_median": "error of the best, median [°]",
    "best_p95": "95 %",
    "all_within": "all right",
    "two_within": "two, both right",
    "gap_deg": "between the two [°]",
    "score_gap": "first less second score",
}


class Symmetric(NamedTuple):
    """An object that looks the same every `period_deg` of yaw [deg]."""

    make: Callable[[], sj.Mesh]
    period_deg: float


def square_box() -> sj.Mesh:
    """A box with a square floor plan of 0.2 m, 0.12 m high."""
    return sj.Mesh.from_arrays(*box((0.2, 0.2, 0.12), (0.0, 0.0, 0.06)), name="square box")


def lying_cylinder(radius: float = 0.05, length: float = 0.3, sides: int = 24) -> sj.Mesh:
    """A cylinder on its side along x; lengths [m]."""
    upright, faces = cylinder_arrays(radius, length, sides)
    lying = np.stack([upright[:, 2] - length / 2, upright[:, 1], radius - upright[:, 0]], axis=1)
    return sj.Mesh.from_arrays(lying, faces, name="lying cylinder")


def brick_pair() -> sj.Mesh:
    """Two bricks side by side, shifted, and a third across their middle: the same after half a turn."""
    height = BRICK_M[2]
    parts = [box(BRICK_M, (side * 0.05, side * 0.048, height / 2)) for side in (-1, 1)]
    across = box(BRICK_M, (0.0, 0.0, 1.5 * height), math.radians(65))
    return sj.Mesh.from_arrays(*join(*parts, across), name="two-fold pile")


OBJECTS = {
    "square box": Symmetric(square_box, 90.0),
    "lying cylinder": Symmetric(lying_cylinder, 180.0),
    "two-fold pile": Symmetric(brick_pair, 180.0),
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    objects: tuple[Literal["square box", "lying cylinder", "two-fold pile"], ...] = tuple(OBJECTS)
    """Objects to look at."""
    segmenters: tuple[Literal["truth", "pix2pix", "none", "otsu"], ...] = ("truth", "pix2pix")
    """Segmenters; truth is the map without noise."""
    frames: int = 24
    """Frames of each object."""
    within_deg: float = 2.0
    """An error up to this is right [deg]."""
    severity: float = 1.0
    """Severity of the sensor model."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each object and segmenter; `hypotheses.npz` holds what was found in each frame."""
    rows, arrays = [], {}
    for number, name in enumerate(settings.objects):
        mesh, period = OBJECTS[name].make(), OBJECTS[name].period_deg
        frames = _frames(mesh, settings, jax.random.fold_in(job.key, number))
        arrays[f"{name}_true_yaw_deg"] = np.degrees([yaw for yaw, *_ in frames])
        measure = _measure(mesh, frames)
        for segmenter, found in job.map(measure, settings.segmenters, name).items():
            yaws, scores = (np.array(found[key], float) for key in ("yaw_deg", "score"))
            arrays |= {f"{name}_{segmenter}_yaw_deg": yaws, f"{name}_{segmenter}_score": scores}
            judged = judge(yaws, scores, arrays[f"{name}_true_yaw_deg"], period, settings.within_deg)
            rows.append({"object": name, "period_deg": period, "segmenter": segmenter} | judged)
    job.arrays("hypotheses", **{key.replace(" ", "_"): value for key, value in arrays.items()})
    return {"rows": rows}


Drawn = tuple[float, np.ndarray, np.ndarray]


def _frames(mesh: sj.Mesh, settings: Settings, key: jax.Array) -> list[Drawn]:
    """True yaw [rad], noisy frame and clean map (range, beam) of an object at random yaws and places."""
    sonar, model = sonar_for(TILT_DEG), SensorModel.nominal(settings.severity)
    drawn = []
    for part in jax.random.split(key, settings.frames):
        place, noise = jax.random.split(part)
        x, y, turn = jax.random.uniform(place, (3,), minval=-1.0) * jnp.array([*PLACE_M, math.pi])
        pose = sj.Pose(GROUND_RANGE_M[TILT_DEG] + x, y, turn)
        image, clean = observed(mesh, pose, sonar, model, key=noise)
        drawn.append((float(turn), np.asarray(image), np.asarray(clean)))
    return drawn


def _measure(mesh: sj.Mesh, frames: list[Drawn]) -> Callable[[str], dict[str, Any]]:
    """What finds the hypotheses: yaws [deg] and scores (frame, hypothesis), NaN where there are fewer."""

    recognizer = sj.Recognizer(mesh, sonar_for(TILT_DEG), segmenter="none", engine=engine())

    def measure(segmenter: str) -> dict[str, Any]:
        found = np.full((2, len(frames), recognizer.search.hypotheses), np.nan)
        for k, (_, image, clean) in enumerate(frames):
            seen = clean if segmenter == "truth" else loaded(segmenter).semantic(image, engine=engine())
            for n, h in enumerate(recognizer(image, semantic=seen, threshold=0.0).hypotheses):
                found[:, k, n] = math.degrees(h.yaw), h.score
        return {"yaw_deg": found[0], "score": found[1]}

    return measure


def judge(
    yaw_deg: np.ndarray, score: np.ndarray, true_deg: np.ndarray, period_deg: float, within_deg: float
) -> dict[str, Any]:
    """How hypotheses (frame, 2) [deg], NaN where there is none, agree with the truth (frame,) modulo the period."""
    error = yaw_error_deg(np.radians(yaw_deg), np.radians(true_deg)[:, None], period_deg)
    two = np.isfinite(yaw_deg[:, 1])
    right = (error <= within_deg) | ~np.isfinite(yaw_deg)
    gap = np.abs((yaw_deg[:, 1] - yaw_deg[:, 0] + 180.0) % 360.0 - 180.0)[two]
    return {
        "two": float(two.mean()),
        "best_median": float(np.median(error[:, 0])),
        "best_p95": float(np.percentile(error[:, 0], 95)),
        "all_within": float(right.all(axis=1).mean()),
        "two_within": float((two & right.all(axis=1)).mean()),
        "gap_deg": float(np.median(gap)) if two.any() else None,
        "score_gap": float(np.median((score[:, 0] - score[:, 1])[two])) if two.any() else None,
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"objects": ("square box",), "segmenters": ("truth",), "frames": 3})
