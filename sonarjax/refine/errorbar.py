"""Error bars of a refined yaw, judged by how well the frame shows the yaw, and of a complete pose.

The curvature of the objective accounts for the residuals, but not for what the template lacks: bounces, another
brightness of faces, a slightly wrong tilt or height. On validation frames it says little about the errors. The errors
are large where the score hardly falls beside the best yaw, and where much of the frame is left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sonarjax.refine.free import NUMBERS


class ErrorBar(NamedTuple):
    """How the standard deviation of a refined yaw follows from the evidence of its frame.

    log `yaw_std` = `offset` + `map_drop` log(m + `FLAT`) + `frame_drop` log(f + `FLAT`) + `left_over` l. Here m and f
    are `map_drop` and `frame_drop` of `curve_evidence`, and l is `Evidence.left_over`.
    """

    offset: float
    """The value if everything else is 0."""
    map_drop: float
    """Power of `map_drop`: how far the score in the map falls beside the best yaw [1]."""
    frame_drop: float
    """Power of `frame_drop`: the same in the frame [1]."""
    left_over: float
    """Weight of `Evidence.left_over`."""

    def std(
        self, curvature_std: np.ndarray, map_drop: np.ndarray | float, frame_drop: np.ndarray | float,
        left_over: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Compute the standard deviations of refined yaws.

        Args:
            curvature_std: Standard deviations from the curvature (*batch) [rad]. The result is never below them.
            map_drop, frame_drop: How far the scores in map and frame fall beside the best yaw [NCC], (*batch) or one
                number each.
            left_over: `Evidence.left_over` (*batch) [1].

        Returns:
            Standard deviations of yaw (*batch) [rad].
        """
        powers = self.map_drop * log_drop(map_drop) + self.frame_drop * log_drop(frame_drop)
        return np.maximum(np.exp(self.offset + powers + self.left_over * left_over), curvature_std)


FLAT = 0.005
"""Added to a drop [NCC], so that a flat curve over yaw does not give an infinite error bar."""
ERROR_BAR = ErrorBar(offset=-7.636, map_drop=-0.1525, frame_drop=-0.8811, left_over=0.9543)
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
