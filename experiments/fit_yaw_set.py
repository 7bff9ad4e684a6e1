"""How should the yaws that a frame allows be weighed, and do sets of them hold what they say?

python -m experiments.fit_yaw_set [--preset smoke] [--help]

Symmetric, nearly symmetric and plain objects, seen by drawn devices whose geometry is known exactly in every other
frame (`experiments.common.symmetric_frames`). The numbers of `YawWeights` are chosen one after another, twice, so that
the density at the true yaw is largest on average. The rows are of frames of another seed, and of the independent
judge's, on which nothing was chosen: how often the sets of 68 and 95 % hold the true yaw, and what weight the true mode
has where the frame decides and where it does not. What is found stands in `sonarjax.refine.yaw_set`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.runs import Job
from experiments.common.symmetric_frames import (
    TILT_DEG,
    YawFrame,
    judge_yaw_frames,
    turned_objects,
    yaw_frames,
)
from sonarjax.refine import YAW_WEIGHTS, YawSet, YawWeights, make_yaw_set

TRIED: dict[str, tuple[float, ...]] = {
    "softness": (0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06),
    "slope": (0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5),
    "unrefined": (-0.02, 0.0, 0.02, 0.04, 0.06, 0.1),
    "tail": (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4),
    "tail_scale": (2.0, 2.5, 3.0, 4.0, 6.0, 9.0),
}
"""Numbers in the order in which they are chosen."""
ROUNDS = 2
"""How often each is chosen anew."""
ANYWHERE = 0.01
"""Share of the density that lies anywhere, for the choice alone: where a frame went astray [1]."""
DECIDED = 0.9
"""A frame decides where its likeliest mode has this weight [1]."""
MODE_DEG = 10.0
"""The true mode is the one nearest to the true yaw, if it is no further off [deg]."""
HEADS = {
    "set": "drawn by", "frames": "frames of", "count": "count",
    "within_68": "68 % set holds the truth", "within_95": "95 % set",
    "parts_95": "intervals of the 95 % set", "width_95": "their width, median [°]", "decided": "frame decides",
    "weight_decided": "weight of the true mode there", "weight_open": "where it does not",
    "first": "first mode is true", "first_weight": "weight of the first mode, mean",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is drawn."""

    count: int = 84
    """Frames that the weights are fitted to, and as many of each set that they are judged on."""
    objects: tuple[str, ...] = ()
    """Names of the objects; empty for all."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""


@dataclass(frozen=True)
class Told:
    """What a recognizer said of one frame, and the truth."""

    name: str
    """Which object was shown."""
    exact: bool
    """Whether the recognizer was told the true geometry."""
    true: float
    """True yaw [rad]."""
    hypotheses: np.ndarray
    """Yaw [rad], its standard deviation [rad] and score (hypothesis, 3)."""
    curve: np.ndarray
    """The bank's scores (yaw,)."""
    first_yaw: float
    """Yaw [rad] of the bin with the highest one."""
    evidence: dict[str, float]
    """What `Recognition.evidence` holds."""

    def allowed(self, weights: YawWeights) -> YawSet:
        """The set of yaws under these weights."""
        count = len(self.curve)
        bins = self.first_yaw + (np.arange(count) - int(self.curve.argmax())) * (2 * math.pi / count)
        yaws, stds, scores = self.hypotheses.T
        return make_yaw_set(yaws.tolist(), stds.tolist(), scores.tolist(), self.curve, bins, weights)


def run(settings: Settings, job: Job) -> Report:
    """The weights, and what they reach on other frames and on the judge's."""
    seeds = {"fitted to": 2 * job.seed, "drawn": 2 * job.seed + 1, "judge": job.seed}
    measure = _measure(settings)
    found = job.map(measure, {name: (name, seed) for name, seed in seeds.items()}, "set")
    told = {name: [told_of(one) for one in found[name]] for name in seeds}
    weights, steps = fit(told["fitted to"])
    rows = [{"set": name} | row for name in ("drawn", "judge") for row in rows_of(told[name], weights)]
    job.arrays("told", **{f"{name}_true".replace(" ", "_"): [one.true for one in told[name]] for name in seeds})
    return {"weights": weights._asdict(), "steps": steps, "rows": rows, "told": found}


def _measure(settings: Settings) -> Callable[[tuple[str, int]], list[dict[str, Any]]]:
    """What measures one set of frames: its name and seed; recognizers are made once."""
    loaded = sj.load_segmenter(settings.segmenter)

    @cache
    def recognizer(name: str) -> sj.Recognizer:
        return sj.Recognizer(turned_objects()[name].mesh, sonar_for(TILT_DEG), segmenter=loaded, engine=engine())

    def measure(case: tuple[str, int]) -> list[dict[str, Any]]:
        name, seed = case
        draw = judge_yaw_frames if name == "judge" else yaw_frames
        frames = draw(seed, settings.count, settings.objects or None)
        bar = tqdm(frames, desc=name, unit="frame", leave=False, disable=None)
        return [_found(frame, recognizer(frame.name)(frame.image, threshold=0.5)) for frame in bar]

    return measure


def _found(frame: YawFrame, result: sj.Recognition) -> dict[str, Any]:
    """What is kept of a frame, as JSON's types: the fields of `Told`."""
    return {
        "name": frame.name, "exact": frame.exact, "true": frame.yaw, "curve": result.scores_by_yaw.tolist(),
        "hypotheses": [[one.yaw, one.yaw_std, one.score] for one in result.hypotheses],
        "first_yaw": result.yaw_bin, "evidence": dict(result.evidence or {}),
    }  # fmt: skip


def told_of(found: dict[str, Any]) -> Told:
    """One frame's measurement, read back from JSON's types: no number stands for an infinite error bar."""
    rows = [[math.inf if v is None else float(v) for v in row] for row in found["hypotheses"]]
    return Told(**(found | {"hypotheses": np.array(rows), "curve": np.array(found["curve"])}))


def fit(told: Sequence[Told]) -> tuple[YawWeights, list[dict[str, Any]]]:
    """The weights of the largest mean log density at the true yaws, and what each step reached."""
    weights, steps = YAW_WEIGHTS, list[dict[str, Any]]()
    for _ in range(ROUNDS):
        for name, values in TRIED.items():
            tried = {value: log_density(told, weights._replace(**{name: value})) for value in values}
            value = max(tried, key=lambda v: tried[v])
            weights = weights._replace(**{name: value})
            steps.append({"name": name, "value": value, "density": tried[value]})
    return weights, steps


def log_density(told: Sequence[Told], weights: YawWeights) -> float:
    """Mean log density at the true yaws [log 1/rad]."""
    at = np.array([float(one.allowed(weights).density(np.array(one.true))) for one in told])
    return float(np.log((1 - ANYWHERE) * at + ANYWHERE / (2 * math.pi)).mean())


def rows_of(told: Sequence[Told], weights: YawWeights) -> list[dict[str, Any]]:
    """A row for each object, for all of known and of unsure geometry, and for all."""
    chosen = {
        "all": list(told),
        "geometry known": [one for one in told if one.exact],
        "geometry unsure": [one for one in told if not one.exact],
    }
    chosen |= {name: [one for one in told if one.name == name] for name in dict.fromkeys(one.name for one in told)}
    return [{"frames": name} | judge(some, weights) for name, some in chosen.items() if some]


def judge(told: Sequence[Told], weights: YawWeights) -> dict[str, Any]:
    """How often sets hold the true yaws, how large they are, and what weight the true mode has."""
    sets = [one.allowed(weights) for one in told]
    wide = [one.intervals(0.95) for one in sets]
    first = np.array([one.modes[0].weight for one in sets])
    true = np.array([true_weight(one, told_.true) for one, told_ in zip(sets, told, strict=True)])
    decided = first >= DECIDED
    return {
        "count": len(told),
        "within_68": float(np.mean([s.holds(one.true, 0.68) for s, one in zip(sets, told, strict=True)])),
        "within_95": float(np.mean([s.holds(one.true, 0.95) for s, one in zip(sets, told, strict=True)])),
        "parts_95": float(np.mean([len(parts) for parts in wide])),
        "width_95": float(np.median([math.degrees(sum(p.high - p.low for p in parts)) for parts in wide])),
        "decided": float(decided.mean()),
        "weight_decided": float(true[decided].mean()) if decided.any() else None,
        "weight_open": float(true[~decided].mean()) if (~decided).any() else None,
        "first": float((true >= first).mean()),
        "first_weight": float(first.mean()),
    }


def true_weight(allowed: YawSet, true: float) -> float:
    """Weight of the mode that a true yaw [rad] belongs to; 0 where there is none."""
    off = [float(yaw_error_deg(mode.yaw, true)) for mode in allowed.modes]
    nearest = int(np.argmin(off))
    return allowed.modes[nearest].weight if off[nearest] <= MODE_DEG else 0.0


def table(report: Report) -> str:
    """What is to be copied, and what the shipped weights reach."""
    weights = ", ".join(f"{name} {value:.4g}" for name, value in report["weights"].items())
    return f"fitted: {weights}\n\n{columns(report['rows'], HEADS)}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 2, "objects": ("long box",), "segmenter": "none"})
