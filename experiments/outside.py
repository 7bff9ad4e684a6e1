"""How good are the results on frames that we did not draw: an independent judge's, another simulator's, a real tank's?

python -m experiments.outside [--external DIR] [--tank DIR] [--trainings FILE FILE] [--preset smoke] [--help]

The judge (`experiments.judge`) is a ray caster on Embree and a sensor model that import nothing from the package's
renderer or sensor. The folders of another simulator's frames and of the tank are not part of the project; what is not
given is left out. No threshold, setting or network was chosen on any of these frames, with exceptions that
docs/outside.md names; it logs every run.

`right` is a target that is identified with its yaw within 5°, or another object that is refused.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.launch import Report, combined, launch, mean_and_spread
from experiments.common.metrics import columns, formatted, yaw_error_deg
from experiments.common.outside import OutsideFrame, OutsideSet, judge_set, own_set, read_set
from experiments.common.runs import Job
from experiments.common.scores import area
from experiments.common.segmenters import loaded, threshold_of
from experiments.common.sets import SetName
from experiments.common.tank import tank_metrics

RIGHT_DEG, ASTRAY_DEG = 5.0, 30.0
"""Largest yaw error of a right frame, and the error beyond which a yaw is another one altogether [deg]."""
EXTERNAL = ("offset", "severe", "mirror", "off_geometry")
JUDGED = ("offset", "severe", "mirror", "devices")
OWN: tuple[SetName, ...] = ("offset yaw", "severity 1.5", "mirror image", "other devices")
RANKED = ("offset", "severe")
"""Sets whose `yaw_std` must rank their frames."""
RESAMPLED = 1000
HEADS = {
    "set": "frames of",
    "frames": "frames",
    "right": "right",
    "identified": "targets found",
    "refused": "others refused",
    "auc": "AUC",
    "auc_gap": "less that of `none`",
    "auc_gap_low": "at least",
    "yaw_median": "yaw, median [°]",
    "yaw_p95": "95 % [°]",
    "astray": "beyond 30°",
    "within_1": "within 1 `yaw_std`",
    "within_2": "within 2",
    "errors": "errors",
}
TANK_HEADS = {
    "segmenter": "segmenter",
    "iou": "IoU",
    "precision": "precision",
    "recall": "recall",
    "hit": "objects hit",
}


@dataclass(frozen=True)
class Settings:
    """What is judged."""

    external: str = ""
    """Folder with the other simulator's sets; empty for that of SONARJAX_EXTERNAL_DATA, or none."""
    tank: str = ""
    """Folder with images/ and masks/ of the tank; empty for `watertank` in that of SONARJAX_REAL_DATA, or none."""
    judged: tuple[str, ...] = JUDGED
    """Kinds of frames of the independent judge."""
    own: tuple[SetName, ...] = OWN
    """Sets of our own simulator, for comparison."""
    external_sets: tuple[str, ...] = EXTERNAL
    """Folders of the other simulator."""
    every: int = 1
    """One frame in so many is looked at."""
    step_deg: int = 10
    """Yaw step of the judge's frames and of our own [deg]."""
    segmenter: str = "pix2pix"
    """The segmenter judged, beside `none`."""
    trainings: tuple[str, ...] = ()
    """Weights files of further trainings of it: each number becomes the mean of all, with its largest deviation."""
    rule_of: str = ""
    """Segmenter whose rule decides where weights have none of their own; empty for eq. 5 and their threshold then."""


class Verdict(NamedTuple):
    """What a recognizer said of a set's frames; arrays (frame,), NaN where it ended in an error."""

    score: np.ndarray
    """What the threshold judges [1]."""
    identified: np.ndarray
    """Whether it was taken for the target."""
    error_deg: np.ndarray
    """Error of the refined yaw [deg]."""
    std_deg: np.ndarray
    """Standard deviation given with it [deg]."""


def run(settings: Settings, job: Job) -> Report:
    """One row a set; the tank's rows; how well `yaw_std` ranks the frames."""
    made = {f"judge, {kind}": partial(judge_set, job.seed, kind, settings.step_deg) for kind in settings.judged}
    made |= {f"our own, {name}": partial(own_set, name, job.seed, settings.step_deg) for name in settings.own}
    folder = settings.external or os.environ.get("SONARJAX_EXTERNAL_DATA", "")
    if folder:
        made |= {f"external, {name}": partial(read_set, Path(folder) / name) for name in settings.external_sets}
    found = job.map(lambda make: _judged(make(), settings), made, "sets")
    tank, names = _tank_folder(settings), _segmenters(settings)
    tanks = job.map(partial(tank_metrics, tank), (*names, "otsu"), "tank") if tank else {}
    reports = [
        _report({of: each[name] for of, each in found.items()}, {k: tanks[k] for k in (name, "otsu") if tanks})
        for name in names
    ]
    return reports[0] if len(reports) == 1 else combined(reports, mean_and_spread) | {"trainings": reports}


def _segmenters(settings: Settings) -> tuple[str, ...]:
    return (settings.segmenter, *settings.trainings)


def _report(found: dict[str, dict[str, Any]], tanks: dict[str, Any]) -> Report:
    """What one segmenter reached in each set, and in the tank beside Otsu's threshold."""
    ranks = {
        source: _rank_ratio([found[name]["ranked"] for name in found if _is_ranked(name, source)])
        for source in ("judge", "external")
    }
    return {
        "rows": [{"set": of} | {k: v for k, v in row.items() if k != "ranked"} for of, row in found.items()],
        "rank_ratio": {k: v for k, v in ranks.items() if v is not None},
        "tank": [{"segmenter": name} | row for name, row in tanks.items()],
    }


def _tank_folder(settings: Settings) -> Path | None:
    real = os.environ.get("SONARJAX_REAL_DATA", "")
    named = settings.tank or (str(Path(real) / "watertank") if real else "")
    return Path(named) if named else None


def _is_ranked(name: str, source: str) -> bool:
    return name in {f"{source}, {kind}" for kind in RANKED}


def _judged(judged: OutsideSet, settings: Settings) -> dict[str, dict[str, Any]]:
    """What each segmenter reaches, by name."""
    frames = judged.frames[:: settings.every]
    found = {name: _verdict(judged, frames, name, settings.rule_of) for name in (*_segmenters(settings), "none")}
    own = np.array([frame.is_target for frame in frames])
    return {
        name: _summary(ours, own) | _against(ours, found["none"], own) | {"ranked": _ranked(ours, own)}
        for name, ours in found.items()
    }


def _verdict(judged: OutsideSet, frames: Sequence[OutsideFrame], name: str, rule_of: str) -> Verdict:
    """A recognizer for each sonar; a frame that ends in an error scores nothing.

    Raises SonarjaxError for a segmenter with neither a rule nor a threshold.
    """
    segmenter = loaded(name)
    if rule_of and segmenter.rule is None:
        segmenter = replace(segmenter, rule=loaded(rule_of).rule)
    threshold = None if segmenter.rule else threshold_of(name)
    groups: dict[int, list[int]] = defaultdict(list)
    for k, frame in enumerate(frames):
        groups[id(frame.sonar)].append(k)
    score, error, std = (np.full(len(frames), np.nan) for _ in range(3))
    identified = np.zeros(len(frames), bool)
    progress = tqdm(total=len(frames), desc=f"{judged.name}, {name}", unit="frame", leave=False, disable=None)
    for members in groups.values():
        sonar = frames[members[0]].sonar
        recognizer = sj.Recognizer(judged.target, sonar, segmenter=segmenter, engine=engine())
        for k in members:
            progress.update()
            try:
                result = recognizer(frames[k].image, threshold=threshold)
            except (sj.SonarjaxError, ValueError, FloatingPointError):
                continue  # counted: its score stays NaN
            if not np.isfinite([result.score, result.yaw]).all():
                continue
            score[k], identified[k] = result.score, result.identified
            error[k] = yaw_error_deg(result.yaw, frames[k].yaw)
            std[k] = np.degrees(np.nan if result.yaw_std is None else result.yaw_std)
    progress.close()
    return Verdict(score, identified, error, std)


def _summary(found: Verdict, own: np.ndarray) -> dict[str, Any]:
    """Shares of right frames and of what they are made of, yaw errors of targets, and what the error bars cover."""
    right = np.where(own, found.identified & (found.error_deg <= RIGHT_DEG), ~found.identified)
    right &= np.isfinite(found.score)  # an error is not a refusal
    error, std = found.error_deg[own], found.std_deg[own]
    near = error <= ASTRAY_DEG
    return {
        "frames": len(own),
        "right": float(right.mean()),
        "identified": float(found.identified[own].mean()),
        "refused": float((~found.identified & np.isfinite(found.score))[~own].mean()),
        "yaw_median": float(np.nanmedian(error)),
        "yaw_p95": float(np.nanpercentile(error, 95)),
        "astray": float((~near).mean()),
        "within_1": float((error <= std)[near].mean()),
        "within_2": float((error <= 2 * std)[near].mean()),
        "errors": int(np.isnan(found.score).sum()),
    }


def _against(ours: Verdict, plain: Verdict, own: np.ndarray) -> dict[str, float]:
    """AUC of identification, and by how much it exceeds that of the raw frame: its value, and a bootstrap's 2.5 %."""
    scores = [np.nan_to_num(found.score, nan=-np.inf) for found in (ours, plain)]
    areas = [area(score, own) for score in scores]
    rng, gaps = np.random.default_rng(0), []
    targets, others = np.flatnonzero(own), np.flatnonzero(~own)
    for _ in range(RESAMPLED):
        drawn = np.concatenate([rng.choice(targets, len(targets)), rng.choice(others, len(others))])
        one, other = (area(score[drawn], own[drawn]) for score in scores)
        gaps.append(one - other)
    return {"auc": areas[0], "auc_gap": areas[0] - areas[1], "auc_gap_low": float(np.percentile(gaps, 2.5))}


def _ranked(found: Verdict, own: np.ndarray) -> list[list[float]]:
    """`yaw_std` and error [deg] of the targets whose yaw is not another one altogether."""
    near = own & (found.error_deg <= ASTRAY_DEG)
    return [[float(v) for v in values[near]] for values in (found.std_deg, found.error_deg)]


def _rank_ratio(sets: Sequence[list[list[float]]]) -> float | None:
    """RMS error of the quarter of frames with the largest `yaw_std` over that of the quarter with the smallest."""
    if not sets:
        return None
    std, error = np.concatenate([np.asarray(one, float) for one in sets], axis=1)
    order, quarter = np.argsort(std), max(len(std) // 4, 1)
    low, high = (np.sqrt(np.mean(error[part] ** 2)) for part in (order[:quarter], order[-quarter:]))
    return float(high / low)


def table(report: Report) -> str:
    """The sets, what `yaw_std` says of frames beside one another, and the tank."""
    parts = [columns(report["rows"], HEADS)]
    for source, ratio in report["rank_ratio"].items():
        quarters = "RMS error, quarter of the largest yaw_std over quarter of the smallest"
        parts.append(f"{source}: {quarters}: {formatted(ratio, '.2f')}")
    if report["tank"]:
        parts.append(columns(report["tank"], TANK_HEADS))
    return "\n\n".join(parts)


if __name__ == "__main__":
    smoke = {"judged": ("offset",), "own": (), "external_sets": ("offset",), "every": 7, "step_deg": 90}
    launch(run, Settings, table, smoke=smoke)
