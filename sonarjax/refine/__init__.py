"""Continuous yaw (and x, y): objective, solver and error bars (beyond the paper)."""

from sonarjax.refine.yaw import SHARPNESS, YawEstimate, refine_yaw

__all__ = ["SHARPNESS", "YawEstimate", "refine_yaw"]
