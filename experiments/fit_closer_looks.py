"""How many objects should get a closer look, and how much does it weigh where it is unsure? Maps of drawn frames.

python -m experiments.fit_closer_looks [--count N] [--preset smoke] [--help]

The frames show one object or several, and devices, that occur in no test. In half of the views they are small, in the
other half about as large as those of a water tank's real frames are in their frames. What is found stands in
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
from sonarjax.segment.tiled import CLOSER, UNSURE

FAR = {"tilt": math.radians(20.0), "height": 1.2, "range_min": 1.0, "range_max": 5.0, "n_ranges": 512}
NEAR = {"tilt": math.radians(22.0), "height": 0.6, "range_min": 0.7, "range_max": 3.0, "n_ranges": 440}
NEARER = {"tilt": math.radians(28.0), "height": 0.8, "range_min": 0.9, "range_max": 2.6, "n_ranges": 440}
"""Poses and ranges of the sonars [rad, m]."""
VIEWS: dict[str, tuple[tuple[str, dict[str, float]], ...]] = {
    "far": (("didson-hf", FAR), ("aris-3000", FAR)),
    "near": (("aris-3000", NEAR), ("aris-3000", NEARER)),
}
"""Sonars of each kind of views, by the names of their presets."""
LEAST_PIXELS = 20
"""Objects with less highlight are not counted."""
HEADS = {
    "shown": "objects in a frame", "view": "view", "frames": "frames", "looks": "closer looks", "unsure": "weight",
    "iou": "IoU of highlight", "precision": "precision", "recall": "recall", "hit": "objects hit", "used": "",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    looks: tuple[int, ...] = (0, 1, 3, CLOSER, 10)
    """Numbers of closer looks, with the weight that is used."""
    unsure: tuple[float, ...] = (0.0, UNSURE, 0.5, 1.0)
    """Weights of closer looks where they are unsure [1], with the number that is used."""
    count: int = 64
    """Frames of each kind and sonar; a multiple of 16."""
    several: int = 8
    """Most objects in a frame that shows several."""
    severity: float = 1.2
    """Severity of the devices [1]."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each kind of frames, and number or weight of closer looks.

    Raises SonarjaxError for a count of frames that are no full chunks.
    """
    if settings.count < CHUNK or settings.count % CHUNK:
        raise sj.SonarjaxError(f"--count: expected a multiple of {CHUNK}, got {settings.count}")

    variants = [(looks, UNSURE) for looks in settings.looks]
    variants += [(CLOSER, weight) for weight in settings.unsure if (CLOSER, weight) not in variants]

    def measure(kind: str) -> list[dict[str, Any]]:
        view, _, shown = kind.partition(", ")
        drawn = _frames(view, 1 if shown == "1" else settings.several, settings, job.seed)
        return [{"shown": shown, "view": view} | row for row in _rows(drawn, variants)]

    kinds = [f"{view}, {shown}" for shown in ("1", f"1 to {settings.several}") for view in VIEWS]
    found = job.map(measure, kinds, "frames")
    return {"rows": [row for kind in kinds for row in found[kind]]}


def _frames(view: str, most: int, settings: Settings, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Images in [0, 1], and the number of the object whose highlight each pixel shows, else 0; both (range, beam)."""
    meshes = sj.stack_meshes([mesh for both in bare_objects().values() for mesh in both])
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), most)
    how = FrameSettings(scenes=most, sensor="wide", severity=settings.severity)
    frames = []
    for number, (name, place) in enumerate(VIEWS[view], start=2 * list(VIEWS).index(view)):
        sonar, data = sj.Sonar.preset(name, **place), np.asarray(jax.random.key_data(jax.random.fold_in(key, number)))
        for chunk in range(settings.count // CHUNK):
            drawn = draw_chunk(meshes, sonar, placement_limits(sonar), chunk, how, engine(), key=data)
            parts = np.where(drawn.labels == 1, drawn.instances, 0)
            frames += list(zip(drawn.image / np.float32(255), parts, strict=True))
    return frames


def _rows(frames: list[tuple[np.ndarray, np.ndarray]], variants: Sequence[tuple[int, float]]) -> list[dict[str, Any]]:
    """A row for each variant: the maps' highlight against the true one, all frames together."""
    weights = sj.load_segmenter().weights
    rows = []
    for looks, unsure in variants:
        maps = (
            np.asarray(engine().run(sj.segment, image, weights, closer=looks, unsure=unsure)) for image, _ in frames
        )
        counts = [_counts(made > HIGHLIGHT, parts) for made, (_, parts) in zip(maps, frames, strict=True)]
        both, found, true, hit, objects = np.sum(counts, axis=0)
        row = {"frames": len(frames), "looks": looks, "unsure": unsure if looks else None}
        row |= {"iou": both / (found + true - both), "precision": both / found, "recall": both / true}
        rows.append(row | {"hit": hit / objects, "used": "used" if (looks, unsure) == (CLOSER, UNSURE) else ""})
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
    launch(run, Settings, table, smoke={"count": 16, "several": 2, "looks": (CLOSER,), "unsure": (UNSURE,)})
