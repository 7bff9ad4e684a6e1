"""Continuous yaw (and x, y): objective, solver and error bars (beyond the paper)."""

from sonarjax.refine.yaw import YawEstimate, refine_yaw

__all__ = ["YawEstimate", "refine_yaw"]
