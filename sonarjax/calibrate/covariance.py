"""How well the free numbers are known: covariance, and whether the frames determine each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sonarjax.calibrate.picture import LOOK_STD

DETERMINED = 0.5
"""Most of the prior's standard deviation that is left of a number that the frames determine [1]."""


class Certainty(NamedTuple):
    """What is known of the free numbers after a fit."""

    covariance: np.ndarray
    """Covariance (free, free) given frames and priors."""
    determined: dict[str, bool]
    """Whether the frames determine each of them."""
    singular_values: np.ndarray
    """Of the frames' information in units of the priors (free,), largest first."""
    weakest: dict[str, float]
    """The direction of the least of them, in units of the priors."""


def certainty(information: np.ndarray, scores: np.ndarray, std: np.ndarray, free: Sequence[str]) -> Certainty:
    """From the joint `information` (shared, shared) and each frame's `scores` (frame, shared), free numbers first.

    The residuals of neighbouring pixels err together, so the information counts too many of them. How much it must be
    reduced is measured: the frames are independent, and the sum of their scores' outer products would equal the
    information if the pixels were too (the sandwich of Huber, 1967, as a single factor, since frames may be few).
    `std` (free,) are the priors' standard deviations.
    """
    count = len(free)
    prior = np.diag(1 / np.concatenate([std, LOOK_STD]) ** 2)
    together = _overcounted(information, scores, prior)
    told = information / together
    free_part, look = slice(None, count), slice(count, None)
    looks = told[look, look] + prior[look, look]
    alone = told[free_part, free_part] - told[free_part, look] @ np.linalg.solve(looks, told[look, free_part])
    scaled = alone * std[:, None] * std
    values, directions = np.linalg.eigh(scaled)
    covariance = np.linalg.inv(alone + np.diag(1 / std**2))
    left = np.sqrt(np.diag(covariance)) / std
    return Certainty(
        covariance=covariance,
        determined={name: bool(share <= DETERMINED) for name, share in zip(free, left, strict=True)},
        singular_values=np.sqrt(np.maximum(values[::-1], 0.0)),
        weakest=dict(zip(free, directions[:, 0].tolist(), strict=True)),
    )


def _overcounted(information: np.ndarray, scores: np.ndarray, prior: np.ndarray) -> float:
    """By how much the information counts pixels that err together more than once; at least 1."""
    inverse = np.linalg.inv(information + prior)
    frames = len(scores)
    centred = scores - scores.mean(axis=0)
    measured = np.trace(inverse @ centred.T @ centred) * frames / max(frames - 1, 1)
    return float(max(measured / max(np.trace(inverse @ information), 1e-9), 1.0))
