"""How long does a calibration take, and does the time grow no faster than the number of frames?

python -m experiments.bench_calibrate [--preset smoke] [--help]

One drawn device whose tilt and height are off. At known poses the fit alone is timed, for more and more frames; with
the target searched for in each frame, the whole of `calibrate`. Every run is timed the second time, when nothing is
compiled.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.sets import target
from sonarjax.calibrate.parameters import changed_sonar
from sonarjax.sensor import SensorModel

FREE, OFF = ("tilt", "height"), (math.radians(1.5), -0.04)
"""What is free, and by how much the device differs from what is known [rad, m]."""
PRIOR = {"tilt": math.radians(3.0), "height": 0.05}
HEADS = {"poses": "poses", "frames": "frames", "time_s": "time [s]", "per_frame_s": "a frame [s]",
         "tilt_deg": "tilt, error [°]", "height_cm": "height, error [cm]"}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    counts: tuple[int, ...] = (5, 10, 20, 50, 100, 200)
    """Numbers of frames at known poses."""
    searched: tuple[int, ...] = (20,)
    """Numbers of frames in which the target is searched for."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each number of frames, and the power of the number by which the time of the fit grows."""
    key = jax.random.key(job.seed)
    true = changed_sonar(sonar_for(20.0), FREE, jnp.asarray(OFF, jnp.float32))
    most = max((*settings.counts, *settings.searched))
    images, poses = _frames(true, most, settings.severity, key)
    rows = [_row("known", count, images, poses) for count in settings.counts]
    growth = None
    if len(rows) > 1:
        growth = float(np.polyfit(*np.log([[r["frames"] for r in rows], [r["time_s"] for r in rows]]), 1)[0])
    rows += [_row("searched for", count, images, None) for count in settings.searched]
    return {"rows": rows, "growth": growth}


def _frames(sonar: sj.Sonar, count: int, severity: float, key: jax.Array) -> tuple[list[np.ndarray], sj.Pose]:
    """Frames of the target at random yaws and places, and its poses (frame,)."""
    model = SensorModel.draw(key=jax.random.fold_in(key, 1), severity=severity)
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 2), (count, 3)))
    places = 2.3 + 0.3 * (draws[:, 0] - 0.5), 0.5 * (draws[:, 1] - 0.5)
    poses = sj.Pose(x=places[0], y=places[1], yaw=2 * math.pi * draws[:, 2])
    images = []
    for k in range(count):
        pose = jax.tree.map(lambda v, k=k: v[k], poses)
        images.append(np.asarray(observed(target(), pose, sonar, model, key=jax.random.fold_in(key, 10 + k))[0]))
    return images, poses


def _row(kind: str, count: int, images: list[np.ndarray], poses: sj.Pose | None) -> dict[str, Any]:
    at = None if poses is None else jax.tree.map(lambda v: v[:count], poses)
    how: dict[str, Any] = {"free": FREE, "prior": PRIOR, "poses": at, "present": True, "engine": engine()}
    for _ in range(2):  # the first compiles
        begun = time.perf_counter()
        found = sj.calibrate(images[:count], target(), sonar_for(20.0), **how)
        spent = time.perf_counter() - begun
    return {
        "poses": kind, "frames": count, "time_s": spent, "per_frame_s": spent / count,
        "tilt_deg": math.degrees(found.change[0] - OFF[0]), "height_cm": 100 * (found.change[1] - OFF[1]),
    }  # fmt: skip


def table(report: Report) -> str:
    """Time against frames."""
    text = columns(report["rows"], HEADS)
    if report["growth"] is not None:
        text += f"\n\nat known poses the time grows with the number of frames to the power {report['growth']:.2f}"
    return text


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"counts": (2, 3), "searched": ()})
