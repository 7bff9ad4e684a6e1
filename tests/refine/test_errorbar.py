"""The error bar of a refined yaw: its closed form, and what it does with extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sonarjax.refine import ERROR_BAR, ErrorBar


def test_it_is_a_power_of_the_curvatures_times_exponentials_of_the_evidence() -> None:
    bar = ErrorBar(offset=-1.0, power=0.5, left_over=2.0, rise=-3.0)
    std = bar.std(np.array([1e-3, 4e-3]), np.array([0.2, 0.4]), 0.1)
    assert std == pytest.approx([math.exp(-1.0 - 0.3 + 2 * v) * math.sqrt(s) for s, v in ((1e-3, 0.2), (4e-3, 0.4))])


def test_what_cannot_be_compared_is_infinitely_uncertain() -> None:
    assert ERROR_BAR.std(np.array([np.inf]), np.array([0.5]), 0.1)[0] == np.inf
    assert 0 < ERROR_BAR.std(np.array([0.0]), np.array([0.0]), 1.0)[0] < math.radians(1.0)


def test_more_left_over_and_a_lower_peak_mean_a_larger_error() -> None:
    std = ERROR_BAR.std(np.full(3, 2e-3), np.array([0.2, 0.6, 0.2]), np.array([0.2, 0.2, 0.05]))
    assert std[1] > std[0] and std[2] > std[0]
