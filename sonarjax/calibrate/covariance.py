"""How well the free numbers are known: covariance, and whether the frames determine each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sonarjax.calibrate.look import LOOK_STD
from sonarjax.refine.uncertainty import OBSERVABLE

MODEL_FRAMES = 4
"""As many frames' disagreement is worth as much as what the residuals' size says of it."""


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
    bound: np.ndarray
    """Least standard deviation (free,) that an estimator can have: see `Calibration.bound`."""


def certainty(information: np.ndarray, scores: np.ndarray, std: np.ndarray, free: Sequence[str]) -> Certainty:
    """From the frames' joint `information` (shared, shared), free numbers first, as `overcounted` has reduced it.

    `scores` (frame, shared) are the frames' derivatives of the cost, `std` (free,) the priors' standard deviations.
    How much the numbers vary is taken from how much the frames disagree, with MODEL_FRAMES frames' worth of what the
    information says: the sandwich of Huber (Proc. Fifth Berkeley Symp. 1, 1967).
    """
    count, frames = len(free), len(scores)
    of_free, across, of_look = information[:count, :count], information[:count, count:], information[count:, count:]
    alone = of_free - across @ np.linalg.solve(of_look + np.diag(1 / np.array(LOOK_STD) ** 2), across.T)
    scaled = alone * std[:, None] * std
    values, directions = np.linalg.eigh(scaled)
    prior = np.diag(1 / np.concatenate([std, LOOK_STD]) ** 2)
    inverse = np.linalg.inv(information + prior)
    centred = scores - scores.mean(axis=0)
    seen = centred.T @ centred * frames / max(frames - 1, 1)
    spread = (frames * seen + MODEL_FRAMES * information) / (frames + MODEL_FRAMES)
    covariance = (inverse @ (spread + prior) @ inverse)[:count, :count]
    left = np.sqrt(np.diag(covariance)) / std
    return Certainty(
        covariance=covariance,
        determined={name: bool(share <= OBSERVABLE) for name, share in zip(free, left, strict=True)},
        singular_values=np.sqrt(np.maximum(values[::-1], 0.0)),
        weakest=dict(zip(free, directions[:, 0].tolist(), strict=True)),
        bound=np.sqrt(np.diag(inverse)[:count]),
    )


def overcounted(information: np.ndarray, scores: np.ndarray, std: np.ndarray) -> float:
    """How often the `information` (shared, shared) counts what the frames tell; at least 1.

    The residuals of neighbouring pixels err together, so that each thing is counted by many of them. Frames are
    independent: the sum of the outer products of their `scores` (frame, shared) would equal the information if the
    pixels were too (the sandwich of Huber, Proc. Fifth Berkeley Symp. 1, 1967, as a single factor, since frames may be
    few). `std` (free,) are the priors' standard deviations of the free numbers, which come first.
    """
    prior = np.diag(1 / np.concatenate([std, LOOK_STD]) ** 2)
    inverse = np.linalg.inv(information + prior)
    frames = len(scores)
    centred = scores - scores.mean(axis=0)
    measured = np.trace(inverse @ centred.T @ centred) * frames / max(frames - 1, 1)
    return float(max(measured / max(np.trace(inverse @ information), 1e-9), 1.0))
