"""What does each property of a foreign frame cost? One at a time is swapped into the frames of the nominal device.

python -m experiments.swap_properties [--preset smoke] [--help]

Display laws, what arrives late in the shadow, faces that are dark at a grazing angle or glossy, a wrong gain slope, a
geometry that is a little off, speckle statistics, an uneven floor: so other simulators and devices differ from ours.
Scenes, poses and random draws are those of validation frames and the same for every property, so that a difference
between two rows is the property's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, VALIDATION_SEED, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.scores import area
from experiments.common.segmenters import Name, loaded
from experiments.common.validation import Scene, scenes, shown_in
from sonarjax.data.materials import reflectivity
from sonarjax.sensor import SensorModel

NOTHING = "nothing"
MODELS: dict[str, dict[str, float]] = {
    "display: dB over 60": {"log_share": 1.0, "dynamic_range": 60.0},
    "display: amplitude": {"log_share": 0.0, "exponent": 0.5},
    "display: arctangent": {"log_share": 0.0, "exponent": 0.5, "saturation": 5.0},
    "late reverberation": {"reverberation": 0.3},
    "floor bounce, strong": {"floor_bounce": 0.6},
    "floor bounce, one way": {"floor_bounce_once": 0.5},
    "gain slope": {"tvg_exponent": 2.7},
    "K-distributed floor": {"texture": 0.6},
    "Weibull speckle": {"speckle": 1.3},
    "uneven floor": {"unevenness": 2.0},
    "rippled floor": {"ripple": 0.5},
    "firing groups": {"group_gain_std": 1.0},
}
"""Fields of the sensor model that are changed."""
FACES: dict[str, tuple[float, float, float]] = {
    "grazing faces dark": (2.0, 0.0, 0.0),
    "glossy faces": (1.0, 5.0, 0.0),
    "unequal faces": (0.0, 0.0, 3.0),
}
"""Exponent of Lambert's law [1], strength of the glossy lobe [1] and spread from face to face [dB]."""
LOBE = math.radians(12.0)
"""Width of the glossy lobe [rad]."""
GEOMETRIES: dict[str, tuple[float, float]] = {"tilt 1° off": (1.0, 0.0), "height 2 cm off": (0.0, 0.02)}
"""What the true tilt [deg] and height [m] exceed those by that the recognizer is told."""
PROPERTIES = (NOTHING, *MODELS, *FACES, *GEOMETRIES)
HEADS = {
    "property": "swapped in", "segmenter": "segmenter", "auc": "AUC", "auc_bank": "AUC of score_bank",
    "identified": "targets found", "refused": "others refused", "bank_own": "NCC of targets",
    "median": "yaw, median [°]", "p95": "95 % [°]", "within_1": "within 1 `yaw_std`",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    properties: tuple[str, ...] = PROPERTIES
    """Properties to swap in, one at a time."""
    segmenters: tuple[Name, ...] = ("pix2pix", "none")
    """Segmenters to compare."""
    count: int = 60
    """Frames of each property: of every four, two show the target, one an object like it, one its mirror image."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""

    def __post_init__(self) -> None:
        """Raises ValueError for a property that there is not."""
        unknown = set(self.properties) - set(PROPERTIES)
        if unknown:
            raise ValueError(
                f"--properties: unknown {', '.join(sorted(unknown))}, expected some of {', '.join(PROPERTIES)}"
            )


def run(settings: Settings, job: Job) -> Report:
    """One row for each property and segmenter."""
    made = {
        name: {scene: recognizers(each.target, segmenter=loaded(name)) for scene, each in scenes().items()}
        for name in settings.segmenters
    }
    found = job.map(partial(_measure, settings, job.seed, made), settings.properties, "swapped in")
    return {"rows": [{"property": name} | row for name, rows in found.items() for row in rows]}


Makers = dict[str, dict[str, Callable[[float], sj.Recognizer]]]


def _measure(settings: Settings, seed: int, made: Makers, name: str) -> list[dict[str, Any]]:
    key = jax.random.key(VALIDATION_SEED + seed)

    def one(number: int) -> tuple[str, float, bool, float, np.ndarray]:
        return _frame(name, number, settings.tilts_deg, key=jax.random.fold_in(key, number))

    frames = [one(0), *engine().map(one, range(1, settings.count))]
    return [{"segmenter": segmenter} | _row(frames, of) for segmenter, of in made.items()]


def _frame(
    name: str, number: int, tilts_deg: tuple[float, ...], *, key: jax.Array
) -> tuple[str, float, bool, float, np.ndarray]:
    """Scene, tilt [deg], whether its target is shown, yaw [rad] and image (range, beam) of one frame."""
    names = list(scenes())
    scene, rest = names[number % len(names)], number // len(names)
    shown, tilt = shown_in(scene, rest), tilts_deg[rest // 4 % len(tilts_deg)]
    # Not `fold_in(key, 1)`, whose draws are the poses of frames to which the rule was fitted.
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 11), (3,)), float)
    pose = sj.Pose(GROUND_RANGE_M[tilt] + 0.2 * draws[0] - 0.1, 0.2 * draws[1] - 0.1, 2 * math.pi * draws[2])
    more_tilt, more_height = GEOMETRIES.get(name, (0.0, 0.0))
    nominal = sonar_for(tilt)
    sonar = nominal.replace(
        tilt=jnp.float32(math.radians(tilt + more_tilt)), height=jnp.float32(float(nominal.height) + more_height)
    )
    mesh = getattr(scenes()[scene], Scene._fields[shown])
    exponent, gloss, spread = FACES.get(name, (0.0, 0.0, 0.0))
    ground = replace(mesh, vertices=pose.to_ground(mesh.vertices))
    each = jax.random.normal(jax.random.fold_in(key, 2), (mesh.n_faces // 2 + 1,))
    mesh = replace(mesh, reflectivity=reflectivity(ground, sonar.height, exponent, gloss, LOBE, spread * each))
    model = replace(SensorModel.nominal(), **MODELS.get(name, {}))
    image, _ = observed(mesh, pose, sonar, model, key=jax.random.fold_in(key, 3))
    return scene, tilt, shown == 0, float(pose.yaw), np.asarray(image)


def _row(
    frames: list[tuple[str, float, bool, float, np.ndarray]], made: dict[str, Callable[[float], sj.Recognizer]]
) -> dict[str, float]:
    results = [made[scene](tilt)(image) for scene, tilt, _, _, image in frames]
    own = np.array([frame[2] for frame in frames])
    said = np.array([result.identified for result in results])
    score, bank = (np.array([getattr(result, name) for result in results]) for name in ("score", "score_bank"))
    error = yaw_error_deg([result.yaw for result in results], [frame[3] for frame in frames])[own]
    std = np.degrees([result.yaw_std for result in results])[own]
    return {
        "auc": area(score, own),
        "auc_bank": area(bank, own),
        "identified": float(said[own].mean()),
        "refused": float((~said)[~own].mean()),
        "bank_own": float(bank[own].mean()),
        "median": float(np.median(error)),
        "p95": float(np.percentile(error, 95)),
        "within_1": float((error <= std).mean()),
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    smoke = {"properties": ("nothing",), "segmenters": ("none",), "count": 10, "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=smoke)
