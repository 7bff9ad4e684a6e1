"""Sequences of frames of one object by one device, and what a recognizer said of each: kept as JSON's types."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common.drawn_device import DrawnDevice
from experiments.common.frames import observed
from sonarjax.recognition import Hypothesis, Recognition

TILT_DEG = 20.0


def recognized(
    device: DrawnDevice, recognizer: sj.Recognizer, poses: Iterable[sj.Pose], *, key: jax.Array
) -> list[Any]:
    """What `recognizer` says of a frame at each of the `poses` [m, rad] in the sonar's frame: see `kept`."""
    rows = []
    for number, pose in enumerate(poses):
        part = jax.random.fold_in(key, 100 + number)
        image, _ = observed(device.mesh, pose, device.sonar, device.model, key=part)
        found = recognizer(np.asarray(image))
        rows.append(kept(found) | {"true": [float(pose.yaw), float(pose.x), float(pose.y)]})
    return rows


def kept(found: Recognition) -> dict[str, Any]:
    """What tracking needs of a recognition, as JSON's types."""
    hypotheses = [[h.yaw, h.score, h.yaw_std, h.converged, h.x, h.y] for h in found.hypotheses]
    names = ("identified", "score", "score_bank", "threshold", "yaw", "x", "y")
    return {name: getattr(found, name) for name in names} | {"hypotheses": hypotheses}


def taken_up(row: dict[str, Any]) -> Recognition:
    """A recognition of what was kept of it; the rest of it is empty."""
    hypotheses = tuple(
        Hypothesis(yaw, score, math.inf if std is None else std, settled, x, y)
        for yaw, score, std, settled, x, y in row["hypotheses"]
    )
    best = hypotheses[0]
    return Recognition(
        identified=row["identified"], target="target", score=row["score"], score_bank=row["score_bank"],
        score_refined=best.score, threshold=row.get("threshold", 0.5), runner_up=None, margin=None, yaw_bin=math.nan,
        yaw_std=best.yaw_std, x=row["x"], y=row["y"], converged=best.converged, scores_by_yaw=np.empty(0),
        yaw=row["yaw"], hypotheses=hypotheses, segmenter="kept", semantic=np.empty((0, 0)),
    )  # fmt: skip


class Replayed(sj.Recognizer):
    """Stands for the recognizer of frames that were recognized before, in a `Tracker` that takes what it said."""

    def __init__(self) -> None:
        """It has one target and prepares nothing."""
        self.targets: Any = {"target": None}
        self.search, self.refine = sj.SearchConfig(), None


def truths(rows: Sequence[dict[str, Any]]) -> np.ndarray:
    """True yaw [rad], x and y [m] of each frame (frame, 3)."""
    return np.array([row["true"] for row in rows], float)
