"""The text of a calibration: which error bar a reader should take."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate import Calibration, compare_templates, describe_calibration
from sonarjax.sensor import SensorModel


def calibration(**changes: Any) -> Calibration:
    """A calibration of the tilt as if it had been made: 1° more, with a standard deviation of 0.1°."""
    values = {
        "sonar": sj.Sonar.preset("didson-hf"), "sensor": SensorModel(), "free": ("tilt",),
        "poses": sj.Pose(np.array([2.0]), 0.0, np.array([0.5])), "change": np.array([math.radians(1.0)]),
        "covariance": np.array([[math.radians(0.1) ** 2]]), "determined": {"tilt": True},
        "bound": {"tilt": math.radians(0.05)}, "singular_values": np.array([9.0]), "weakest": {"tilt": 1.0},
        "used": np.array([True]), "probability": np.array([0.9]), "residual": np.array([1.0]), "converged": True,
    }  # fmt: skip
    return Calibration(**(values | changes))


@pytest.mark.parametrize(
    ("bound", "added"), [(0.05, ""), (0.15, " (Cramér-Rao bound 0.15°: take this larger error bar)")]
)
def test_bound_is_told_where_it_is_larger(bound: float, added: str) -> None:
    found = calibration(bound={"tilt": math.radians(bound)})
    text = describe_calibration(found, sj.Sonar.preset("didson-hf"), ["a.png"]).splitlines()
    assert text[0] == f"tilt: 16°, changed by +1° ± 0.1°{added}"


def test_undetermined_number_has_no_error_bar() -> None:
    found = calibration(determined={"tilt": False}, bound={"tilt": 1.0})
    text = describe_calibration(found, sj.Sonar.preset("didson-hf"), ["a.png"]).splitlines()
    assert text[0] == "tilt: not determined by these frames, left at its nominal value"


@pytest.mark.parametrize(
    ("change", "determined", "said"),
    [
        (-10.0, True, "highlight_max_incidence: 60°, changed by -10° ± 4°"),
        (0.0, False, "highlight_max_incidence: not determined by these frames, left at its nominal value"),
        (20.0, False, "highlight_max_incidence: not determined by these frames, which show no limit"),
    ],
)
def test_an_incidence_limit_is_told_in_degrees(change: float, determined: bool, said: str) -> None:
    name = "highlight_max_incidence"
    found = calibration(
        free=(name,), change=np.array([change]), covariance=np.array([[16.0]]), determined={name: determined},
        bound={name: 3.0}, weakest={name: 1.0},
    )  # fmt: skip
    nominal = sj.Sonar.preset("didson-hf", highlight_max_incidence=70.0)
    assert describe_calibration(found, nominal, ["a.png"]).splitlines()[0] == said


def test_a_comparison_shows_the_nominal_sonar_first() -> None:
    nominal = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
    nominal = nominal.replace(azimuth=nominal.azimuth[36:60])
    fitted = nominal.replace(tilt=nominal.tilt + 0.1, height=nominal.height + 0.1)
    poses = sj.Pose([2.2, 2.3], 0.0, [0.3, 0.9])
    made = calibration(used=np.array([False, True]), poses=poses, sonar=fitted)
    images, before, later = compare_templates(made, ["a", "b"], sj.objects.brick(), nominal)
    assert images == ["b"]
    for maps, one in ((before, nominal), (later, fitted)):
        shown = sj.render(sj.objects.brick(), sj.Pose(2.3, 0.0, 0.9), one).semantic()
        np.testing.assert_array_equal(maps[0], np.asarray(shown))
