"""Refine the pose continuously: objective, solver, error bars and implicit derivative (not in the paper)."""

from sonarjax.refine.candidates import (
    COMPARISON,
    Look,
    apart,
    by_echoes,
    compared,
    look_closely,
    plan_shared,
    quick_evidence,
)
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.errorbar import ERROR_BAR, POSE_ERROR_BAR, ErrorBar, PoseErrorBar
from sonarjax.refine.evidence import Evidence, gather_evidence
from sonarjax.refine.find import PoseFinder
from sonarjax.refine.mean_yaw import prepare_mean_yaw
from sonarjax.refine.pose import PoseEstimate, plan_refinement, prepare_refinement, refine_pose
from sonarjax.refine.staged import MAP_SHARE, RefinedStart, refine_starts, with_mean_yaw
from sonarjax.refine.starts import (
    FRAME_BLURS,
    MAP_REFINEMENT,
    Candidate,
    Start,
    agreeing,
    curve_evidence,
    locate,
    make_starts,
    on_frame,
    peak_bins,
)
from sonarjax.refine.template import Drawn
from sonarjax.refine.views import in_common, in_view
from sonarjax.refine.yaw import YawEstimate, refine_yaw
from sonarjax.refine.yaw_set import (
    SAME_YAW,
    YAW_WEIGHTS,
    YawInterval,
    YawMode,
    YawSet,
    YawWeights,
    make_yaw_set,
    merged,
    shares,
)

__all__ = [
    "COMPARISON", "ERROR_BAR", "FRAME_BLURS", "MAP_REFINEMENT", "MAP_SHARE", "POSE_ERROR_BAR", "SAME_YAW",
    "YAW_WEIGHTS", "Candidate", "Drawn", "ErrorBar", "Evidence", "Look", "PoseErrorBar", "PoseEstimate", "PoseFinder",
    "RefineConfig", "RefinedStart", "Start", "YawEstimate", "YawInterval", "YawMode", "YawSet", "YawWeights",
    "agreeing", "apart", "by_echoes", "compared", "curve_evidence", "gather_evidence", "in_common", "in_view",
    "locate", "look_closely", "make_starts", "make_yaw_set", "merged", "on_frame", "peak_bins", "plan_refinement",
    "plan_shared", "prepare_mean_yaw", "prepare_refinement", "quick_evidence", "refine_pose", "refine_starts",
    "refine_yaw", "shares", "with_mean_yaw",
]  # fmt: skip
