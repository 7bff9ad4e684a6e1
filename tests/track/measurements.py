"""Recognitions made by hand, and a recognizer that reads them off images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

import sonarjax as sj
from sonarjax.recognition import Hypothesis, Recognition

SHAPE = (3, 4)
STD = math.radians(1.0)


def found(
    yaws: Sequence[float], scores: Sequence[float] | None = None, *, probability: float = 0.95, std: float = STD,
    place: tuple[float, float] = (2.0, 0.1),
) -> Recognition:  # fmt: skip
    """A frame with hypotheses of these yaws [rad] and scores, all at one place [m]."""
    scores = [0.8] * len(yaws) if scores is None else scores
    hypotheses = tuple(
        Hypothesis(yaw % (2 * math.pi), score, std, True, *place) for yaw, score in zip(yaws, scores, strict=True)
    )
    best = hypotheses[0]
    return Recognition(
        identified=probability >= 0.5, target="target", score=probability, score_bank=-1.0, score_refined=best.score,
        threshold=0.5, runner_up=None, margin=None, yaw_bin=best.yaw, yaw=best.yaw, yaw_std=std, x=place[0],
        y=place[1], converged=True, scores_by_yaw=np.zeros(36), hypotheses=hypotheses, segmenter="none",
        semantic=np.zeros(SHAPE),
    )  # fmt: skip


class Reader(sj.Recognizer):
    """Reads a yaw off the first pixel [rad] and the probability off the second; a third below 0 is no frame."""

    def __init__(self, targets: Sequence[str] = ("target",)) -> None:
        self.targets: Any = dict.fromkeys(targets)
        self.search, self.refine, self.masks = sj.SearchConfig(), None, []

    def __call__(self, image: Any, mask: Any = None, *, semantic: Any = None, threshold: Any = None, starts: Any = ()):
        self.masks.append(mask)
        if not np.isfinite(image).all():
            raise sj.SonarjaxError("image: holds NaN or infinite values")
        return found([float(image[0, 0])], probability=float(image[0, 1]))


def frame(yaw: float, probability: float = 0.95) -> np.ndarray:
    """An image (range, beam) that `Reader` reads so."""
    image = np.zeros(SHAPE, np.float32)
    image[0, :2] = yaw, probability
    return image
