"""Continuous yaw (and x, y): objective, solver, error bars and implicit derivative (beyond the paper)."""

from sonarjax.refine.config import RefineConfig
from sonarjax.refine.errorbar import ERROR_BAR, ErrorBar
from sonarjax.refine.evidence import Evidence, gather_evidence
from sonarjax.refine.starts import (
    FRAME_BLURS,
    FRAME_ITERATIONS,
    MAP_REFINEMENT,
    Candidate,
    Start,
    curve_evidence,
    is_kept,
    locate,
    make_starts,
    on_frame,
    peak_bins,
    refine_start,
)
from sonarjax.refine.yaw import (
    Drawn,
    YawEstimate,
    plan_refinement,
    prepare_refinement,
    refine_and_draw,
    refine_yaw,
)

__all__ = [
    "ERROR_BAR", "FRAME_BLURS", "FRAME_ITERATIONS", "MAP_REFINEMENT", "Candidate", "Drawn", "ErrorBar", "Evidence",
    "RefineConfig", "Start", "YawEstimate", "curve_evidence", "gather_evidence", "is_kept", "locate", "make_starts",
    "on_frame", "peak_bins", "plan_refinement", "prepare_refinement", "refine_and_draw", "refine_start",
    "refine_yaw",
]  # fmt: skip
