"""Continuous yaw (and x, y): objective, solver, error bars and implicit derivative (beyond the paper)."""

from sonarjax.refine.config import RefineConfig
from sonarjax.refine.errorbar import ERROR_BAR, ErrorBar
from sonarjax.refine.evidence import Evidence, gather_evidence
from sonarjax.refine.yaw import (
    Drawn,
    YawEstimate,
    plan_refinement,
    prepare_refinement,
    refine_and_draw,
    refine_yaw,
)

__all__ = [
    "ERROR_BAR", "Drawn", "ErrorBar", "Evidence", "RefineConfig", "YawEstimate", "gather_evidence", "plan_refinement",
    "prepare_refinement", "refine_and_draw", "refine_yaw",
]  # fmt: skip
