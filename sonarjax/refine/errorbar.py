"""Error bars of a refined yaw, judged by how well the frame shows the yaw, and of a complete pose.

The curvature of the objective accounts for the residuals, but not for what the template lacks: bounces, another
brightness of faces, a slightly wrong tilt or height. On validation frames the errors of yaw grow far less than the
curvature's standard deviation does. They are large where the score hardly falls beside the best yaw, and where it is
doubtful whether the frame shows the target at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sonarjax.refine.free import NUMBERS


class ErrorBar(NamedTuple):
    """How the standard deviation of a refined yaw follows from the curvature and from the evidence of its frame.

    log `yaw_std` = `offset` + `curvature` log(c + `SHARPEST`) + `frame_drop` log(f + `FLAT`)
    + `odds` (l - `USUAL_ODDS`). Here c is the standard deviation from the curvature [rad], f is `frame_drop` of
    `curve_evidence` [NCC], and l are the log-odds that the frame shows the target, by the rule, limited to `ODDS`.
    """

    offset: float
    """The value if everything else is 0."""
    curvature: float
    """Power of the standard deviation from the curvature [1]."""
    frame_drop: float
    """Power of `frame_drop`: how far the score in the frame falls beside the best yaw [1]."""
    odds: float
    """Change of log `yaw_std` with the log-odds [1]."""

    def std(
        self, curvature_std: np.ndarray, frame_drop: np.ndarray | float, probability: np.ndarray | float | None = None
    ) -> np.ndarray:
        """Compute the standard deviations of refined yaws.

        Args:
            curvature_std: Standard deviations from the curvature (*batch) [rad]. The result is never below them.
            frame_drop: How far the scores in the frame fall beside the best yaw [NCC], (*batch) or one number.
            probability: Probability that the frame shows the target [1], (*batch) or one number; None if no rule says.

        Returns:
            Standard deviations of yaw (*batch) [rad].
        """
        powers = self.curvature * np.log(curvature_std + SHARPEST) + self.frame_drop * log_drop(frame_drop)
        if probability is not None:
            powers = powers + self.odds * relative_odds(probability)
        return np.maximum(np.exp(self.offset + powers), curvature_std)


SHARPEST = 1e-5
"""Added to the standard deviation from the curvature [rad], so that none is 0."""
FLAT = 0.005
"""Added to a drop [NCC], so that a flat curve over yaw does not give an infinite error bar."""
ODDS = (-3.0, 4.0)
"""Log-odds below and above these count as these [1]; with wider limits the validation errors are no likelier."""
USUAL_ODDS = 3.0
"""Log-odds of a usual validation frame [1]; an unknown probability counts as these."""
ERROR_BAR = ErrorBar(offset=-4.148, curvature=0.3259, frame_drop=-0.6136, odds=-0.1573)
"""Fitted to the errors on validation frames, whose devices and objects occur in no test
(experiments/fit_error_bar.py).
"""


def log_drop(drop: np.ndarray | float) -> np.ndarray | np.floating:
    """Logarithm of a drop [NCC] (*batch), as `ErrorBar` takes it."""
    return np.log(np.maximum(drop, 0.0) + FLAT)


def relative_odds(probability: np.ndarray | float) -> np.ndarray | np.floating:
    """Log-odds of probabilities (*batch), limited to `ODDS`, minus `USUAL_ODDS`, as `ErrorBar` takes them."""
    with np.errstate(divide="ignore"):  # certainty has infinite odds
        odds = np.log(probability) - np.log1p(-np.asarray(probability))
    return np.clip(odds, *ODDS) - USUAL_ODDS


class PoseErrorBar(NamedTuple):
    """Errors of a pose refined on a frame: `factor` squared × the curvature's covariance, plus what the template lacks.

    The second part is the same for every frame, and adds to the variance of each number. More frames do not reduce it.
    What a number that was held passes on to the others comes from its bounds, not from the frame: no factor widens it.
    """

    factor: float
    """On the standard deviations from the curvature and the residuals [1]."""
    place: float
    """Standard deviation added to x, y and z [m]."""
    angle: float
    """Standard deviation added to yaw, roll and pitch [rad]."""

    def covariance(
        self, curvature: Float[np.ndarray, "*batch free free"], observable: Bool[np.ndarray, "*batch free"],
        free: Sequence[str],
    ) -> Float[np.ndarray, "*batch free free"]:  # fmt: skip
        """Compute the covariance of the errors of each pose of a batch.

        Args:
            curvature: Covariance from the curvature (free, free) [m, rad].
            observable: True for observable numbers (free,). The others were held: they keep their variance, which is
                that of their bounds, and what they pass on to the others is kept too.
            free: Names of the free numbers, in their order.

        Returns:
            Covariance of the errors (free, free) [m, rad].
        """
        each = np.where(observable, self.factor, 1.0)
        added = np.array([self.angle if NUMBERS[name].unit == "rad" else self.place for name in free])
        known = np.where(observable, added**2, 0.0)
        kept = _passed_on(curvature, observable)
        fitted = (curvature - kept) * each[..., :, None] * each[..., None, :]
        return kept + fitted + known[..., None] * np.eye(len(free))


def _passed_on(
    covariance: Float[np.ndarray, "*batch free free"], observable: Bool[np.ndarray, "*batch free"]
) -> Float[np.ndarray, "*batch free free"]:
    """The part of a `covariance` (free, free) that comes from the errors of numbers that are not `observable` (free,).

    It follows from their covariances with the others, by linear regression. Infinite variances have none.
    """
    held = ~observable
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    across = np.where(held[..., None, :], finite, 0.0)
    among = np.where(held[..., :, None], across, 0.0)
    return across @ np.linalg.pinv(among) @ np.swapaxes(across, -1, -2)


POSE_ERROR_BAR = PoseErrorBar(factor=10.17, place=0.004375, angle=0.0)
"""Fitted to the errors on validation frames (experiments/fit_pose_std.py)."""
