"""Recognize a stream of frames in order: a folder, a recording (ARIS, DIDSON, Oculus, a ROS bag) or a simulated turn.

python -m experiments.recognize_stream --source FOLDER --target mine.stl --sonar sonar.toml [--track] [--follow 30]
python -m experiments.recognize_stream [--preset smoke] [--help]

One JSON line a frame goes into the run's folder as soon as it is known, and a stream that was cut off goes on after its
last line; at the end yaw over time is drawn. Without --source a simulated target turns, and every way to go through the
stream is measured against the truth: `recognize`, each frame anew; `track map`, which segments each frame but starts
refining at the last frame's pose; `track frame`, which refines on the frame itself and does without the network; and
`track belief`, which recognizes each frame and weighs its hypotheses by what all frames so far say. Where a template
that was tracked on map or frame correlates less than the threshold, that frame is recognized anew; on the wrong yaw
these two ways stay there as long as it correlates well enough.

The sonar stands still: a vehicle whose tilt or height changes would need a bank for each frame, and is out of scope.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Literal

import jax
import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.runs import Job, code_digest
from experiments.common.scores import target
from experiments.common.stream import WAYS, Finder, Named, frames_of, picture, seconds_of, taken_up, turning
from sonarjax.io import JsonLines, SonarjaxError
from sonarjax.plot import save_figure
from sonarjax.results import SCHEMA, record_of
from sonarjax.sensor import SensorModel

SIMULATED_TILT_DEG = 20.0
ASTRAY_DEG = 10.0
HEADS = {
    "way": "way", "frames": "frames", "unreadable": "unreadable", "identified": "identified", "tracked": "tracked",
    "frames_per_second": "frames/s", "median_ms": "median [ms]", "p95_ms": "95 % [ms]",
    "error_median": "yaw error, median [°]", "error_p95": "95 %", "astray": f"beyond {ASTRAY_DEG:g}°",
}  # fmt: skip
KEPT = ("number", "time_s", "yaw_deg", "yaw_std_deg", "score", "threshold", "x_m", "y_m", "seconds", "identified",
        "tracked", "warm", "true_yaw_deg")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is recognized, and how."""

    source: str = ""
    """Folder of frames, or a file of one or more; without it a turning target is simulated."""
    target: str = ""
    """Mesh of the object to look for, in any format that trimesh reads; needed with a source."""
    sonar: str = ""
    """The sonar and its geometry (sonar.toml); needed with a source, and overrides a file's header."""
    unit_m: float = 0.0
    """Length of the mesh file's unit [m], such as 0.001 for millimetres; 0: the file's own, else metres."""
    segmenter: Literal["pix2pix", "none", "otsu"] = "pix2pix"
    """What makes the map that is matched."""
    threshold: float = math.nan
    """Least score of a recognized target; NaN for the segmenter's own. Where that is a rule's probability, tracking
    asks for the segmenter's own NCC."""
    track: bool = False
    """Refine a source's frames from the last one's pose instead of recognizing each anew."""
    track_on: Literal["map", "frame", "belief"] = "map"
    """What a tracked pose is refined on: the segmenter's map and then the frame, or the frame alone; or a belief that
    all frames so far feed."""
    every: int = 1
    """Take only one of so many frames."""
    limit: int = 0
    """Stop after so many; 0 for all."""
    follow: float = 0.0
    """Wait for new files in the folder, and end so long after the last one [s]."""
    frames: int = 120
    """Frames of the simulated stream."""
    turn_deg: float = 3.0
    """How far the simulated target turns from frame to frame [deg]."""
    severity: float = 1.0
    """Severity of the simulated sensor."""

    def __post_init__(self) -> None:
        """Raise SonarjaxError for arguments that cannot be used together."""
        if self.source and not (self.target and self.sonar):
            raise SonarjaxError("source: expected with it a target (a mesh file) and a sonar (a TOML file)")
        if self.every < 1 or self.frames < 1 or self.limit < 0 or not 0 <= self.follow < math.inf:
            raise SonarjaxError("expected every and frames of 1 or more, limit and follow of 0 or more")
        if self.follow and not os.path.isdir(self.source):
            raise SonarjaxError(f"follow: expected a folder as source, got {self.source!r}")


def run(settings: Settings, job: Job) -> Report:
    """A row for each way through the stream; JSON lines, arrays and a picture of each in the run's folder."""
    ways: Sequence[str] = WAYS
    if settings.source:
        mesh, sonar = sj.Mesh.load(settings.target, settings.unit_m or None), sj.Sonar.from_toml(settings.sonar)
        stream: Callable[[], Iterable[Named]] = partial(frames_of, settings.source, settings.follow)
        ways = (f"track {settings.track_on}",) if settings.track else WAYS[:1]
    else:
        mesh, sonar = target(), sonar_for(SIMULATED_TILT_DEG)
        model, poses = SensorModel.nominal(settings.severity), _turn(settings, job)
        stream = partial(iter, list(turning(mesh, sonar, model, poses, job.key)))
    rows = job.map(partial(_through, stream, mesh, sonar, settings, job), ways, "stream")
    return {"rows": [{"way": way} | row for way, row in rows.items()]}


def _turn(settings: Settings, job: Job) -> list[sj.Pose]:
    """Where the simulated target stands: in one place, turned a little further in each frame."""
    start = float(jax.random.uniform(jax.random.fold_in(job.key, 1), maxval=2 * math.pi))
    yaws = (start + k * math.radians(settings.turn_deg) for k in range(settings.frames))
    return [sj.Pose(GROUND_RANGE_M[SIMULATED_TILT_DEG], 0.0, yaw % (2 * math.pi)) for yaw in yaws]


def _through(
    stream: Callable[[], Iterable[Named]], mesh: sj.Mesh, sonar: sj.Sonar, settings: Settings, job: Job, way: str
) -> dict[str, Any]:
    """Go through the stream from where a cut-off run ended, and sum it up. Raises SonarjaxError if nothing was read."""
    name = way.replace(" ", "_")
    unfinished = job.folder / f"{name}-{code_digest()}.jsonl"
    records = taken_up(unfinished)
    known, seen = {record["frame"] for record in records}, set[bool]()
    finder = Finder(
        mesh, sonar, settings.segmenter, way, None if math.isnan(settings.threshold) else settings.threshold
    )
    last = settings.limit * settings.every or None
    with JsonLines(unfinished) as lines, tqdm(desc=way, unit="frame", initial=len(known)) as bar:
        for number, (label, frame) in islice(enumerate(stream()), 0, last, settings.every):
            if label not in known:
                records.append(_record(finder, label, frame, seen) | {"number": number})
                lines.write(records[-1])
                bar.update()
    unfinished.replace(job.folder / f"{name}.jsonl")
    found = [record for record in records if "error" not in record]
    if not found:
        raise SonarjaxError(f"{settings.source}: none of its frames could be recognized")
    arrays = {key: np.array([np.nan if r.get(key) is None else r[key] for r in found], float) for key in KEPT}
    job.arrays(name, **arrays)
    save_figure(picture(arrays), job.folder / f"{name}.png")
    return {"frames": len(found), "unreadable": len(records) - len(found)} | summed_up(arrays)


def _record(finder: Finder, label: str, frame: Any, seen: set[bool]) -> dict[str, Any]:
    """The JSON record of one frame, or of the error that it met; that is also one line on the terminal."""
    try:
        if isinstance(frame, SonarjaxError):
            raise frame
        started = time.perf_counter()
        result, tracked = finder(frame)
        seconds = time.perf_counter() - started
    except SonarjaxError as error:
        message = " ".join(str(error).split())
        tqdm.write(f"recognize_stream: {message if label in message else f'{label}: {message}'}", file=sys.stderr)
        return {"frame": label, "error": message, "schema": SCHEMA}
    # The first recognized and the first tracked frame compile: `warm` is what speed is judged by.
    warm = tracked in seen
    seen.add(tracked)
    more = {"tracked": tracked, "warm": warm, "time_s": seconds_of(frame.meta)}
    return record_of(result, label, seconds) | more | {"true_yaw_deg": frame.meta.get("true_yaw_deg")}


def summed_up(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Shares, speed (reading a file not counted) and, where the truth is known, yaw errors [deg]."""
    warm = arrays["seconds"][arrays["warm"] > 0]
    error = yaw_error_deg(*(np.radians(arrays[key]) for key in ("yaw_deg", "true_yaw_deg")))
    known, timed = bool(np.isfinite(error).all()), warm.size > 0
    return {
        "identified": float(arrays["identified"].mean()),
        "tracked": float(arrays["tracked"].mean()),
        "frames_per_second": float(1 / np.median(warm)) if timed else None,
        "median_ms": float(1e3 * np.median(warm)) if timed else None,
        "p95_ms": float(1e3 * np.percentile(warm, 95)) if timed else None,
        "error_median": float(np.median(error)) if known else None,
        "error_p95": float(np.percentile(error, 95)) if known else None,
        "astray": float((error > ASTRAY_DEG).mean()) if known else None,
    }


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"frames": 4, "segmenter": "none"})
