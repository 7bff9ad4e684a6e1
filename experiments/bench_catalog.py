"""What does a catalogue of 200 objects cost? Resident memory, and seconds a frame.

python -m experiments.bench_catalog [--preset smoke] [--help]

Objects are drawn piles of boxes and cylinders. Frames show one of them each, on the nominal device. A frame is timed
when its candidates' banks are still to be rendered, and again when they are kept.
"""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from sonarjax.cpu import cores
from sonarjax.match import SearchConfig, Sighting, TargetSearch, leading
from sonarjax.scene.objects import box, cylinder_arrays, join
from sonarjax.sensor import SensorModel

TILT_DEG = 20.0
FINE = 360
"""Yaws of the closer look that is timed beside 36."""
SMOKE = {"objects": 3, "frames": 1, "before": 0, "segmenter": "none"}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    objects: int = 200
    """Objects of the catalogue."""
    frames: int = 12
    """Frames that are timed."""
    before: int = 6
    """Frames before them, which compile what the others need."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""


def drawn_objects(count: int, rng: np.random.Generator) -> dict[str, sj.Mesh]:
    """Piles of one to three boxes, some with a cylinder, 0.1 to 0.4 m across, padded alike."""
    meshes = {}
    for k in range(count):
        parts, top = [], 0.0
        for _ in range(rng.integers(1, 4)):
            size = tuple(float(v) for v in rng.uniform((0.06, 0.05, 0.04), (0.3, 0.18, 0.15)))
            x, y = rng.uniform(-0.05, 0.05, 2)
            parts.append(box(size, (float(x), float(y), top + size[2] / 2), float(rng.uniform(0, math.pi))))
            top += size[2] + 0.001
        if rng.random() < 0.3:
            vertices, faces = cylinder_arrays(float(rng.uniform(0.03, 0.08)), float(rng.uniform(0.05, 0.15)), 12)
            parts.append((vertices + [*rng.uniform(-0.05, 0.05, 2), top], faces))
        meshes[f"object {k}"] = sj.Mesh.from_arrays(*join(*parts), name=f"object {k}")
    stacked = sj.stack_meshes(list(meshes.values()))
    return {name: jax.tree.map(lambda v, k=k: v[k], stacked) for k, name in enumerate(meshes)}


def run(settings: Settings, job: Job) -> Report:
    """What was measured, by name: seconds, megabytes, shares."""
    rng, sonar = np.random.default_rng([job.seed, 74]), sonar_for(TILT_DEG)
    meshes = drawn_objects(settings.objects, rng)
    names = [str(name) for name in rng.choice(list(meshes), settings.before + settings.frames)]
    images = [_frame(meshes[name], sonar, rng, jax.random.fold_in(job.key, 7400 + k)) for k, name in enumerate(names)]
    before = resident_mb()
    recognizer = sj.Recognizer(meshes, sonar, segmenter=settings.segmenter, engine=engine())
    first = recognizer.first_look
    assert first is not None
    worked = time.process_time()
    prepare_s = _timed(recognizer.prepare)[0]
    prepare_work_s = time.process_time() - worked
    for image in images[: settings.before]:
        recognizer(image)
    names, images = names[settings.before :], images[settings.before :]
    anew, results = zip(*(_timed(recognizer, image) for image in images), strict=True)
    worked = time.process_time()
    kept = [_timed(recognizer, image)[0] for image in images]
    worked = time.process_time() - worked
    maps = [result.semantic for result in results]
    network = [_timed(recognizer.segmenter.semantic, image, None, recognizer.engine)[0] for image in images]
    looks = [_timed(first.best, picture) for picture in (*maps, *images)]
    resident = resident_mb()
    sightings = [[look for _, look in looks[k :: len(images)]] for k in range(len(images))]
    short = [leading(found, recognizer.search) for found in sightings]
    return {
        "objects": settings.objects, "yaws": recognizer.search.yaw_bins, "distances": first.n_distances,
        "cores": cores(), "load": os.getloadavg()[0], "rank": recognizer.search.rank, "residual": first.residual,
        "before_mb": before, "resident_mb": resident, "prepare_s": prepare_s,
        "prepare_work_s": prepare_work_s, "anew_s": statistics.median(anew),
        "kept_s": statistics.median(kept), "work_s": worked / len(images), "slowest_s": max(kept),
        "network_s": statistics.median(network), "look_s": 2 * statistics.median([seconds for seconds, _ in looks]),
        "candidates": float(np.mean([len(one) for one in short])),
        "right": float(np.mean([result.target == name for result, name in zip(results, names, strict=True)])),
        **_closer(recognizer, short[0], sightings[0][0], maps[0]),
    }  # fmt: skip


def _frame(mesh: sj.Mesh, sonar: sj.Sonar, rng: np.random.Generator, key: jax.Array) -> np.ndarray:
    """A frame of an object near the middle of the view."""
    away, aside, yaw = rng.uniform((-0.2, -0.12, 0.0), (0.2, 0.12, 2 * math.pi))
    pose = sj.Pose(GROUND_RANGE_M[TILT_DEG] + float(away), float(aside), float(yaw))
    return np.asarray(observed(mesh, pose, sonar, SensorModel.nominal(1.0), key=key)[0])


def _closer(
    recognizer: sj.Recognizer, names: list[str], found: dict[str, Sighting], picture: np.ndarray
) -> dict[str, float]:
    """Seconds for a look at `FINE` yaws of one candidate, its bank rendered anew and kept."""
    one = found[names[0]]

    def fresh() -> TargetSearch:
        config = SearchConfig(yaw_bins=FINE)
        return TargetSearch(one.search.mesh, recognizer.sonar, config, engine=engine(), compact=True)

    fresh().find_near(one.distance_index, picture)  # compiles
    search = fresh()
    anew, kept = (_timed(search.find_near, one.distance_index, picture)[0] for _ in range(2))
    return {"fine_anew_s": anew, "fine_kept_s": kept}


def _timed(function: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    started = time.perf_counter()
    result = function(*arguments)
    return time.perf_counter() - started, result


def resident_mb() -> float:
    """Memory of this process that is resident [MB]; Linux tells."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


LINES = {
    "prepare_s": "to prepare, with compiling [s]", "prepare_work_s": "to prepare, processor time [s]",
    "before_mb": "resident before [MB]", "resident_mb": "resident with all that is kept [MB]",
    "residual": "bound on the error of a first look's score", "kept_s": "a frame, banks kept [s]",
    "slowest_s": "the slowest of these [s]", "work_s": "a frame, banks kept, processor time [s]",
    "anew_s": "a frame, candidates' banks rendered anew [s]", "network_s": "of a frame: the network [s]",
    "look_s": "of a frame: the first look at map and frame [s]", "candidates": "candidates looked at closely, mean",
    "right": "object right", "fine_anew_s": "360 yaws of one candidate, rendered anew [s]",
    "fine_kept_s": "360 yaws of one candidate, kept [s]",
}  # fmt: skip


def table(report: Report) -> str:
    """One line for each number."""
    rows = [{"what": head, "value": report[name]} for name, head in LINES.items()]
    about = (
        "{objects} objects × {yaws} yaws × {distances} distances by {rank} components; {cores} cores, load {load:.1f}"
    )
    return f"{columns(rows, {'what': 'what', 'value': 'measured'})}\n\n{about.format(**report)}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
