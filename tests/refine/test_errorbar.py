"""The error bars of a refined yaw and of a whole pose: their closed forms, and what they do with extremes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sonarjax.refine import ERROR_BAR, POSE_ERROR_BAR, Candidate, ErrorBar, PoseErrorBar, curve_evidence
from sonarjax.refine.errorbar import SHARPEST, USUAL_ODDS


def test_it_is_a_product_of_powers() -> None:
    bar = ErrorBar(offset=-3.0, curvature=0.5, frame_drop=-2.0, odds=-0.5)
    known, drop = np.array([1e-4, 4e-4]) - SHARPEST, np.array([0.095, 0.995])
    plain = np.array([math.exp(-3.0) * 0.01 / 0.1**2, math.exp(-3.0) * 0.02])
    assert bar.std(known, drop) == pytest.approx(plain)
    doubtful = 1 / (1 + math.exp(-USUAL_ODDS + 1))  # log-odds one below the usual
    assert bar.std(known, drop, doubtful) == pytest.approx(plain * math.exp(0.5))


def test_certainty_has_a_finite_error_bar() -> None:
    """Beyond some odds, more or less of them change nothing."""
    sure, surer = (ERROR_BAR.std(np.full(1, 1e-3), 0.1, p) for p in (0.999, 1.0))
    doubtful, absent = (ERROR_BAR.std(np.full(1, 1e-3), 0.1, p) for p in (0.01, 0.0))
    assert sure == surer < ERROR_BAR.std(np.full(1, 1e-3), 0.1) < doubtful == absent


def test_the_curvature_is_the_least() -> None:
    known = np.array([0.0, 0.5, np.inf])
    std = ERROR_BAR.std(known, 1.0)
    assert 0 < std[0] < math.radians(1.0)
    assert std[1:].tolist() == [0.5, np.inf]


def test_a_curve_that_does_not_fall_is_a_finite_error() -> None:
    assert np.isfinite(ERROR_BAR.std(np.full(2, 0.01), np.array([-0.1, 0.0]))).all()


def test_flatter_curves_mean_a_larger_error() -> None:
    least = ERROR_BAR.std(np.full(1, 1e-3), 0.2)
    assert ERROR_BAR.std(np.full(1, 4e-3), 0.2) > least
    assert ERROR_BAR.std(np.full(1, 1e-3), 0.05) > least


def test_a_pose_has_the_errors_of_the_curvature_and_of_the_template() -> None:
    curvature = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.0], [0.5, 0.0, 16.0]])
    found = PoseErrorBar(2.0, 3.0, 5.0).covariance(curvature, np.ones(3, bool), ("yaw", "x", "z"))
    assert found == pytest.approx(np.array([[41.0, 4.0, 2.0], [4.0, 45.0, 0.0], [2.0, 0.0, 73.0]]))


def test_what_a_held_number_passes_on_is_not_widened() -> None:
    """Errors of yaw and x are linear in that of z, apart from what the frame says of them; two poses at once."""
    data, bounds = np.array([[4.0, 1.0], [1.0, 9.0]]), 16.0
    slope = np.array([[0.5, -2.0], [0.0, 0.0]])
    across = bounds * slope[:, :, None]
    curvature = np.block([[data + bounds * slope[:, :, None] * slope[:, None, :], across],
                          [across.transpose(0, 2, 1), np.full((2, 1, 1), bounds)]])  # fmt: skip
    observable = np.array([[True, True, False]] * 2)
    found = PoseErrorBar(2.0, 3.0, 5.0).covariance(curvature, observable, ("yaw", "x", "z"))
    wanted = curvature.copy()
    wanted[:, :2, :2] += 3 * data + np.diag([25.0, 9.0])
    assert found == pytest.approx(wanted)


def test_nothing_known_stays_infinite() -> None:
    nothing = np.diag([np.inf, np.inf])
    found = POSE_ERROR_BAR.covariance(nothing, np.array([False, False]), ("yaw", "x"))
    assert np.isinf(np.diag(found)).all() and np.isfinite(found[0, 1])


@pytest.mark.parametrize("bins", [18, 36, 72])
def test_the_drop_beside_the_best_yaw_is_at_ten_degrees(bins: int) -> None:
    off = np.abs((np.arange(bins) * 360 / bins + 180) % 360 - 180)
    scores = 0.8 - 0.003 * off  # 0.03 less at 10 degrees
    match: Any = SimpleNamespace(scores=scores, own_scores=lambda: scores)
    search: Any = SimpleNamespace()
    assert curve_evidence(Candidate(search, match, 2.3, 0.0), None)["frame_drop"] == pytest.approx(0.03)
