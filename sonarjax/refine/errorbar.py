"""How large the errors of a refined yaw are: the standard deviation from the curvature, corrected by the evidence.

The curvature accounts for the residuals, but not for what the template lacks: bounces, another brightness of faces, a
slightly wrong tilt or height. All of these show in how much of the frame is left over. And a yaw that hardly stands out
from the others is less certain than its own peak suggests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ErrorBar(NamedTuple):
    """log `yaw_std` = `offset` + `power` log s + `left_over` l + `rise` r, where s is the curvature's [rad]."""

    offset: float
    """The value if everything else is 0."""
    power: float
    """Power of the curvature's standard deviation [1]."""
    left_over: float
    """Weight of `Evidence.left_over`."""
    rise: float
    """Weight of `frame_rise`: how much the best yaw stands out in the frame."""

    def std(self, curvature_std: np.ndarray, left_over: np.ndarray, rise: np.ndarray | float) -> np.ndarray:
        """Standard deviations of yaw [rad] (*batch); infinite where the curvature's are.

        `curvature_std` [rad] and `left_over` [1] are (*batch); `rise` [NCC] is (*batch) or one number.
        """
        known = np.log(np.maximum(curvature_std, LEAST))
        return np.exp(self.offset + self.power * known + self.left_over * left_over + self.rise * rise)


LEAST = 1e-5
"""Least standard deviation of the curvature [rad]: that of labels without any noise."""
ERROR_BAR = ErrorBar(offset=-2.496, power=0.2081, left_over=1.827, rise=-13.16)
"""Fitted to the errors on validation frames, whose devices and objects occur in no test
(experiments/fit_decision.py).
"""
