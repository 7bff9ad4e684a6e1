"""Which of 24 objects is it? Names, yaws and refusals on drawn devices and on the independent judge.

python -m experiments.catalog [--preset smoke] [--help]

The list (experiments/common/catalogue.py) was fixed before the first run, near-duplicates and all. `drawn devices` are
of the simulator's family at severity 1, as in `reproduce_paper`. The judge renders with Embree and a sensor model of
its own. Nothing was tuned on any of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

import sonarjax as sj
from experiments.common.catalogue import Entry, catalogue, strangers
from experiments.common.drawn_device import draw_device
from experiments.common.engine import engine
from experiments.common.frames import TILTS_DEG, observed, sonar_for
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns
from experiments.common.progress import Progress
from experiments.common.runs import Job

STREAM = 7300
"""Added to numbers of keys: apart from those of other experiments."""
DRAWN, JUDGE = "drawn devices", "the judge"
HEADS = {
    "frames_of": "frames of", "count": "frames", "top_1": "object right", "top_1_std": "± std",
    "alike": "right, or its near-duplicate", "identified": "right and identified", "strangers": "frames of others",
    "refused": "of these refused", "yaw_median": "yaw, median [°]", "yaw_p95": "yaw, 95 % [°]",
}  # fmt: skip

SMOKE = {"frames": 1, "of_strangers": 1, "objects": 2, "strangers": 1, "tilts_deg": (20.0,), "segmenter": "none"}


@dataclass(frozen=True)
class Settings:
    """What is shown."""

    frames: int = 2
    """Frames of each object on drawn devices, and on the judge."""
    of_strangers: int = 1
    """Frames of each object that is not in the catalogue, in each set."""
    objects: int = 24
    """Objects of the catalogue, from its beginning."""
    strangers: int = 8
    """Objects that are not in it, from the beginning of their list."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1, in turn."""


class Shown(NamedTuple):
    """One frame and its truth."""

    name: str
    entry: Entry
    image: np.ndarray
    yaw: float
    tilt_deg: float


def run(settings: Settings, job: Job) -> Report:
    """Rows of the sets, their confusion matrices (true, found) and the pairs that were confused."""
    known = dict(list(catalogue().items())[: settings.objects])
    made: dict[float, sj.Recognizer] = {}
    segmenter = sj.load_segmenter(settings.segmenter)

    def recognizer(tilt_deg: float) -> sj.Recognizer:
        if tilt_deg not in made:
            meshes = {name: entry.mesh for name, entry in known.items()}
            made[tilt_deg] = sj.Recognizer(meshes, sonar_for(tilt_deg), segmenter=segmenter, engine=engine())
        return made[tilt_deg]

    found = {}
    for name in (DRAWN, JUDGE):
        try:
            measure = partial(_measure, settings, job.seed, known, recognizer)
            found |= job.map(measure, {name: name}, "set")
        except Skipped as error:
            print(f"left out: {error}")
    order = list(known)
    names = sorted(known, key=lambda name: order.index(known[name].like or name))  # what is alike, side by side
    groups = {entry.like for entry in known.values()} - {""}
    return {
        "objects": names,
        "alike": [[name for name in names if group in (name, known[name].like)] for group in sorted(groups)],
        "rows": [_row(name, one, known) for name, one in found.items()],
        "confusion": {name: _confusion(one["known"], names).tolist() for name, one in found.items()},
        "per_frame": found,
    }


def _measure(
    settings: Settings, seed: int, known: dict[str, Entry], recognizer: Callable[[float], sj.Recognizer], source: str
) -> dict[str, list[dict[str, Any]]]:
    """What was found in each frame of a set, of the catalogue's objects and of others."""
    shows = _judged if source == JUDGE else _drawn
    parts = {
        "known": (known, settings.frames, 0),
        "others": (dict(list(strangers().items())[: settings.strangers]), settings.of_strangers, 100_000),
    }
    found: dict[str, list[dict[str, Any]]] = {}
    with Progress(source, sum(each * len(entries) for entries, each, _ in parts.values()), unit="frame") as progress:
        for part, (entries, each, first) in parts.items():
            found[part] = []
            for one in shows(entries, each, settings.tilts_deg, seed, first):
                with progress.part(one.name):
                    found[part].append(_look(one, recognizer))
    return found


def _drawn(
    entries: dict[str, Entry], each: int, tilts_deg: tuple[float, ...], seed: int, first: int
) -> Iterator[Shown]:
    """Frames of our simulator."""
    key = jax.random.fold_in(jax.random.key(seed), STREAM)
    for number, (name, entry, tilt) in enumerate(_cases(entries, each, tilts_deg)):
        part = jax.random.fold_in(key, first + number)
        device = draw_device(entry.mesh, tilt, (1.0, 1.0), key=part)
        image, _ = observed(device.mesh, device.start, device.sonar, device.model, key=jax.random.fold_in(part, 5))
        yield Shown(name, entry, np.asarray(image), float(device.start.yaw), tilt)


def _judged(
    entries: dict[str, Entry], each: int, tilts_deg: tuple[float, ...], seed: int, first: int
) -> Iterator[Shown]:
    """Frames of the judge. Raises Skipped where Embree is not installed."""
    try:
        from experiments.judge.shown import shown
    except ImportError as error:
        raise Skipped(f"the judge needs Embree: pip install 'sonarjax[bench]' ({error})") from error
    for number, (name, entry, tilt) in enumerate(_cases(entries, each, tilts_deg)):
        frame = shown(entry.mesh, tilt, seed=seed, number=first + number)
        yield Shown(name, entry, frame.image, frame.yaw, tilt)


def _cases(entries: dict[str, Entry], each: int, tilts_deg: tuple[float, ...]) -> Iterator[tuple[str, Entry, float]]:
    for turn in range(each):
        for k, (name, entry) in enumerate(entries.items()):
            yield name, entry, tilts_deg[(turn + k) % len(tilts_deg)]


def _look(one: Shown, recognizer: Callable[[float], sj.Recognizer]) -> dict[str, Any]:
    result = recognizer(one.tilt_deg)(one.image)
    return {
        "true": one.name,
        "found": result.target,
        "runner_up": result.runner_up,
        "margin": result.margin,
        "score": result.score,
        "identified": result.identified,
        "yaw_error_deg": _yaw_error_deg(result.yaw, one.yaw, one.entry.folds),
    }


def _yaw_error_deg(yaw: float, true: float, folds: int) -> float | None:
    """The least error [deg] over the turns that leave the object as it is; None for a body of revolution."""
    if folds == 0:
        return None
    turn = 2 * math.pi / folds
    return abs(math.degrees((yaw - true + turn / 2) % turn - turn / 2))


def _row(source: str, found: dict[str, list[dict[str, Any]]], known: dict[str, Entry]) -> dict[str, Any]:
    frames, others = found["known"], found["others"]
    family = {name: entry.like or name for name, entry in known.items()}
    right = np.array([one["true"] == one["found"] for one in frames])
    alike = np.array([family[one["true"]] == family[one["found"]] for one in frames])
    errors = [
        one["yaw_error_deg"] for one in frames if one["true"] == one["found"] and one["yaw_error_deg"] is not None
    ]
    share = float(right.mean())
    return {
        "frames_of": source,
        "count": len(frames),
        "top_1": share,
        "top_1_std": math.sqrt(share * (1 - share) / len(frames)),
        "alike": float(alike.mean()),
        "identified": float(np.mean([ok and one["identified"] for ok, one in zip(right, frames, strict=True)])),
        "refused": float(np.mean([not one["identified"] for one in others])) if others else None,
        "strangers": len(others),
        "yaw_median": float(np.median(errors)) if errors else None,
        "yaw_p95": float(np.quantile(errors, 0.95)) if errors else None,
    }


def _confusion(frames: list[dict[str, Any]], names: list[str]) -> np.ndarray:
    """Counts (true, found)."""
    counts = np.zeros((len(names), len(names)), int)
    for one in frames:
        counts[names.index(one["true"]), names.index(one["found"])] += 1
    return counts


def table(report: Report) -> str:
    """The sets, and which objects were taken for which."""
    parts = [columns(report["rows"], HEADS)]
    for source, counts in report["confusion"].items():
        names = report["objects"]
        wrong = [
            f"{names[i]} → {names[j]} ({n})" for i, row in enumerate(counts) for j, n in enumerate(row) if n and i != j
        ]
        parts.append(f"{source}, taken for another: {'; '.join(wrong) or 'none'}")
    return "\n\n".join(parts)


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
