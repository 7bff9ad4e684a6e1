"""How many objects should get a closer look? Maps of drawn frames that show one object or several, by that number.

python -m experiments.fit_closer_looks [--count N] [--preset smoke] [--help]

The frames show objects and devices that occur in no test, in the beams of two sonars. What is found stands in
`sonarjax.segment.tiled`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import VALIDATION_SEED
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.tank import HIGHLIGHT, HIT
from experiments.common.validation import bare_objects
from sonarjax.data.frames import CHUNK, FrameSettings, draw_chunk
from sonarjax.data.layout import placement_limits
from sonarjax.segment.tiled import CLOSER

PLACE = {"tilt": math.radians(20.0), "height": 1.2, "range_min": 1.0, "range_max": 5.0, "n_ranges": 512}
"""Pose and ranges of the sonars [rad, m]."""
LEAST_PIXELS = 20
"""Objects with less highlight are not counted."""
HEADS = {
    "shown": "objects in a frame", "frames": "frames", "looks": "closer looks", "iou": "IoU of highlight",
    "precision": "precision", "recall": "recall", "hit": "objects hit", "used": "",
}  # fmt: skip


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
    if settings.count < CHUNK or settings.count % CHUNK:
        raise sj.SonarjaxError(f"--count: expected a multiple of {CHUNK}, got {settings.count}")

    def measure(shown: str) -> list[dict[str, Any]]:
        return _rows(_frames(settings, 1 if shown == "1" else settings.several, job.seed), settings.looks)

    kinds = ("1", f"1 to {settings.several}")
    found = job.map(measure, kinds, "objects in a frame")
    return {"rows": [{"shown": kind} | row for kind in kinds for row in found[kind]]}


def _frames(settings: Settings, most: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Images in [0, 1], and the number of the object whose highlight each pixel shows, else 0; both (range, beam)."""
    meshes = sj.stack_meshes([mesh for both in bare_objects().values() for mesh in both])
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), most)
    how = FrameSettings(scenes=most, sensor="wide", severity=settings.severity)
    frames = []
    for number, name in enumerate(settings.sonars):
        sonar, data = sj.Sonar.preset(name, **PLACE), np.asarray(jax.random.key_data(jax.random.fold_in(key, number)))
        for chunk in range(settings.count // CHUNK):
            drawn = draw_chunk(meshes, sonar, placement_limits(sonar), chunk, how, engine(), key=data)
            parts = np.where(drawn.labels == 1, drawn.instances, 0)
            frames += list(zip(drawn.image / np.float32(255), parts, strict=True))
    return frames


def _rows(frames: list[tuple[np.ndarray, np.ndarray]], numbers: Sequence[int]) -> list[dict[str, Any]]:
    """A row for each number of closer looks: the maps' highlight against the true one, all frames together."""
    weights = sj.load_segmenter().weights
    rows = []
    for looks in numbers:
        maps = (np.asarray(engine().run(sj.segment, image, weights, closer=looks)) for image, _ in frames)
        counts = [_counts(made > HIGHLIGHT, parts) for made, (_, parts) in zip(maps, frames, strict=True)]
        both, found, true, hit, objects = np.sum(counts, axis=0)
        row = {"frames": len(frames), "looks": looks, "iou": both / (found + true - both), "precision": both / found}
        row |= {"recall": both / true, "hit": hit / objects}
        rows.append(row | {"used": "used" if looks == CLOSER else ""})
    return rows


def _counts(found: np.ndarray, parts: np.ndarray) -> tuple[int, ...]:
    """Pixels of both, of the map's highlight and of the true one; objects that are hit, and all."""
    shares = [found[parts == k].mean() for k in range(1, parts.max() + 1) if (parts == k).sum() >= LEAST_PIXELS]
    true = parts > 0
    return int((found & true).sum()), int(found.sum()), int(true.sum()), sum(s >= HIT for s in shares), len(shares)


def table(report: Report) -> str:
    """The rows."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 16, "several": 2, "looks": (CLOSER,), "sonars": ("didson-hf",)})
