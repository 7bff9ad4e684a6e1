"""Drawn frames of several objects that occur in no test, in the beams of two sonars, and how their maps are scored."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import VALIDATION_SEED
from experiments.common.tank import HIGHLIGHT, HIT
from experiments.common.validation import bare_objects
from sonarjax.data.frames import CHUNK, FrameSettings, draw_chunk
from sonarjax.data.layout import placement_limits
from sonarjax.segment import GeneratorWeights

PLACE = {"tilt": math.radians(20.0), "height": 1.2, "range_min": 1.0, "range_max": 5.0, "n_ranges": 512}
"""Pose and ranges of the sonars [rad, m]."""
LEAST_PIXELS = 20
"""Objects with less highlight are not counted."""
HEADS = {"iou": "IoU of highlight", "precision": "precision", "recall": "recall", "hit": "objects hit"}
Frames = list[tuple[np.ndarray, np.ndarray]]
"""Images in [0, 1], and the number of the object whose highlight each pixel shows, else 0; both (range, beam)."""


def frames_of(sonars: Sequence[str], count: int, most: int, severity: float, seed: int) -> Frames:
    """`count` frames of each sonar, a preset's name, each with one to `most` objects.

    Raises SonarjaxError for a count that is no multiple of `CHUNK`.
    """
    if count < CHUNK or count % CHUNK:
        raise sj.SonarjaxError(f"--count: expected a multiple of {CHUNK}, got {count}")
    meshes = sj.stack_meshes([mesh for both in bare_objects().values() for mesh in both])
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), most)
    how = FrameSettings(scenes=most, sensor="wide", severity=severity)
    frames = []
    for number, name in enumerate(sonars):
        sonar, data = sj.Sonar.preset(name, **PLACE), np.asarray(jax.random.key_data(jax.random.fold_in(key, number)))
        for chunk in range(count // CHUNK):
            drawn = draw_chunk(meshes, sonar, placement_limits(sonar), chunk, how, engine(), key=data)
            parts = np.where(drawn.labels == 1, drawn.instances, 0)
            frames += list(zip(drawn.image / np.float32(255), parts, strict=True))
    return frames


def maps_of(frames: Frames, weights: GeneratorWeights, **options: int) -> Iterable[np.ndarray]:
    """The frames' semantic maps (range, beam) by a network; `options` are those of `sj.segment`."""
    return (np.asarray(engine().run(sj.segment, image, weights, **options)) for image, _ in frames)


def scored(maps: Iterable[np.ndarray], frames: Frames) -> dict[str, float]:
    """The maps' highlight against the true one, all frames together, by the keys of `HEADS`."""
    counts = [counted(made > HIGHLIGHT, parts) for made, (_, parts) in zip(maps, frames, strict=True)]
    both, found, true, hit, objects = np.sum(counts, axis=0)
    shares = {"iou": both / (found + true - both), "precision": both / found, "recall": both / true}
    return shares | {"hit": hit / objects}


def counted(found: np.ndarray, parts: np.ndarray) -> tuple[int, ...]:
    """Pixels of both, of the map's highlight and of the true one; objects that are hit, and all."""
    shares = [found[parts == k].mean() for k in range(1, parts.max() + 1) if (parts == k).sum() >= LEAST_PIXELS]
    true = parts > 0
    return int((found & true).sum()), int(found.sum()), int(true.sum()), sum(s >= HIT for s in shares), len(shares)
