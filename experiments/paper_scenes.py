"""What do the paper's scenes look like here? Arrays for its Fig. 2 to 7; nothing is judged.

python -m experiments.paper_scenes [--preset smoke] [--help]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job
from experiments.common.scores import target
from sonarjax.data import make_pairs, split_key

OBJECTS = {
    "concrete cylinder": sj.objects.concrete_cylinder,
    "plastic ball": sj.objects.ball,
    "clay brick": sj.objects.brick,
    "target": sj.objects.target,
    "non-target": sj.objects.non_target,
}


@dataclass(frozen=True)
class Settings:
    """Which scenes."""

    tilt_deg: float = 20.0
    """Tilt of the sonar in Fig. 2, 3 and 7 [deg]; one of 15, 20, 25."""
    templates: int = 36
    """Templates over a turn, Fig. 3 and 7."""
    pairs: int = 8
    """Training pairs of Fig. 5."""

    def __post_init__(self) -> None:
        """Raises ValueError for a tilt that §4.1 does not have."""
        if self.tilt_deg not in GROUND_RANGE_M:
            raise ValueError(f"--tilt-deg: expected one of {sorted(GROUND_RANGE_M)}, got {self.tilt_deg:g}")


def run(settings: Settings, job: Job) -> Report:
    """Arrays by figure, and how large each is."""
    parts = {
        "fig02": lambda: _frames(settings, job),
        "fig03": lambda: _templates(settings),
        "fig04": _meshes,
        "fig05": lambda: _pairs(settings, job),
    }

    def keep(name: str) -> dict[str, str]:
        arrays = {key: np.asarray(value) for key, value in parts[name]().items()}
        job.arrays(name, **arrays)
        return {key: " × ".join(map(str, value.shape)) for key, value in arrays.items()}

    return {"shapes": job.map(keep, list(parts), "scenes")}


def _frames(settings: Settings, job: Job) -> dict[str, Any]:
    """Fig. 2: simulated frames (yaw, range, beam) of the target, a quarter turn apart."""
    frames = [f for f in paper_frames(job.seed, step_deg=90) if f.is_target and f.tilt_deg == settings.tilt_deg][:4]
    return {
        "image": [f.image for f in frames],
        "clean": [f.clean for f in frames],
        "yaw_deg": [math.degrees(f.yaw) for f in frames],
        "tilt_deg": settings.tilt_deg,
    }


def _templates(settings: Settings) -> dict[str, Any]:
    """Fig. 3 and 7: the bank (yaw, range, beam), where it lies in the frame, and the model."""
    sonar, yaws = sonar_for(settings.tilt_deg), np.arange(settings.templates) * 2 * math.pi / settings.templates
    bank = sj.template_bank(target(), sonar, yaws, x=GROUND_RANGE_M[settings.tilt_deg], engine=engine())
    return {
        "templates": bank.templates,
        "yaw_deg": np.degrees(yaws),
        "offset": bank.offset,
        "tilt_deg": settings.tilt_deg,
    }


def _meshes() -> dict[str, Any]:
    """Fig. 3, 4 and 6: vertices (vertex, 3) [m] and faces (face, 3) of the paper's objects, by name."""
    arrays = {}
    for name, make in OBJECTS.items():
        mesh = make()
        arrays |= {f"{name}/vertices": mesh.vertices, f"{name}/faces": mesh.faces}
    return arrays


def _pairs(settings: Settings, job: Job) -> dict[str, Any]:
    """Fig. 5: images and labels (pair, 128, 128) as the network is trained on."""
    pairs = jax.device_get(make_pairs(settings.pairs, key=split_key(job.seed, "train"), engine=engine()))
    return {"image": pairs.image, "labels": pairs.labels}


def table(report: Report) -> str:
    """What was kept."""
    rows = [(name, key, shape) for name, arrays in report["shapes"].items() for key, shape in arrays.items()]
    return markdown(("figure", "array", "shape"), rows)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"templates": 4, "pairs": 2})
