"""How large the errors of a refined yaw are: the curvature's standard deviation, corrected by the evidence.

The curvature knows the residuals, but not what the template leaves out: bounces, another brightness of faces, a tilt or
height a little off. All of these show in how much of the frame is left over. And a yaw that hardly stands out from the
others is less certain than its own peak says.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ErrorBar(NamedTuple):
    """log `yaw_std` = `offset` + `power` log s + `left_over` l + `rise` r, with the curvature's s [rad]."""

    offset: float
    """Where all else is 0."""
    power: float
    """Power of the curvature's standard deviation [1]."""
    left_over: float
    """Weight of `Evidence.left_over`."""
    rise: float
    """Weight of `frame_rise`, by how much the best yaw stands out in the frame."""

    def std(self, curvature_std: np.ndarray, left_over: np.ndarray, rise: np.ndarray | float) -> np.ndarray:
        """Standard deviations of yaw [rad] (*batch), infinite where the curvature's are.

        `curvature_std` [rad] and `left_over` [1] are (*batch), `rise` [NCC] is (*batch) or one number.
        """
        known = np.log(np.maximum(curvature_std, LEAST))
        return np.exp(self.offset + self.power * known + self.left_over * left_over + self.rise * rise)


LEAST = 1e-5
"""Least standard deviation of the curvature [rad]: labels without any noise."""
ERROR_BAR = ErrorBar(offset=-2.496, power=0.2081, left_over=1.827, rise=-13.16)
"""Fitted to the errors on validation frames, whose devices and objects are in no test (experiments/fit_decision.py)."""
