"""How well the free numbers are known: their covariance, and whether the frames determine each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sonarjax.calibrate.look import LOOK_STD
from sonarjax.refine.uncertainty import OBSERVABLE

MODEL_FRAMES = 4
"""The covariance that the residuals imply is weighted as much as the disagreement of this many frames."""


class Certainty(NamedTuple):
    """What is known about the free numbers after a fit."""

    covariance: np.ndarray
    """Covariance (free, free), given frames and priors."""
    determined: dict[str, bool]
    """For each free number, whether the frames determine it."""
    singular_values: np.ndarray
    """Singular values of the frames' information, in units of the priors (free,), largest first."""
    weakest: dict[str, float]
    """The direction of the smallest singular value, in units of the priors."""
    bound: np.ndarray
    """Least standard deviation (free,) that an estimator can have, see `Calibration.bound`."""


def certainty(
    information: np.ndarray, scores: np.ndarray, std: np.ndarray, free: Sequence[str], widening: float = 1.0
) -> Certainty:
    """Judge how well a fit determines the free numbers.

    The variance of the numbers is taken from how much the frames disagree, mixed with what the information says, which
    counts as MODEL_FRAMES frames: the sandwich of Huber (Proc. Fifth Berkeley Symp. 1, 1967).

    Args:
        information: The frames' joint information (shared, shared), free numbers first, reduced by the factor of
            `overcounted`.
        scores: Each frame's derivatives of the cost (frame, shared).
        std: Standard deviations of the priors (free,).
        free: Names of the free numbers.
        widening: Factor on the standard deviations that the frames imply [1], for errors that all frames share. It does
            not decide what is determined.
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
    left = np.sqrt(np.diag(inverse @ (spread + prior) @ inverse)[:count]) / std
    return Certainty(
        covariance=(inverse @ (widening**2 * spread + prior) @ inverse)[:count, :count],
        determined={name: bool(share <= OBSERVABLE) for name, share in zip(free, left, strict=True)},
        singular_values=np.sqrt(np.maximum(values[::-1], 0.0)),
        weakest=dict(zip(free, directions[:, 0].tolist(), strict=True)),
        bound=np.sqrt(np.diag(inverse)[:count]),
    )


def overcounted(information: np.ndarray, scores: np.ndarray, std: np.ndarray) -> float:
    """By what factor the `information` (shared, shared) overstates what the frames say; at least 1.

    The residuals of neighbouring pixels err together, so many pixels count the same thing. Frames are independent of
    each other. If pixels were as well, the sum of the outer products of the frames' `scores` (frame, shared) would
    equal the information (the sandwich of Huber, Proc. Fifth Berkeley Symp. 1, 1967; a single factor here, because
    frames may be few). `std` (free,) are the standard deviations of the priors of the free numbers, which come first.
    """
    prior = np.diag(1 / np.concatenate([std, LOOK_STD]) ** 2)
    inverse = np.linalg.inv(information + prior)
    frames = len(scores)
    centred = scores - scores.mean(axis=0)
    measured = np.trace(inverse @ centred.T @ centred) * frames / max(frames - 1, 1)
    return float(max(measured / max(np.trace(inverse @ information), 1e-9), 1.0))
