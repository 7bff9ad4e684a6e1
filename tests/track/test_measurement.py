"""What one frame's recognition says to the belief: error bars, tails and weights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sonarjax.track import TrackConfig, measurement_of
from tests.track.measurements import STD, found


def test_a_hypothesis_is_entered_with_its_error_and_with_that_of_the_tails() -> None:
    config = TrackConfig(hypotheses=1)
    one = measurement_of(found([1.0], probability=0.9), 36, config, np.zeros(3), 1.0)
    np.testing.assert_allclose(one.std[0], [config.yaw_scale * STD, config.place_std, config.place_std], rtol=1e-5)
    np.testing.assert_allclose(one.std[1], config.tail_scale * one.std[0], rtol=1e-5)
    right = 0.9 * (1 - config.misses)
    np.testing.assert_allclose(np.exp(one.log_weight), right * np.array([1 - config.tail, config.tail]), rtol=1e-5)
    assert math.exp(float(one.log_miss)) == pytest.approx(1 - right, rel=1e-5)


def test_without_an_error_bar_the_error_is_that_of_a_bin() -> None:
    seen = found([1.0])
    seen = replace(seen, hypotheses=tuple(replace(h, yaw_std=None) for h in seen.hypotheses))
    one = measurement_of(seen, 36, TrackConfig(yaw_scale=1.0, hypotheses=1), np.zeros(3), 1.0)
    assert float(one.std[0, 0]) == pytest.approx(math.radians(10.0) / math.sqrt(12), rel=1e-5)
