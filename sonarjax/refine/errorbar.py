"""Error bars of a refined yaw, judged by how well the frame shows the yaw, and of a complete pose.

The curvature of the objective accounts for the residuals, but not for what the template lacks: bounces, another
brightness of faces, a slightly wrong tilt or height. On validation frames the errors of yaw grow only with about the
square root of the curvature's standard deviation, and they are large where the score hardly falls beside the best yaw.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sonarjax.refine.free import NUMBERS


class ErrorBar(NamedTuple):
    """How the standard deviation of a refined yaw follows from the curvature and from the evidence of its frame.

    log `yaw_std` = `offset` + `curvature` log(c + `SHARPEST`) + `frame_drop` log(f + `FLAT`). Here c is the standard
    deviation from the curvature [rad], and f is `frame_drop` of `curve_evidence` [NCC].
    """

    offset: float
    """The value if everything else is 0."""
    curvature: float
    """Power of the standard deviation from the curvature [1]."""
    frame_drop: float
    """Power of `frame_drop`: how far the score in the frame falls beside the best yaw [1]."""

    def std(self, curvature_std: np.ndarray, frame_drop: np.ndarray | float) -> np.ndarray:
        """Compute the standard deviations of refined yaws.

        Args:
            curvature_std: Standard deviations from the curvature (*batch) [rad]. The result is never below them.
            frame_drop: How far the scores in the frame fall beside the best yaw [NCC], (*batch) or one number.

        Returns:
            Standard deviations of yaw (*batch) [rad].
        """
        powers = self.curvature * np.log(curvature_std + SHARPEST) + self.frame_drop * log_drop(frame_drop)
        return np.maximum(np.exp(self.offset + powers), curvature_std)


SHARPEST = 1e-5
"""Added to the standard deviation from the curvature [rad], so that none is 0."""
FLAT = 0.005
"""Added to a drop [NCC], so that a flat curve over yaw does not give an infinite error bar."""
ERROR_BAR = ErrorBar(offset=-2.208, curvature=0.6008, frame_drop=-0.5164)
"""Fitted to the errors on validation frames, whose devices and objects occur in no test
(experiments/fit_decision.py).
"""


def log_drop(drop: np.ndarray | float) -> np.ndarray | np.floating:
    """Logarithm of a drop [NCC] (*batch), as `ErrorBar` takes it."""
    return np.log(np.maximum(drop, 0.0) + FLAT)


class PoseErrorBar(NamedTuple):
    """Errors of a pose refined on a frame: `factor` squared × the curvature's covariance, plus what the template lacks.

    The second part is the same for every frame, and adds to the variance of each number. More frames do not reduce it.
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
            observable: True for observable numbers (free,). The others keep their variance, which is that of their
                bounds.
            free: Names of the free numbers, in their order.

        Returns:
            Covariance of the errors (free, free) [m, rad].
        """
        each = np.where(observable, self.factor, 1.0)
        added = np.array([self.angle if NUMBERS[name].unit == "rad" else self.place for name in free])
        known = np.where(observable, added**2, 0.0)
        return curvature * each[..., :, None] * each[..., None, :] + known[..., None] * np.eye(len(free))


POSE_ERROR_BAR = PoseErrorBar(factor=10.17, place=0.004375, angle=0.0)
"""Fitted to the errors on validation frames (experiments/fit_pose_std.py)."""
