"""Can the shape of an object be had from frames of it? A brick's sides from five, a smooth body's surface from 16.

python -m experiments.shape_from_frames [--preset smoke] [--help]

Bricks: sides up to a fifth off the mesh that is given, poses off by centimetres and degrees; frames by our simulator
and by the independent judge. Smooth bodies: poses known, the search begins with a ball; views between those that were
used are left out and judged. Nothing was tuned on these bricks and bodies: seeds differ from those of the tests.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, sonar_for
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.shapes import ball, brick, chamfer, judge_frames, our_frames, smooth_body, views_around
from sonarjax.scene.objects import BRICK_M
from sonarjax.segment.metrics import confusion, iou

TILT_DEG = 20.0
SIDES_OFF = 0.2
"""Largest difference of a side's logarithm from the mesh's [1]."""
PLACE_OFF_M, YAW_OFF_DEG = 0.01, 3.0
"""Standard deviations of what the poses given are off by."""
SIDES = ("length", "width", "height")
BRICK_HEADS = {"frames_of": "frames of", "side": "side", "bricks": "bricks", "before": "before [range bins]",
               "median": "error, median [range bins]", "largest": "largest", "in_one": "within a range bin",
               "within_1": "within 1 std", "within_2": "within 2", "determined": "determined"}  # fmt: skip
BODY_HEADS = {"body": "smooth body", "when": "when", "chamfer_mm": "Chamfer distance [mm]",
              "highlight": "views left out: IoU of highlight", "shadow": "of shadow", "time_s": "time [s]"}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is sought."""

    bricks: int = 12
    """Bricks of each simulator."""
    views: int = 5
    """Frames of a brick."""
    bodies: int = 3
    """Smooth bodies."""
    body_views: int = 16
    """Frames of a smooth body; as many views between them are left out."""
    iterations: int = 40
    """Steps at each blur of a smooth body's search."""


def run(settings: Settings, job: Job) -> Report:
    """Rows of the bricks' sides and of the bodies."""
    bricks = {}
    for source in ("our simulator", "the judge"):
        cases = {f"brick {k}": k for k in range(settings.bricks)}
        try:
            bricks[source] = job.map(partial(_brick, settings, job.seed, source), cases, source)
        except Skipped as error:
            print(f"left out: {error}")
    bodies = job.map(partial(_body, settings, job), {f"{k + 1}": k for k in range(settings.bodies)}, "smooth bodies")
    rows = [_side(list(found.values()), source, k) for source, found in bricks.items() for k in range(len(SIDES))]
    times = [one["time_s"] for found in bricks.values() for one in found.values()]
    return {
        "bricks": rows,
        "bodies": [{"body": name} | row for name, two in bodies.items() for row in two],
        "brick_s": float(np.median(times)) if times else None,
        "range_bin_mm": 1e3 * float(sonar_for(TILT_DEG).range_bin),
    }


def _brick(settings: Settings, seed: int, source: str, number: int) -> dict[str, Any]:
    """Errors of a brick's sides [range bins] before and after, and the standard deviations given with them."""
    rng = np.random.default_rng([seed, 71, number])
    sonar = sonar_for(TILT_DEG)
    true = np.array(BRICK_M) * np.exp(rng.uniform(-SIDES_OFF, SIDES_OFF, 3))
    poses = views_around(settings.views, rng, GROUND_RANGE_M[TILT_DEG] - 0.1, rng.uniform(0, 2 * math.pi))
    place, turn = rng.normal(0, PLACE_OFF_M, (2, settings.views)), rng.normal(0, YAW_OFF_DEG, settings.views)
    guess = sj.Pose(poses.x + place[0], poses.y + place[1], poses.yaw + np.radians(turn))
    if source == "the judge":
        frames = judge_frames(brick(true), poses, sonar, seed=seed * 1000 + number)
    else:
        key = jax.random.fold_in(jax.random.key(seed), 7100 + number)
        frames = our_frames(brick(true), poses, sonar, key=key)
    begun = time.perf_counter()
    found = sj.fit_size(frames, brick(BRICK_M), sonar, guess, engine=engine())
    std = found.extent * np.array([found.std[f"object_{side}"] for side in SIDES])
    length = float(sonar.range_bin)
    return {
        "before": ((np.array(BRICK_M) - true) / length).tolist(),
        "error": ((found.extent - true) / length).tolist(),
        "std": (std / length).tolist(),
        "determined": list(found.determined.values()),
        "time_s": time.perf_counter() - begun,
    }


def _side(found: Sequence[dict[str, Any]], source: str, k: int) -> dict[str, Any]:
    error, std, before = (np.abs([one[name][k] for one in found]) for name in ("error", "std", "before"))
    return {
        "frames_of": source, "side": SIDES[k], "bricks": len(found), "before": float(np.median(before)),
        "median": float(np.median(error)), "largest": float(error.max()), "in_one": float((error <= 1).mean()),
        "within_1": float((error <= std).mean()), "within_2": float((error <= 2 * std).mean()),
        "determined": float(np.mean([one["determined"][k] for one in found])),
    }  # fmt: skip


def _body(settings: Settings, job: Job, number: int) -> list[dict[str, Any]]:
    """A body before and after: its distance to the true surface, and how views that were left out agree."""
    rng = np.random.default_rng([job.seed, 72, number])
    sonar, true, first = sonar_for(TILT_DEG), smooth_body(rng), ball()
    away, between = GROUND_RANGE_M[TILT_DEG] - 0.1, math.pi / settings.body_views
    poses = views_around(settings.body_views, rng, away)
    left_out = views_around(settings.body_views, rng, away, between)
    frames = our_frames(true, poses, sonar, key=jax.random.fold_in(jax.random.key(job.seed), 7200 + number))
    begun = time.perf_counter()
    config = sj.SurfaceConfig(iterations=settings.iterations)
    found = sj.fit_surface(frames, first, sonar, poses, config=config, engine=engine())
    taken = time.perf_counter() - begun
    meshes = {"true": true, "first": first, "found": found.mesh}
    arrays = {f"{n}_{f}": getattr(mesh, f) for n, mesh in meshes.items() for f in ("vertices", "faces")}
    job.arrays(f"body_{number}", **arrays, score=found.score)
    rows = []
    for when, mesh in (("a ball", first), ("fitted", found.mesh)):
        _, highlight, shadow = _agreement(mesh, true, left_out, sonar)
        row = {"when": when, "chamfer_mm": 1e3 * chamfer(mesh, true)}
        rows.append(row | {"highlight": highlight, "shadow": shadow, "time_s": taken if when == "fitted" else None})
    return rows


def _agreement(mesh: sj.Mesh, true: sj.Mesh, poses: sj.Pose, sonar: sj.Sonar) -> list[float]:
    """IoU of background, highlight and shadow of both meshes' labels, all views together."""
    counts: Any = 0
    for x, y, yaw in zip(poses.x, poses.y, poses.yaw, strict=True):
        pose = sj.Pose(x, y, yaw)
        counts = counts + confusion(*(sj.render(m, pose, sonar).labels() for m in (mesh, true)))
    return [float(v) for v in np.asarray(iou(counts))]


def table(report: Report) -> str:
    """Sides, and surfaces."""
    parts = []
    if report["bricks"]:
        parts.append(columns(report["bricks"], BRICK_HEADS))
        parts.append(f"a range bin is {report['range_bin_mm']:.2f} mm; one brick: {report['brick_s']:.0f} s")
    if report["bodies"]:
        parts.append(columns(report["bodies"], BODY_HEADS))
    return "\n\n".join(parts)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"bricks": 1, "views": 2, "bodies": 1, "body_views": 2, "iterations": 1})
