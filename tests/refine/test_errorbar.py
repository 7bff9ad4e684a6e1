"""The error bars of a refined yaw and of a whole pose: their closed forms, and what they do with extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sonarjax.refine import ERROR_BAR, POSE_ERROR_BAR, ErrorBar, PoseErrorBar


def test_it_is_a_product_of_powers() -> None:
    bar = ErrorBar(offset=-3.0, map_drop=-0.5, frame_drop=-2.0, left_over=1.5)
    std = bar.std(np.zeros(2), np.array([0.095, 0.0]), 0.995, np.array([0.2, 0.4]))
    assert std == pytest.approx([math.exp(-2.7) / math.sqrt(0.1), math.exp(-2.4) / math.sqrt(0.005)])


def test_the_curvature_is_the_least() -> None:
    known, nothing_left = np.array([0.0, 0.5, np.inf]), np.zeros(3)
    std = ERROR_BAR.std(known, 1.0, 1.0, nothing_left)
    assert 0 < std[0] < math.radians(1.0)
    assert std[1:].tolist() == [0.5, np.inf]


def test_a_curve_that_does_not_fall_is_a_finite_error() -> None:
    assert np.isfinite(ERROR_BAR.std(np.zeros(1), -0.1, 0.0, np.ones(1))).all()


def test_a_flatter_curve_and_more_left_over_mean_a_larger_error() -> None:
    least = ERROR_BAR.std(np.zeros(1), 0.2, 0.2, np.array([0.2]))
    for worse in ((0.05, 0.2, 0.2), (0.2, 0.05, 0.2), (0.2, 0.2, 0.6)):
        assert ERROR_BAR.std(np.zeros(1), *worse[:2], np.array(worse[2:])) > least


def test_a_pose_has_the_errors_of_the_curvature_and_of_the_template() -> None:
    curvature = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.0], [0.5, 0.0, 16.0]])
    found = PoseErrorBar(2.0, 3.0, 5.0).covariance(curvature, np.array([True, True, False]), ("yaw", "x", "z"))
    assert found == pytest.approx(np.array([[41.0, 4.0, 1.0], [4.0, 45.0, 0.0], [1.0, 0.0, 16.0]]))


def test_nothing_known_stays_infinite() -> None:
    nothing = np.diag([np.inf, np.inf])
    found = POSE_ERROR_BAR.covariance(nothing, np.array([False, False]), ("yaw", "x"))
    assert np.isinf(np.diag(found)).all() and np.isfinite(found[0, 1])
