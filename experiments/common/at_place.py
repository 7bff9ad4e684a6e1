"""Matching at a known place: eq. 4 with banks that show a part of the object, or are rendered for a wrong geometry."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TestFrame, sonar_for
from experiments.common.metrics import WITHIN_BIN_DEG, best_accuracy, yaw_error_deg
from experiments.common.sets import target
from sonarjax.match import prepare_bank

BACKGROUND = 0.5
YAWS = np.arange(36) * (2 * np.pi / 36)


@cache
def bank_with(tilt_deg: float, tilt_error_deg: float, distance_error_m: float) -> sj.TemplateBank:
    """The target's bank for frames of `tilt_deg` [deg], rendered for a geometry with this error.

    Tilt errors [deg] are positive where the bank looks down too steeply, those of distance [m] where it is too far.
    """
    sonar = sonar_for(tilt_deg).replace(tilt=math.radians(tilt_deg + tilt_error_deg))
    x = GROUND_RANGE_M[tilt_deg] + distance_error_m
    return sj.template_bank(target(), sonar, YAWS, x=x, engine=engine())


def only(part: str, grey: Any) -> Any:
    """A semantic grey image of any shape with one class put to background; of "both" as it is."""
    if part == "both":
        return grey
    return grey.clip(BACKGROUND, None) if part == "highlight" else grey.clip(None, BACKGROUND)


def scores_at_place(
    maps: Sequence[np.ndarray], frames: Sequence[TestFrame], banks: Mapping[float, sj.TemplateBank]
) -> np.ndarray:
    """Scores (frame, yaw) of eq. 4 of each map with the bank of its frame's tilt [deg].

    The template may lie anywhere in the frame.
    """
    prepared = {tilt: prepare_bank(bank, maps[0].shape) for tilt, bank in banks.items()}
    found = [sj.match_bank(image, prepared[frame.tilt_deg]) for image, frame in zip(maps, frames, strict=True)]
    return np.array(found)


def judged_at_place(scores: np.ndarray, frames: Sequence[TestFrame]) -> dict[str, float]:
    """Accuracy and correlations of scores (frame, yaw) whose yaws are spread evenly over the circle, from 0.

    `score_own` is the template's of the nearest bin, `score_wrong` the best of those more than 25° from the true yaw,
    `score_other` the best for frames of the other object.
    """
    own = np.array([frame.is_target for frame in frames])
    true, count = np.array([frame.yaw for frame in frames]), scores.shape[1]
    yaws = np.arange(count) * (2 * np.pi / count)
    right = yaw_error_deg(yaws[scores.argmax(axis=1)], true) <= WITHIN_BIN_DEG
    best, threshold = best_accuracy(scores.max(axis=1), right, own)
    off = yaw_error_deg(yaws, true[:, None])  # (frame, yaw)
    nearest = np.take_along_axis(scores, off.argmin(axis=1)[:, None], axis=1)[:, 0]
    return {
        "best_accuracy": best,
        "best_threshold": threshold,
        "bin_right": float(right[own].mean()),
        "score_own": float(nearest[own].mean()),
        "score_wrong": float(np.where(off > 25.0, scores, -1.0).max(axis=1)[own].mean()),
        "score_other": float(scores[~own].max(axis=1).mean()),
    }
