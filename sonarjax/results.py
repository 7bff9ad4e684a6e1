"""The result for a frame as one JSON object, for the command line and for streams."""

from __future__ import annotations

import math
from typing import Any

from sonarjax.recognition import Recognition
from sonarjax.refine import YawMode, YawSet
from sonarjax.track.sequence import Tracked

SCHEMA = 2
"""Version of a line; 2 has `converged`, `target`, `runner_up` and `margin`, since 0.2 `agree` and `yaw_set` too."""


COVERAGES = {"within_68": 0.68, "within_95": 0.95}
"""Coverages of the sets of yaw intervals in a line, by their names there."""


def record_of(result: Recognition, frame: str, seconds: float, tracked: Tracked | None = None) -> dict[str, Any]:
    """Make the line of a results file for one frame.

    Lengths are in metres, yaws in degrees in [0, 360). An interval of yaws across 0 ends above 360, and a rate of
    turning has a sign.

    Args:
        result: What was found in the frame.
        frame: Name of the frame.
        seconds: Time that recognition took [s]; it is longer where other frames were recognized at the same time.
        tracked: The belief after this frame; None if the frames are not tracked. Yaw, its standard deviation, x, y and
            the hypotheses are then those of the belief, and the frame's own yaw is added.

    Returns:
        The line in JSON types.
    """

    def degrees(angle: float | None) -> float | None:
        return None if angle is None else math.degrees(angle)

    hypotheses = [
        {"yaw_deg": degrees(h.yaw), "score": h.score, "yaw_std_deg": degrees(h.yaw_std), "converged": h.converged}
        for h in result.hypotheses
    ]
    record: dict[str, Any] = {
        "frame": frame,
        "identified": result.identified,
        "target": result.target,
        "score": result.score,
        "score_bank": result.score_bank,
        "score_refined": result.score_refined,
        "threshold": result.threshold,
        "runner_up": result.runner_up,
        "margin": result.margin,
        "yaw_bin_deg": degrees(result.yaw_bin),
        "yaw_deg": degrees(result.yaw),
        "yaw_std_deg": degrees(result.yaw_std),
        "converged": result.converged,
        "agree": result.agree,
        "x_m": result.x,
        "y_m": result.y,
        "scores_by_yaw": [float(score) for score in result.scores_by_yaw],
        "hypotheses": hypotheses,
        "yaw_set": None if result.yaw_set is None else _yaws(result.yaw_set),
        "segmenter": result.segmenter,
        "seconds": seconds,
        "schema": SCHEMA,
    }
    return record if tracked is None else record | _believed(tracked, record["yaw_deg"])


def _yaws(allowed: YawSet) -> dict[str, Any]:
    """The modes of a set of yaws, and for each coverage its disjoint intervals [low, high) in degrees, with
    their weights.
    """
    found: dict[str, Any] = {
        "modes": [
            {"yaw_deg": math.degrees(one.yaw), "yaw_std_deg": math.degrees(one.yaw_std), "weight": one.weight}
            for one in allowed.modes
        ]
    }
    for name, coverage in COVERAGES.items():
        found[name] = [
            {"low_deg": math.degrees(one.low), "high_deg": math.degrees(one.high), "weight": one.weight}
            for one in allowed.intervals(coverage)
        ]
    return found


def _believed(tracked: Tracked, frame_yaw_deg: float | None) -> dict[str, Any]:
    """The fields of a line that come from a belief instead of the frame alone. Each mode's score is its probability."""
    best, modes = tracked.best, tracked.modes
    total = sum(mode.probability for mode in modes)
    allowed = YawSet(tuple(YawMode(mode.yaw, mode.yaw_std, mode.probability / total) for mode in modes))
    return {
        "yaw_deg": math.degrees(best.yaw),
        "yaw_std_deg": math.degrees(best.yaw_std),
        "x_m": best.x,
        "y_m": best.y,
        "hypotheses": [
            {
                "yaw_deg": math.degrees(mode.yaw),
                "score": mode.probability,
                "yaw_std_deg": math.degrees(mode.yaw_std),
                "converged": True,
            }
            for mode in modes
        ],
        "yaw_set": _yaws(allowed) if modes else None,
        "probability": best.probability,
        "rate_deg": math.degrees(best.rate),
        "frame_yaw_deg": frame_yaw_deg,
    }
