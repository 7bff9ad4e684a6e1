"""Continuous yaw (and x, y): objective, solver, error bars and implicit derivative (beyond the paper)."""

from sonarjax.refine.config import RefineConfig
from sonarjax.refine.yaw import YawEstimate, plan_refinement, prepare_refinement, refine_yaw

__all__ = ["RefineConfig", "YawEstimate", "plan_refinement", "prepare_refinement", "refine_yaw"]
