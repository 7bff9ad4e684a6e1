"""What is a sequence worth beside a single frame: many views of one object, from one place or several, and real frames?

python -m experiments.track_views [--data DIR] [--preset smoke] [--help]

Drawn devices look at a standing object; speckle differs from frame to frame, the device's look and its small errors of
tilt and height do not. After n views the belief should err by no more than 1.2·√(RMS(1)²/n + floor²), with RMS(1) of
single frames (or, stricter, of those within 10°), and the floor of what all frames of a view err alike, which no number
of them averages out: it is measured (one-way analysis of variance of the frames' own errors). Seen from known places
all around, it does average out. A pile that is the same after half a turn must keep both its yaws. With the real frames
of `real_turntable` (--data, or SONARJAX_REAL_DATA), its pipe's turn is followed at a rate that is not told. Nothing is
chosen on the drawn frames; docs/track.md names two choices that were made after a first run on the real ones.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments import real_turntable
from experiments.common.drawn_device import DrawnDevice, draw_device
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, sonar_for
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.sequences import TILT_DEG, Replayed, kept, recognized, taken_up
from experiments.symmetric_objects import brick_pair
from sonarjax.refine import in_view
from sonarjax.track import Mode, modes_of
from sonarjax.track.sequence import joined

VIEWS = (1, 2, 4, 8, 16)
"""Numbers of views that are compared."""
OBJECTS = {"target": sj.objects.target, "other pile": sj.objects.non_target}
SEVERITIES = (0.7, 1.3)
"""Least and largest severity of the devices [1]."""
ASTRAY_DEG = 10.0
"""Errors beyond it are of another hypothesis [deg]."""
ALLOWED = 1.2
"""By how much the error may exceed what averaging would leave [1]."""
LEFT = 0.05
"""Least probability of a yaw that is still held possible [1]."""
HEADS = {"name": "views", "count": "n", "cases": "cases", "rms": "yaw, RMS [°]", "bar": "bar [°]",
         "strict": "without astray [°]", "median": "median [°]", "std": "yaw_std, mean [°]", "within_1": "within 1 std",
         "place": "place, RMS [cm]", "astray": "beyond 10°"}  # fmt: skip
REAL_HEADS = {"way": "real frames by", "frames": "frames", "within": "within 10°", "median": "yaw, median [°]",
              "p90": "90 % [°]", "most": "largest [°]"}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is drawn and run."""

    sequences: int = 24
    """Standing objects, each with its device."""
    around: int = 12
    """Objects that are looked at from all around."""
    symmetric: int = 8
    """Sequences of a pile that is the same after half a turn."""
    views: int = 16
    """Frames of each."""
    segmenter: str = "pix2pix"
    """The segmenter."""
    real: bool = True
    """Whether the real frames are followed too, where they are."""
    data: str = ""
    """Folder of the real pipe; empty for `pipe` in that of SONARJAX_REAL_DATA."""
    frames: int = 0
    """Number of real frames, evenly spread; 0 for all."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each number of views, from one place and from around; what becomes of symmetry; the real turn."""
    measure = partial(_drawn, settings, job.seed)
    standing = job.map(lambda k: measure(k, list(OBJECTS)[k % 2]), _numbered(settings.sequences), "standing")
    around = job.map(lambda k: measure(k, list(OBJECTS)[k % 2], True), _numbered(settings.around, 1000), "around")
    alike = job.map(lambda k: measure(k, "two-fold pile"), _numbered(settings.symmetric, 2000), "symmetric")
    shared = floor_deg(list(standing.values()))
    rows = [
        *view_rows("one place", list(standing.values()), shared),
        *view_rows("around", list(around.values()), shared),
    ]
    report = {"rows": rows, "floor_deg": shared, "symmetric": symmetry(list(alike.values()))}
    report["update_ms"] = update_ms([*standing.values(), *around.values()])
    return report | {"real": _real(settings, job) if settings.real else []}


def _numbered(count: int, first: int = 0) -> Mapping[str, int]:
    return {str(k): k for k in range(first, first + count)}


def _drawn(settings: Settings, seed: int, number: int, name: str, around: bool = False) -> list[dict[str, Any]]:
    """What is recognized in each frame, with the sonar's pose in the common frame and the truth in it."""
    key = jax.random.fold_in(jax.random.key(seed), 9000 + number)
    mesh = brick_pair() if name == "two-fold pile" else OBJECTS[name]()
    device = draw_device(mesh, TILT_DEG, SEVERITIES, key=key)
    recognizer = sj.Recognizer(mesh, sonar_for(TILT_DEG), segmenter=settings.segmenter, engine=engine())
    places = _around(device, settings.views, key=key) if around else [np.zeros(3)] * settings.views
    start = (float(device.start.yaw), float(device.start.x), float(device.start.y))
    rows = recognized(device, recognizer, [in_view(device.start, at) for at in places], key=key)
    return [row | {"true": start, "sonar": at.tolist()} for row, at in zip(rows, places, strict=True)]


def _around(device: DrawnDevice, count: int, *, key: jax.Array) -> list[np.ndarray]:
    """Known places x, y [m] and headings [rad] of the sonar: the object stands near the middle of each view."""
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 5), (count, 4), minval=-1), float)
    found = []
    for k, (turn, aside, ahead, noise) in enumerate(draws):
        heading = 2 * math.pi * k / count + 0.2 * turn + 0.1 * noise
        ground = GROUND_RANGE_M[TILT_DEG] + 0.1 * ahead
        left = 0.12 * aside
        x = float(device.start.x) - ground * math.cos(heading) + left * math.sin(heading)
        y = float(device.start.y) - ground * math.sin(heading) - left * math.cos(heading)
        found.append(np.array([x, y, heading]))
    return found


def followed(rows: Sequence[dict[str, Any]], motion: Any = sj.Standing()) -> sj.Tracker:  # noqa: B008
    """A tracker that has taken all of the frames."""
    tracker = _tracker(motion)
    for row in rows:
        tracker.take(taken_up(row), sonar_pose=sj.Pose(*row["sonar"]))
    return tracker


def _tracker(motion: Any) -> sj.Tracker:
    """A tracker of frames that were recognized before."""
    return sj.Tracker(Replayed(), motion)


def floor_deg(sequences: Sequence[list[dict[str, Any]]]) -> float:
    """Standard deviation [deg] of what all frames of one view err alike: √(mean² - within²/n).

    Frames that went astray are left out.
    """
    means, within = [], []
    for rows in sequences:
        error = np.array([_off_deg(row["yaw"], row["true"][0]) for row in rows])
        error = error[np.abs(error) <= ASTRAY_DEG]
        if len(error) > 1:
            means.append(error.mean() ** 2)
            within.append(error.var(ddof=1) / len(error))
    return math.sqrt(max(float(np.mean(means) - np.mean(within)), 0.0)) if means else math.nan


def _off_deg(yaw: float, true: float) -> float:
    return (math.degrees(yaw - true) + 180) % 360 - 180


def view_rows(name: str, sequences: Sequence[list[dict[str, Any]]], floor: float) -> list[dict[str, Any]]:
    """Errors after n views: each sequence is cut into as many runs of n as it has."""
    rows: list[dict[str, Any]] = []
    for count in VIEWS:
        error, std, place = [], [], []
        for frames in sequences:
            for first in range(0, len(frames) - count + 1, count):
                best = followed(frames[first : first + count])
                mode = _last(best)
                true = frames[first]["true"]
                error.append(abs(_off_deg(mode.yaw, true[0])))
                std.append(math.degrees(mode.yaw_std))
                place.append(math.hypot(mode.x - true[1], mode.y - true[2]))
        if not error:
            continue
        off, rms = np.array(error), float(np.sqrt(np.mean(np.square(error))))
        if not rows:
            alone, near = rms, float(np.sqrt(np.mean(np.square(off[off <= ASTRAY_DEG]))))
        rows.append(
            {
                "name": name, "count": count, "cases": len(off), "rms": rms, "median": float(np.median(off)),
                "bar": ALLOWED * math.sqrt(alone**2 / count + floor**2),
                "strict": ALLOWED * math.sqrt(near**2 / count + floor**2), "std": float(np.mean(std)),
                "within_1": float((off <= np.array(std)).mean()), "astray": float((off > ASTRAY_DEG).mean()),
                "place": 100 * float(np.sqrt(np.mean(np.square(place)))),
            }
        )  # fmt: skip
    return rows


def _last(tracker: sj.Tracker) -> Mode:
    return modes_of(tracker.belief)[0]


def symmetry(sequences: Sequence[list[dict[str, Any]]]) -> dict[str, float]:
    """Of a pile that is the same after half a turn: in how many frames both yaws are held possible, and how likely."""
    both, second = [], []
    for rows in sequences:
        tracker = _tracker(sj.Standing())
        for row in rows:
            found = tracker.take(taken_up(row))
            near = [
                sum(m.probability for m in modes_of(found.belief) if abs(_off_deg(m.yaw, true)) <= ASTRAY_DEG)
                for true in (row["true"][0], row["true"][0] + math.pi)
            ]
            both.append(min(near) >= LEFT)
        second.append(min(near))
    if not both:
        return {}
    return {"frames": len(both), "both": float(np.mean(both)), "second": float(np.median(second)),
            "least": float(np.min(second))}  # fmt: skip


def update_ms(sequences: Sequence[list[dict[str, Any]]]) -> dict[str, float]:
    """Time of one update of the belief [ms], after compilation: median and 95 %."""
    taken = []
    for rows in sequences:
        tracker = _tracker(sj.Standing())
        for row in rows:
            found, begun = taken_up(row), time.perf_counter()
            tracker.take(found)
            taken.append(1e3 * (time.perf_counter() - begun))
    warm = taken[len(taken) // 4 :] or [math.nan]
    return {"median": float(np.median(warm)), "p95": float(np.percentile(warm, 95))}


def _real(settings: Settings, job: Job) -> list[dict[str, Any]]:
    """The real pipe's frames in order: each alone, and as a sequence."""
    options = real_turntable.Settings(data=settings.data, frames=settings.frames)
    try:
        data = real_turntable.load(options)
    except Skipped:
        return []
    parts = job.map(partial(_real_frames, settings, data), {"alone": False, "expected": True}, "real frames")
    found = {name: _yaws(parts[name]["rows"]) for name in ("alone",)}
    found |= {
        "filtered, frames alone": parts["alone"]["filtered"],
        "smoothed, frames alone": parts["alone"]["smoothed"],
    }
    found |= {"filtered": parts["expected"]["filtered"], "smoothed": parts["expected"]["smoothed"]}
    errors = {name: real_turntable.errors_deg(np.array(yaws), data.truth)[0] for name, yaws in found.items()}
    arrays = {name.replace(", ", "_").replace(" ", "_"): error for name, error in errors.items()}
    job.arrays("real", **arrays, truth_deg=np.degrees(data.truth))
    return [
        {
            "way": "recognize" if name == "alone" else f"track, {name}", "frames": len(error),
            "within": float((np.abs(error) <= ASTRAY_DEG).mean()), "median": float(np.median(np.abs(error))),
            "p90": float(np.percentile(np.abs(error), 90)), "most": float(np.abs(error).max()),
        }
        for name, error in errors.items()
    ]  # fmt: skip


def _real_frames(settings: Settings, data: real_turntable.Data, expect: bool) -> dict[str, Any]:
    """Yaws of the sequence, the tracker knowing no rate; with `expect` frames are refined from what is expected too."""
    recognizer = sj.Recognizer(data.mesh, data.sonar, segmenter=settings.segmenter, engine=engine())
    tracker = sj.Tracker(recognizer, sj.Turning(), threshold=0.0, expect=expect)
    found = [tracker(image, mask) for image, mask in zip(data.images, data.masks, strict=True)]
    both = {name: joined(found, tracker, name == "smoothed").yaw.tolist() for name in ("filtered", "smoothed")}
    return both | {"rows": [kept(one.recognition) for one in found if one.recognition is not None]}


def _yaws(rows: Sequence[dict[str, Any]]) -> list[float]:
    return [row["yaw"] for row in rows]


def table(report: Report) -> str:
    """Errors after n views, symmetry, time, and the real frames."""
    said = report["symmetric"]
    parts = [columns(report["rows"], HEADS), f"floor: {report['floor_deg']:.2f}°"]
    if said:
        parts.append(
            f"a pile that is the same after half a turn: both yaws held possible in {said['both']:.3f} of "
            f"{said['frames']} frames; after the last, the less likely one has {said['second']:.2f} in the median"
        )
    spent = report["update_ms"]
    parts.append(f"update_ms: {spent['median']:.1f} (95 %: {spent['p95']:.1f})")
    if report["real"]:
        parts.append(columns(report["real"], REAL_HEADS))
    return "\n\n".join(parts)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"sequences": 1, "around": 1, "symmetric": 1, "views": 2, "real": False,
                                        "segmenter": "none"})  # fmt: skip
