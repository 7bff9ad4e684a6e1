"""How should `track` weigh frames? Its settings from drawn validation sequences.

python -m experiments.fit_tracking [--preset smoke] [--help]

Objects and devices of `experiments.common.validation`, standing, or turning at a rate that changes from frame to frame;
and a pile that is the same after half a turn, whose two yaws no frame tells apart. What the errors of all frames of a
standing object share, and what differs, is measured (a one-way analysis of variance). The other settings are chosen one
after another, twice, so that the belief's density at the true yaw, x and y is largest, on average over sequences. What
is found stands in `sonarjax.track`'s `TrackConfig`, which this experiment does not change.

Two numbers are set otherwise. Places are taken to be no better than a range bin, as other devices are less regular than
drawn ones. And `memory` is as long as half a dozen frames in a row may go astray, which is no property of these frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.drawn_device import DrawnDevice, draw_device
from experiments.common.engine import engine
from experiments.common.frames import VALIDATION_SEED, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.sequences import TILT_DEG, recognized, taken_up, truths
from experiments.common.symmetric_frames import two_fold_pile
from experiments.common.validation import SEVERITIES, scenes
from sonarjax.track import Standing, TrackConfig, Turning, measurement_of, nothing_known, numbers_of, run_filter

WIDE = 0.6
"""Share of the devices of the widest family."""
RATES_DEG = (1.0, 6.0)
"""Least and largest mean turn from frame to frame [deg]."""
UNEVEN = (0.4, 1.6)
"""Factors on it in single frames."""
SYMMETRIC = 1000
"""Numbers of sequences from here on show the symmetric pile."""
LOST = 1e-6
"""Share of a density that is anywhere: where the belief has no component near the truth [1]."""
TRIED: dict[str, tuple[float, ...]] = {
    "softness": (0.0025, 0.005, 0.01, 0.02, 0.04),
    "alias": (0.001, 0.01, 0.03, 0.1, 0.3),
    "misses": (0.01, 0.02, 0.05, 0.1),
    "yaw_scale": (0.3, 0.45, 0.6, 0.8, 1.0, 1.2),
    "tail": (0.05, 0.1, 0.2, 0.3),
    "tail_scale": (2.5, 4.0, 6.0, 9.0),
    "aspect": tuple(math.radians(v) for v in (3.0, 6.0, 12.0, 24.0)),
}
"""Settings in the order in which they are chosen."""
NEAR_DEG = 10.0
"""Standing sequences with a yaw error beyond it say nothing of the errors that their frames share [deg]."""
HEADS = {"name": "setting", "value": "value", "density": "mean log density at the truth"}


@dataclass(frozen=True)
class Settings:
    """What is drawn."""

    standing: int = 30
    """Sequences of a standing object."""
    turning: int = 15
    """Sequences of a turning one."""
    symmetric: int = 8
    """Sequences of a symmetric one, standing and turning in turn."""
    frames: int = 8
    """Frames of a standing object; of a turning or symmetric one, three times as many."""
    rounds: int = 2
    """How often each setting is chosen anew."""


def run(settings: Settings, job: Job) -> Report:
    """The settings that were chosen, with the density that each value tried for them reached."""
    cases = {f"standing {k}": (2 * k, False) for k in range(settings.standing)}
    cases |= {f"turning {k}": (2 * k + 1, True) for k in range(settings.turning)}
    cases |= {f"symmetric {k}": (SYMMETRIC + k, k % 2 > 0) for k in range(settings.symmetric)}
    seed, frames = VALIDATION_SEED + 77 + job.seed, settings.frames
    drawn = job.map(lambda case: _drawn(*case, frames, jax.random.key(seed)), cases, "sequences")
    measured = shared_errors(drawn)
    config, rows = replace(TrackConfig(), floor=measured.get("floor", TrackConfig().floor)), list[dict[str, Any]]()
    for _ in range(settings.rounds):
        for name, values in TRIED.items():
            tried = {value: density(drawn, replace(config, **{name: value})) for value in values}
            value = max(tried, key=lambda v: tried[v].mean())
            config = replace(config, **{name: value})
            means = [(v, float(reached.mean())) for v, reached in tried.items()]
            rows.append({"name": name, "value": value, "density": dict(means)[value], "tried": means})
    default = float(density(drawn, TrackConfig()).mean())
    return {"measured": measured, "rows": rows[-len(TRIED) :], "all": rows, "default": default}


def _drawn(number: int, turns: bool, frames: int, root: jax.Array) -> list[Any]:
    key = jax.random.fold_in(root, number)
    name = list(scenes())[number % len(scenes())]
    mesh = two_fold_pile() if number >= SYMMETRIC else scenes()[name].target
    device = draw_device(mesh, TILT_DEG, SEVERITIES, wide=WIDE, key=key)
    recognizer = sj.Recognizer(mesh, sonar_for(TILT_DEG), engine=engine())
    poses = [device.start] * (frames if number < SYMMETRIC else 3 * frames)
    if turns:
        poses = turned(device, 3 * frames, key=jax.random.fold_in(key, 9))
    return recognized(device, recognizer, poses, key=key)


def turned(device: DrawnDevice, frames: int, *, key: jax.Array) -> list[sj.Pose]:
    """Poses of an object that turns one way, unevenly."""
    draws = np.asarray(jax.random.uniform(key, (frames + 1,)), float)
    mean = math.radians(RATES_DEG[0] + (RATES_DEG[1] - RATES_DEG[0]) * draws[0])
    way = 1.0 if float(jax.random.uniform(jax.random.fold_in(key, 1))) < 0.5 else -1.0
    gaps = way * mean * (UNEVEN[0] + (UNEVEN[1] - UNEVEN[0]) * draws[1:])
    yaws = float(device.start.yaw) + np.cumsum(gaps) - gaps[0]
    return [replace(device.start, yaw=jnp.float32(yaw % (2 * math.pi))) for yaw in yaws]


def shared_errors(drawn: dict[str, list[Any]]) -> dict[str, float]:
    """Standard deviations of what all frames of a standing object err alike, and of what differs [rad, m].

    With a mean square b² between the sequences' means of n frames and w² within: √(b² - w²/n), and w.
    """
    means, within, count = [], [], 1
    for name, rows in drawn.items():
        found = np.array([[row["yaw"], row["x"], row["y"]] for row in rows])
        error = found - truths(rows)
        error[:, 0] = (error[:, 0] + math.pi) % (2 * math.pi) - math.pi
        if name.startswith("standing") and np.degrees(np.abs(error[:, 0])).max() <= NEAR_DEG and len(rows) > 1:
            means.append(error.mean(0))
            within.append(error.var(0, ddof=1))
            count = len(rows)
    if not means:
        return {}
    differ = np.mean(within, 0)
    shared = np.sqrt(np.maximum(np.mean(np.square(means), 0) - differ / count, 0.0))
    place = float(np.sqrt(differ[1:].mean()))
    return {"floor": float(shared[0]), "place_floor": float(shared[1:].max()), "place_std": place}


def density(drawn: dict[str, list[Any]], config: TrackConfig) -> np.ndarray:
    """Mean log density [1/(rad m²)] of the filter's beliefs at the truth over each sequence's frames (sequence,)."""
    return np.array([log_densities(name, rows, config).mean() for name, rows in drawn.items()])


def log_densities(name: str, rows: list[Any], config: TrackConfig) -> np.ndarray:
    """Log density [1/(rad m²)] at the truth after each frame (frame,) of a sequence."""
    turns = np.ptp(np.unwrap(truths(rows)[:, 0])) > 0
    motion = Turning() if turns else Standing()
    still = np.zeros(3)
    measurements = [measurement_of(taken_up(row), 36, config, still, float(k > 0)) for k, row in enumerate(rows)]
    stacked = jax.tree.map(lambda *v: np.stack(v), *measurements)
    beliefs = run_filter(nothing_known(config), stacked, numbers_of(motion, config))
    weight, mean, covariance = (np.asarray(v, float) for v in (beliefs.log_weight, beliefs.mean, beliefs.covariance))
    gap = truths(rows)[:, None] - mean[:, 1:, :3]
    gap[..., 0] = (gap[..., 0] + math.pi) % (2 * math.pi) - math.pi
    spread = covariance[:, 1:, :3, :3] + 1e-10 * np.eye(3)
    fit = np.einsum("tki,tki->tk", gap, np.linalg.solve(spread, gap[..., None])[..., 0])
    log = weight[:, 1:] - (fit + np.linalg.slogdet(2 * math.pi * spread)[1]) / 2
    anywhere = LOST / (2 * math.pi * config.area)
    return np.log(np.exp(log).sum(1) + anywhere)


def table(report: Report) -> str:
    """What was chosen last of each setting."""
    measured = ", ".join(f"{name} {value:.4g}" for name, value in report["measured"].items())
    return (
        f"measured: {measured}\n\n{columns(report['rows'], HEADS)}\n\nas TrackConfig has them: {report['default']:.3f}"
    )


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"standing": 1, "turning": 1, "symmetric": 1, "frames": 2, "rounds": 1})
