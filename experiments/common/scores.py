"""Recognize many frames and judge what was found: the metrics that most experiments report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import rankdata
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import TestFrame, sonar_for
from experiments.common.metrics import WITHIN_BIN_DEG, accuracy, best_accuracy, summary_deg, yaw_error_deg
from experiments.common.recognizers import recognizers, unrefined
from experiments.common.segmenters import TILES, TRUTH, loaded, map_of, threshold_of
from experiments.common.sets import target


class Found(NamedTuple):
    """What a recognizer made of frames; arrays (frame,)."""

    score: np.ndarray
    """Largest correlation over the bank (eq. 5) [1]."""
    decided: np.ndarray
    """Whether the recognizer took it for the target: by its rule where there is one, else by eq. 5."""
    is_target: np.ndarray
    """Whether the frame shows the target."""
    bin_error_deg: np.ndarray
    """Error of the best template's yaw [deg]."""
    error_deg: np.ndarray
    """Error of the yaw reported [deg]: refined where that was asked for."""
    yaw_std_deg: np.ndarray
    """Standard deviation reported with it [deg], NaN without refinement."""
    seconds: np.ndarray
    """Time that segmentation and recognition took [s]."""
    threshold: float
    """Least score of an identified target."""
    results: list[sj.Recognition]
    """All that was found, frame by frame."""

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays (frame,) by name, to be kept for figures."""
        return {name: value for name, value in self._asdict().items() if isinstance(value, np.ndarray)}


def recognize_all(
    frames: Sequence[TestFrame],
    segmenter: str,
    *,
    refine: bool = False,
    mesh: sj.Mesh | None = None,
    sonar_of: Callable[[float], sj.Sonar] = sonar_for,
) -> Found:
    """Recognize the target (or `mesh`) in each frame, with the sonar that `sonar_of` gives for its tilt [deg].

    `segmenter` is one of `common.segmenters`. With `refine`, one that has a rule decides by it; of the others only
    frames of the target are refined: yaw is judged on them alone.
    """
    sought, limit = target() if mesh is None else mesh, threshold_of(segmenter)  # first: a wrong name is told at once
    own = loaded(segmenter) if refine and segmenter not in (TILES, TRUTH) else None
    by_rule = own is not None and own.rule is not None
    recognizer_of = recognizers(sought, segmenter=own if by_rule else "none", sonar_of=sonar_of)
    results, seconds = [], []
    for frame in tqdm(frames, desc=segmenter, unit="frame", leave=False, disable=None):
        started = time.perf_counter()
        recognizer = recognizer_of(frame.tilt_deg)
        if by_rule:
            results.append(recognizer(frame.image))
        else:
            recognizer = recognizer if refine and frame.is_target else unrefined(recognizer)
            results.append(recognizer(frame.image, semantic=map_of(segmenter, frame), threshold=limit))
        seconds.append(time.perf_counter() - started)
    true = [f.yaw for f in frames]
    return Found(
        score=np.array([r.score_bank for r in results]),
        decided=np.array([r.identified for r in results]),
        is_target=np.array([f.is_target for f in frames]),
        bin_error_deg=yaw_error_deg([r.yaw_bin for r in results], true),
        error_deg=yaw_error_deg([r.yaw for r in results], true),
        yaw_std_deg=np.degrees([np.nan if r.yaw_std is None else r.yaw_std for r in results]),
        seconds=np.array(seconds),
        threshold=limit,
        results=results,
    )


def summary_of(found: Found) -> dict[str, float]:
    """Accuracy at eq. 5's threshold and at the best one, what it is made of, yaw errors of the target's frames [deg].

    `decided` is the accuracy of the recognizer's own decision and of the yaw that it reports.
    """
    own = found.is_target
    right, near = (error <= WITHIN_BIN_DEG for error in (found.bin_error_deg, found.error_deg))
    best, best_threshold = best_accuracy(found.score, right, own)
    return {
        "accuracy": accuracy(found.score, right, own, found.threshold),
        "best_accuracy": best,
        "best_threshold": best_threshold,
        "threshold": found.threshold,
        "identified": float((found.score[own] >= found.threshold).mean()),
        "refused": float((found.score[~own] < found.threshold).mean()),
        "bin_right": float(right[own].mean()),
        "score_target": float(found.score[own].mean()),
        "score_other": float(found.score[~own].mean()),
        "score_other_largest": float(found.score[~own].max()),
        "milliseconds": float(1e3 * np.median(found.seconds)),
        "identification": float(((found.score >= found.threshold) == own).mean()),
        "decided": float(np.where(own, found.decided & near, ~found.decided).mean()),
        **{f"bin_{name}": value for name, value in summary_deg(found.bin_error_deg[own]).items()},
        **{f"yaw_{name}": value for name, value in summary_deg(found.error_deg[own]).items()},
    }


def area(score: np.ndarray, own: np.ndarray) -> float:
    """Area under the receiver operating characteristic of scores (frame,): Mann and Whitney's statistic."""
    ranks, targets = rankdata(score), int(own.sum())
    return float((ranks[own].sum() - targets * (targets + 1) / 2) / (targets * (~own).sum()))
