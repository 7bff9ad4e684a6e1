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
    count = len(free)
    of_free, across, of_look = information[:count, :count], information[:count, count:], information[count:, count:]
    alone = of_free - across @ np.linalg.solve(of_look + np.diag(1 / np.array(LOOK_STD) ** 2), across.T)
    scaled = alone * std[:, None] * std
    values, directions = np.linalg.eigh(scaled)
    inverse = np.linalg.inv(information + _prior_information(std))
    left = np.sqrt(np.diag(error_covariance(information, scores, std))) / std
    return Certainty(
        covariance=error_covariance(information, scores, std, widening),
        determined={name: bool(share <= OBSERVABLE) for name, share in zip(free, left, strict=True)},
        singular_values=np.sqrt(np.maximum(values[::-1], 0.0)),
        weakest=dict(zip(free, directions[:, 0].tolist(), strict=True)),
        bound=np.sqrt(np.diag(inverse)[:count]),
    )


def error_covariance(
    information: np.ndarray, scores: np.ndarray, std: np.ndarray, widening: float = 1.0,
    put_back: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Covariance (free, free) of the errors of the free numbers after a fit.

    A number that was put back to its nominal value has the error of its prior. The fit of the other numbers took that
    value for right, so it passes its error on to them, as in `sonarjax.refine.uncertainty`. `widening` concerns only
    what the frames say.

    Args:
        information: As in `certainty`, of the fit in which the numbers stayed where they were put.
        scores: As in `certainty`, of the same fit.
        std: Standard deviations of the priors (free,).
        widening: As in `certainty`.
        put_back: Which free numbers (free,) were put back; None means none.
    """
    count, prior = len(std), _prior_information(std)
    fixed = np.zeros(len(prior), bool)
    fixed[:count] = False if put_back is None else put_back
    fitted, held = np.flatnonzero(~fixed), np.flatnonzero(fixed)
    among = np.ix_(fitted, fitted)
    inverse = np.linalg.inv((information + prior)[among])
    passed_on = np.eye(len(prior))[:, held]
    passed_on[fitted] = -inverse @ information[np.ix_(fitted, held)]
    covariance = (passed_on * std[held] ** 2) @ passed_on.T
    covariance[among] += inverse @ (widening**2 * _spread(information, scores) + prior)[among] @ inverse
    return covariance[:count, :count]


def _prior_information(std: np.ndarray) -> np.ndarray:
    """What the priors say (shared, shared), given those of the free numbers (free,)."""
    return np.diag(1 / np.concatenate([std, LOOK_STD]) ** 2)


def _spread(information: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Covariance (shared, shared) of the sum of the frames' scores: their disagreement, mixed with the information.

    One frame cannot disagree, which does not mean that it is right: then the information alone is taken.
    """
    frames = len(scores)
    if frames == 1:
        return information
    centred = scores - scores.mean(axis=0)
    seen = centred.T @ centred * frames / (frames - 1)
    return (frames * seen + MODEL_FRAMES * information) / (frames + MODEL_FRAMES)


def overcounted(information: np.ndarray, scores: np.ndarray, std: np.ndarray) -> float:
    """By what factor the `information` (shared, shared) overstates what the frames say; at least 1.

    The residuals of neighbouring pixels err together, so many pixels count the same thing. Frames are independent of
    each other. If pixels were as well, the sum of the outer products of the frames' `scores` (frame, shared) would
    equal the information (the sandwich of Huber, Proc. Fifth Berkeley Symp. 1, 1967; a single factor here, because
    frames may be few). One frame does not tell, and gives 1. `std` (free,) are the standard deviations of the priors of
    the free numbers, which come first.
    """
    inverse = np.linalg.inv(information + _prior_information(std))
    frames = len(scores)
    centred = scores - scores.mean(axis=0)
    measured = np.trace(inverse @ centred.T @ centred) * frames / max(frames - 1, 1)
    return float(max(measured / max(np.trace(inverse @ information), 1e-9), 1.0))
