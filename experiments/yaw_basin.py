"""From how far off does refinement find the yaw?

python -m experiments.yaw_basin [--preset smoke] [--help]

`refine_yaw` with its defaults on labels of a converged render, and on what the network makes of noisy frames (whose
classes mix, so sharpness 0), from starts that are off by a given angle. Each again without the widest blur, to see what
that is for. `yaw_landscape` shows the loss behind it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, TestFrame, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.common.segmenters import map_of
from sonarjax.segment import to_grey

CONFIG = sj.RefineConfig(polish=0)  # its defaults, as far as the estimate goes: derivatives of it are not asked for
SHARPNESS_OF = {"labels": CONFIG.sharpness, "pix2pix": 0.0}
CONVERGED = sj.RenderQuality(sub_beams=8)
"""Quality of the renders that labels are made of."""
START_STEP_DEG = 5.0
HEADS = {
    "map": "map",
    "blurs": "blurs [bins]",
    "start_deg": "start off by [°]",
    "within_1": "ends within 1°",
    "within_2": "within 2°",
    "median": "median error [°]",
}
MapName = Literal["labels", "pix2pix"]


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    maps: tuple[MapName, ...] = ("labels", "pix2pix")
    """What is refined on."""
    step_deg: int = 60
    """Yaw step of each of the four sets of frames [deg]: 60 gives 24 frames."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""
    reach_deg: float = 40.0
    """Largest start error [deg], sampled every 5°."""
    position_m: float = 0.02
    """Largest error of a start in x and in y [m]."""
    fine: bool = True
    """Also without the widest blur."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each map, ladder of blurs and start error; `basin.npz` holds the error of every end."""
    frames = target_frames(job.seed, settings.step_deg, settings.tilts_deg)
    off = np.arange(-settings.reach_deg, settings.reach_deg + 1e-6, START_STEP_DEG)
    rows: list[dict[str, Any]] = []
    ends: dict[str, np.ndarray] = {}
    for name in settings.maps:
        images = [image_of(name, frame) for frame in frames]
        for blurs in (CONFIG.blurs, CONFIG.blurs[1:]) if settings.fine else (CONFIG.blurs,):
            said = ", ".join(f"{blur:g}" for blur in blurs)
            # As many iterations in all, or a short ladder would also reach less far.
            iterations = CONFIG.iterations * len(CONFIG.blurs) // len(blurs)
            config = replace(CONFIG, blurs=blurs, iterations=iterations, sharpness=SHARPNESS_OF[name])
            one = partial(_ends, off, config, settings, job.seed)
            cases = {str(k): (frames[k], images[k], k) for k in range(len(frames))}
            errors = np.array(list(job.map(one, cases, f"{name}, blurs {said}").values()), float)
            ends[f"{name}_{len(blurs)}_blurs_error_deg"] = errors
            rows += [
                {"map": name, "blurs": said, "start_deg": float(start), **shares(errors[:, k])}
                for k, start in enumerate(off)
            ]
    job.arrays("basin", start_deg=off, **ends)
    return {"frames": len(frames), "rows": rows}


def target_frames(seed: int, step_deg: int, tilts_deg: Sequence[float] = TILTS_DEG) -> list[TestFrame]:
    """Frames of the target at these tilts and one drawn of them, yaw in steps of `step_deg` and up to 5° off [deg]."""
    frames = paper_frames(seed, yaw_offset_deg=5.0, step_deg=step_deg, tilts_deg=tilts_deg)
    return [frame for frame in frames if frame.is_target]


def image_of(name: MapName, frame: TestFrame) -> np.ndarray:
    """The image (range, beam) that is refined on: labels of a converged render, or the network's map."""
    if name == "pix2pix":
        return map_of(name, frame)
    rendered = sj.render(target(), moved(frame), sonar_for(frame.tilt_deg), quality=CONVERGED)
    return to_grey(np.asarray(rendered.labels()))


def moved(frame: TestFrame, yaw_deg: Any = 0.0, x: Any = 0.0, y: Any = 0.0) -> sj.Pose:
    """The true pose of a frame's object, moved by angles [deg] and lengths [m]."""
    away = GROUND_RANGE_M[frame.tilt_deg]
    return sj.Pose(away + x, y, frame.yaw + np.radians(yaw_deg))


def _ends(off: np.ndarray, config: sj.RefineConfig, settings: Settings, seed: int, case: Any) -> np.ndarray:
    """Errors (start,) [deg] at which refinement ends, of starts whose yaw is `off` [deg], and x and y a little."""
    frame, image, number = case
    aside = np.random.default_rng([seed, number]).uniform(-1, 1, (2, len(off))) * settings.position_m
    # The default bounds would cut off what starts 40° away.
    yaw, x, y = config.bounds
    config = replace(config, bounds=(max(yaw, math.radians(settings.reach_deg + 20.0)), x, y))
    start, sonar = moved(frame, off, *aside), sonar_for(frame.tilt_deg)
    found = sj.refine_yaw(image, target(), sonar, start, config=config, engine=engine())
    return yaw_error_deg(found.yaw, frame.yaw)


def shares(errors: np.ndarray) -> dict[str, float]:
    """Shares of errors (frame,) [deg] within 1° and 2°, and their median."""
    within = {f"within_{limit}": float((errors <= limit).mean()) for limit in (1, 2)}
    return within | {"median": float(np.median(errors))}


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    small = {"maps": ("labels",), "step_deg": 180, "reach_deg": 5.0, "fine": False, "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=small)
