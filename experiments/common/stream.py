"""Streams of frames and what follows an object through them: folders that fill, recordings, simulated turns."""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import observed
from experiments.common.segmenters import loaded
from sonarjax.io import Frame, SonarjaxError, iter_frames
from sonarjax.io.load import ENDINGS
from sonarjax.plot import MARK_COLOR
from sonarjax.recognition import Hypothesis, Recognition
from sonarjax.recognize import refine_on_frame
from sonarjax.refine import MAP_REFINEMENT
from sonarjax.sensor import SensorModel

WAYS = ("recognize", "track map", "track frame", "track belief")
"""How a stream is gone through: each frame anew; refined from the last pose on the map or on the frame itself; or each
frame anew as part of a belief (`sj.Tracker`)."""
POLL_S = 0.5
Named = tuple[str, Frame | SonarjaxError]
"""What a frame is called, and the frame, or the error that says why it cannot be read."""


def frames_of(source: str, follow: float = 0.0) -> Iterator[Named]:
    """Each frame of a folder or a file in order; a folder's new files too, until none has come for `follow` [s]."""
    for path in folder_files(Path(source), follow) if os.path.isdir(source) else [source]:
        try:
            for frame in iter_frames(path):
                yield frame.source, frame
        except SonarjaxError as error:
            yield str(path), error


def folder_files(folder: Path, follow: float) -> Iterator[Path]:
    """A folder's files of frames in natural order (2 before 10), then those that come until none has for `follow` [s].

    While a folder is followed, a file is taken once it no longer changes: it may still be being written.
    """
    done, before, last = set[Path](), dict[Path, Any](), time.monotonic()
    while True:
        now = {path: state for path in folder.iterdir() if path.suffix.lower() in ENDINGS and (state := _state(path))}
        ready = [path for path in now if path not in done and (not follow or before.get(path) == now[path])]
        for path in sorted(ready, key=natural):
            done.add(path)
            yield path
        before, last = now, time.monotonic() if ready else last
        if not ready and time.monotonic() - last >= follow:
            return
        time.sleep(min(POLL_S, follow))  # after a file was taken too: within no time none changes


def _state(path: Path) -> tuple[int, int] | None:
    with suppress(OSError):  # it may have gone again
        state = path.stat()
        return state.st_size, state.st_mtime_ns
    return None


def natural(path: Path) -> list[tuple[int, str]]:
    """A key that sorts file names with numbers in them as people do."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", path.name)]


def turning(
    mesh: sj.Mesh, sonar: sj.Sonar, model: SensorModel, poses: list[sj.Pose], key: jax.Array
) -> Iterator[Named]:
    """Simulated frames of an object at `poses` [m, rad]; `meta` holds the true yaw [deg]."""
    for k, pose in enumerate(poses):
        image = np.asarray(observed(mesh, pose, sonar, model, key=jax.random.fold_in(key, k))[0])
        name = f"simulated:{k}"
        yield name, Frame(image, None, name, name, meta={"true_yaw_deg": math.degrees(pose.yaw)})


def seconds_of(meta: dict[str, Any]) -> float | None:
    """When a frame was taken [s], where its file says so."""
    if "time_us" in meta:
        return float(meta["time_us"]) * 1e-6
    with suppress(ValueError, KeyError):
        return datetime.fromisoformat(meta["time"]).timestamp()
    return None


class Finder:
    """Recognizes frame after frame, and where its way is to track, refines from the last pose instead."""

    def __init__(
        self, mesh: sj.Mesh, sonar: sj.Sonar, segmenter: str, way: str, threshold: float | None = None
    ) -> None:
        """`way` is one of WAYS; `threshold` is that of recognition, if not the segmenter's own.

        Raises SonarjaxError for another way.
        """
        if way not in WAYS:
            raise SonarjaxError(f"way: expected one of {', '.join(WAYS)}, got {way!r}")
        self.mesh, self.sonar, self.way, self.threshold = mesh, sonar, way, threshold
        self.recognizer = sj.Recognizer(mesh, sonar, segmenter=loaded(segmenter), engine=engine())
        self.tracked_on = loaded("none") if way == WAYS[2] else self.recognizer.segmenter
        self.belief = sj.Tracker(self.recognizer, sj.Turning(), threshold=threshold)
        self.last: sj.Pose | None = None
        self.inflation = 1.0  # of error bars, by the last recognition

    def __call__(self, frame: Frame) -> tuple[Recognition, bool]:
        """What a frame shows, and whether it was tracked from the last one.

        Raises SonarjaxError when it does not fit the sonar; what was tracked is kept.
        """
        if self.way == WAYS[3]:
            return self._believed(frame)
        tracked = None if self.last is None or self.way == WAYS[0] else self._tracked(frame, self.last)
        found = tracked
        if found is None:
            found = self.recognizer(frame.image, frame.mask, threshold=self.threshold)
            self.inflation = _inflation(found)
        self.last = sj.Pose(found.x, found.y, found.yaw) if found.identified else None
        return found, tracked is not None

    def _believed(self, frame: Frame) -> tuple[Recognition, bool]:
        """What a frame shows, with the belief's pose and hypotheses in place of the frame's own."""
        try:
            found = self.belief.recognize(frame.image, frame.mask)
        except SonarjaxError:
            self.belief.take(None)
            raise
        after = self.belief.take(found)
        if not after.modes:
            return found, False
        own = tuple(Hypothesis(m.yaw, m.probability, m.yaw_std, True, m.x, m.y) for m in after.modes)
        best, followed = after.best, self.last is not None
        self.last = sj.Pose(best.x, best.y, best.yaw)
        pose = {"yaw": best.yaw, "yaw_std": best.yaw_std, "x": best.x, "y": best.y}
        return replace(found, **pose, hypotheses=own), followed

    def _tracked(self, frame: Frame, last: sj.Pose) -> Recognition | None:
        """The pose refined from the last one; None when its template correlates less than the threshold.

        Raises SonarjaxError if there is no threshold.
        """
        mesh, sonar, on = self.mesh, self.sonar, self.tracked_on
        limit = least_correlation(on, self.threshold)
        semantic = on.semantic(frame.image, frame.mask, engine())
        how: dict[str, Any] = {"config": MAP_REFINEMENT, "engine": engine()}
        estimate = sj.refine_yaw(semantic, mesh, sonar, last, mask=frame.mask, **how)
        score = float(estimate.score)
        if not score >= limit:
            return None
        estimate = refine_on_frame(frame.image, mesh, sonar, estimate.pose, frame.mask, **how)
        yaw, x, y, refined = (float(v) for v in (estimate.yaw, estimate.x, estimate.y, estimate.score))
        std, settled = self.inflation * float(estimate.yaw_std), bool(estimate.converged)
        return Recognition(
            identified=True, target=next(iter(self.recognizer.targets)), runner_up=None, margin=None, score=score,
            score_bank=math.nan, score_refined=refined, threshold=limit, converged=settled,
            yaw_bin=math.nan, yaw=yaw, yaw_std=std, x=x, y=y, scores_by_yaw=np.empty(0),
            hypotheses=(Hypothesis(yaw, refined, std, settled),), segmenter=on.name, semantic=np.asarray(semantic),
        )  # fmt: skip


def least_correlation(segmenter: sj.Segmenter, threshold: float | None) -> float:
    """What a tracked template must correlate with the map: the `threshold` of recognition, or the segmenter's own.

    Where a rule recognizes, the threshold of recognition is a probability, and only the segmenter's own serves. Raises
    SonarjaxError where it has none.
    """
    limit = segmenter.threshold if threshold is None or segmenter.rule is not None else threshold
    if limit is None:
        raise SonarjaxError(f"threshold: tracking needs one, and the segmenter {segmenter.name} has none of its own")
    return limit


def _inflation(found: Recognition) -> float:
    """What the curvature's standard deviation was multiplied by: what is tracked from here on is as uncertain."""
    curvature = 0.0 if found.evidence is None else found.evidence["curvature_std"]
    if found.yaw_std is None or not math.isfinite(found.yaw_std) or curvature <= 0:
        return 1.0
    return found.yaw_std / curvature


def taken_up(path: Path) -> list[dict[str, Any]]:
    """The records that a cut-off run left, but for a line that it did not end."""
    records = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            records.append(json.loads(line))
        except ValueError:
            continue
    return records


def picture(arrays: dict[str, np.ndarray]) -> Figure:
    """Yaw [deg] with its standard deviation and the score, over time [s] or frame number; unidentified ones hollow."""
    timed = bool(np.isfinite(arrays["time_s"]).all())
    at = arrays["time_s"] - arrays["time_s"][0] if timed else arrays["number"]
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    if np.isfinite(arrays["true_yaw_deg"]).any():
        above.plot(at, broken(arrays["true_yaw_deg"]), color="0.6", label="truth")
        above.legend(frameon=False)
    std = np.nan_to_num(arrays["yaw_std_deg"])
    above.errorbar(at, arrays["yaw_deg"], std, fmt="none", ecolor="0.6", elinewidth=1)
    filled = arrays["identified"] > 0
    for panel, values in ((above, arrays["yaw_deg"]), (below, arrays["score"])):
        panel.plot(at[filled], values[filled], "o", color="#0072B2", markersize=4)
        panel.plot(at[~filled], values[~filled], "o", color="#0072B2", markersize=4, markerfacecolor="none")
    below.plot(at, arrays["threshold"], "--", color=MARK_COLOR, linewidth=1, label="threshold")
    below.legend(frameon=False)
    above.set(ylabel="yaw [°]", ylim=(0, 360), yticks=range(0, 361, 90))
    below.set(ylabel="correlation", xlabel="time [s]" if timed else "frame number")
    return figure


def broken(degrees: np.ndarray) -> np.ndarray:
    """Angles [deg] of a line, with NaN where it would cross the picture because a turn begins anew."""
    return np.where(np.abs(np.diff(degrees, prepend=degrees[0])) > 180.0, np.nan, degrees)
