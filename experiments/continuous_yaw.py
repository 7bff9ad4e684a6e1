"""How good is a yaw that is not bound to the 10° grid, how honest is its error bar, and what does it cost?

python -m experiments.continuous_yaw [--preset smoke] [--help]

The target's frames of §4.1 with yaw offset by up to ±5° from the grid. `errors.npz` holds every error, sorted for
cumulative curves: of the refined yaw, of the best template of the grid, and the grid's floor, which is what is left
when the nearest template is always found (2.5° in the mean and 2.89° RMS, being uniform between 0 and 5°). An error
over its own `yaw_std` should be a standard normal variate. `yaw_basin` has the basin of convergence, `yaw_landscape`
the loss and its derivative, `symmetric_objects` objects that look alike at several yaws.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, TestFrame, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, summary_deg
from experiments.common.recognizers import unrefined
from experiments.common.runs import Job
from experiments.common.scores import recognize_all
from experiments.common.segmenters import Name, loaded
from experiments.common.sets import target
from sonarjax.segment import SEGMENTERS

HALF_BIN_DEG = 5.0
FLOOR = {"mean": HALF_BIN_DEG / 2, "rms": HALF_BIN_DEG / math.sqrt(3), "median": HALF_BIN_DEG / 2,
         "p95": 0.95 * HALF_BIN_DEG, "within_1": 1 / HALF_BIN_DEG}  # fmt: skip
NORMAL = {"median_z": 0.6745, "within_1_std": 0.6827, "within_2_std": 0.9545}
ASTRAY_DEG = 10.0  # an error beyond it is of another hypothesis: `yaw_std` holds for the right one
TIMED_TILT_DEG = 20.0
ERROR_HEADS = {
    "segmenter": "segmenter", "yaw": "yaw", "median": "median [°]", "mean": "mean", "rms": "RMS", "p95": "95 %",
    "within_1": "within 1°", "astray": f"beyond {ASTRAY_DEG:g}°",
}  # fmt: skip
STD_HEADS = {
    "segmenter": "segmenter", "yaw_std": "yaw_std, median [°]", "median_z": "median of error / yaw_std",
    "within_1_std": "within 1 yaw_std", "within_2_std": "within 2", "within_2_std_all": "within 2, those astray too",
}  # fmt: skip
COST_HEADS = {"what": "what", "single": "one frame [ms]", "each": "each of a batch [ms]", "frames": "batch"}


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    segmenters: tuple[Name, ...] = ("truth", "pix2pix", "none")
    """Segmenters to compare; truth is the map without noise."""
    step_deg: int = 10
    """Yaw step of each set [deg], a multiple of 10; 10 gives 144 frames of the target."""
    severity: float = 1.0
    """Severity of the sensor model."""
    timed: tuple[str, ...] = ("pix2pix", "none")
    """Segmenters whose recognition is timed."""
    batch: int = 8
    """Frames of a timed batch."""
    repeats: int = 5
    """How often each cost is measured; the median counts."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""

    def __post_init__(self) -> None:
        """Raise SonarjaxError for what cannot be measured."""
        if self.step_deg % 10 or self.step_deg < 10:
            raise sj.SonarjaxError(f"step_deg: expected a multiple of the grid's 10°, got {self.step_deg}")
        unknown = [name for name in self.timed if name not in SEGMENTERS]
        if unknown:
            raise sj.SonarjaxError(f"timed: expected {', '.join(SEGMENTERS)}, got {unknown[0]}")
        if TIMED_TILT_DEG not in self.tilts_deg:
            raise sj.SonarjaxError(f"tilts_deg: expected {TIMED_TILT_DEG:g} among them, because its frames are timed")


def run(settings: Settings, job: Job) -> Report:
    """Rows of errors, of error bars and of cost; `errors.npz` for the figures."""
    step, severity, tilts = settings.step_deg, settings.severity, settings.tilts_deg
    drawn = paper_frames(job.seed, yaw_offset_deg=5.0, step_deg=step, severity=severity, tilts_deg=tilts)
    frames = [frame for frame in drawn if frame.is_target]
    found = job.map(lambda name: _judged(frames, name), settings.segmenters, "errors")
    floor = np.abs([grid_offset_deg(frame.yaw) for frame in frames])
    arrays = {f"{name}_{key}": np.array(v, float) for name, parts in found.items() for key, v in parts.items()}
    ordered = {f"sorted_{key}": np.sort(np.abs(v)) for key, v in arrays.items() if key.endswith("error_deg")}
    yaws = np.degrees([frame.yaw for frame in frames])
    tilts = [frame.tilt_deg for frame in frames]
    job.arrays("errors", true_yaw_deg=yaws, tilt_deg=tilts, sorted_floor_deg=np.sort(floor), **arrays, **ordered)
    rows: list[dict[str, Any]] = [{"segmenter": "any", "yaw": "floor of a 10° grid", **FLOOR, "astray": 0.0}]
    rows += [{"segmenter": "any", "yaw": "floor of these frames", **_summary(floor)}]
    for name in settings.segmenters:
        for yaw, key in (("best of the grid", "bin_error_deg"), ("refined", "error_deg")):
            rows.append({"segmenter": name, "yaw": yaw, **_summary(arrays[f"{name}_{key}"])})
    bars = [{"segmenter": "a normal variate", **NORMAL}]
    bars += [calibration(name, *(arrays[f"{name}_{k}"] for k in ("error_deg", "std_deg"))) for name in found]
    cost = job.map(lambda one: _timed(one, settings), _contenders(settings, frames), "cost")
    return {
        "frames": len(frames),
        "errors": rows,
        "error_bars": bars,
        "cost": [{"what": k} | v for k, v in cost.items()],
    }


def _judged(frames: Sequence[TestFrame], segmenter: str) -> dict[str, np.ndarray]:
    """Signed errors (frame,) of the refined yaw and the best template's [deg], with the refined one's yaw_std [deg]."""
    found = recognize_all(frames, segmenter, refine=True)
    true = [frame.yaw for frame in frames]
    return {
        "error_deg": signed_error_deg([result.yaw for result in found.results], true),
        "bin_error_deg": signed_error_deg([result.yaw_bin for result in found.results], true),
        "std_deg": found.yaw_std_deg,
    }


def signed_error_deg(found: Any, true: Any) -> np.ndarray:
    """Circular difference [deg] of yaws [rad], from -180 to 180."""
    return (np.degrees(np.asarray(found, float) - np.asarray(true, float)) + 180.0) % 360.0 - 180.0


def grid_offset_deg(yaw: float) -> float:
    """What a yaw [rad] is off the nearest one of the 10° grid [deg]."""
    return math.remainder(math.degrees(yaw), 2 * HALF_BIN_DEG)


def _summary(errors: np.ndarray) -> dict[str, float]:
    return summary_deg(np.abs(errors)) | {"astray": float((np.abs(errors) > ASTRAY_DEG).mean())}


def calibration(segmenter: str, error_deg: np.ndarray, std_deg: np.ndarray) -> dict[str, Any]:
    """How errors (frame,) [deg] compare with their standard deviations, where the right hypothesis was refined."""
    std_deg = np.nan_to_num(std_deg, nan=math.inf)  # JSON has no infinity
    z = np.abs(error_deg) / std_deg
    near = np.abs(error_deg) <= ASTRAY_DEG
    return {
        "segmenter": segmenter,
        "yaw_std": float(np.median(std_deg)),
        "median_z": float(np.median(z[near])) if near.any() else None,
        "within_1_std": float((z[near] < 1).mean()) if near.any() else None,
        "within_2_std": float((z[near] < 2).mean()) if near.any() else None,
        "within_2_std_all": float((z < 2).mean()),
    }


Contender = tuple[Callable[[], Any], Callable[[], Any]]


def _contenders(settings: Settings, frames: Sequence[TestFrame]) -> dict[str, Contender]:
    """What is timed, by name: on one frame, and on a batch; all of one tilt, so that one sonar serves."""
    ours = [frame for frame in frames if frame.tilt_deg == TIMED_TILT_DEG]
    batch = [ours[k % len(ours)] for k in range(settings.batch)]
    sonar, maps = sonar_for(TIMED_TILT_DEG), np.stack([frame.clean for frame in batch])
    x = np.full(len(batch), GROUND_RANGE_M[TIMED_TILT_DEG], np.float32)
    yaw = np.array([frame.yaw for frame in batch], np.float32) + np.float32(math.radians(4.0))

    def refined(pick: Any) -> Any:
        start, config = sj.Pose(x[pick], 0.0, yaw[pick]), sj.RefineConfig(polish=0)
        return sj.refine_yaw(maps[pick], target(), sonar, start, config=config, engine=engine()).yaw

    def recognized(count: int, recognizer: sj.Recognizer) -> None:
        for frame in batch[:count]:  # a recognizer takes one frame at a time
            recognizer(frame.image)

    found: dict[str, Contender] = {"refine_yaw": (lambda: refined(0), lambda: refined(slice(None)))}
    for name in settings.timed:
        segmenter = loaded(name)
        if name != "none":
            found[f"segment, {name}"] = (
                lambda s=segmenter: s.semantic(batch[0].image, engine=engine()),
                lambda s=segmenter: [s.semantic(frame.image, engine=engine()) for frame in batch],
            )
        refining = sj.Recognizer(target(), sonar, segmenter=segmenter, engine=engine())
        for refined_or_not, recognizer in (("not refined", unrefined(refining)), ("refined", refining)):
            found[f"recognize, {name}, {refined_or_not}"] = (
                lambda r=recognizer: recognized(1, r),
                lambda r=recognizer: recognized(len(batch), r),
            )
    return found


def _timed(one: Contender, settings: Settings) -> dict[str, float]:
    """Milliseconds a frame, alone and in a batch."""
    alone, together = (median_seconds(function, settings.repeats) for function in one)
    return {"single": 1e3 * alone, "each": 1e3 * together / settings.batch, "frames": settings.batch}


def median_seconds(function: Callable[[], Any], repeats: int) -> float:
    """Median time [s] of a call, after one that compiles."""
    jax.block_until_ready(function())
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        jax.block_until_ready(function())
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def table(report: Report) -> str:
    """Errors, error bars and cost as three tables."""
    parts = (("errors", ERROR_HEADS), ("error_bars", STD_HEADS), ("cost", COST_HEADS))
    return "\n\n".join(columns(report[key], heads) for key, heads in parts)


if __name__ == "__main__":
    smoke = {"segmenters": ("truth", "none"), "step_deg": 180, "timed": ("none",), "batch": 2, "repeats": 1}
    launch(run, Settings, table, smoke=smoke | {"tilts_deg": (TIMED_TILT_DEG,)})
