"""What a search makes of distances at which its target cannot be rendered."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.io.errors import OutOfViewError
from sonarjax.match import first_look, search
from sonarjax.match.first_look import FirstLook
from sonarjax.match.lean import LeanSearch, LeanSearchConfig
from sonarjax.match.search import SearchConfig, TargetSearch, rounded_up

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))


def failing(error: Exception) -> Any:
    def template_bank(*_: Any, **__: Any) -> Any:
        raise error

    return template_bank


def brick() -> TargetSearch:
    return TargetSearch(sj.objects.brick(), SONAR, compact=True)


@pytest.mark.parametrize(
    ("module", "look"),
    [
        (search, lambda: brick()._prepared(0, False, False, "map")),
        (first_look, lambda: FirstLook([brick()])._view(brick(), 2.5)),
    ],
)
def test_only_a_target_that_is_out_of_view_is_passed_over(
    module: ModuleType, look: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any other complaint, such as of a slice without room, is not mistaken for it."""
    monkeypatch.setattr(module, "template_bank", failing(OutOfViewError("far away")))
    assert look() is None
    monkeypatch.setattr(module, "template_bank", failing(sj.SonarjaxError("no room")))
    with pytest.raises(sj.SonarjaxError, match="no room"):
        look()


def test_a_fan_to_one_side_is_searched_in_its_middle() -> None:
    """The target is seen though the sonar has no beam straight ahead."""
    azimuth = np.radians(np.linspace(8.0, 34.0, 64)).astype(np.float32)
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), azimuth=azimuth)
    truth, mesh = sj.Pose(x=2.1, y=1.0, yaw=0.7), sj.objects.target()
    image = np.asarray(sj.render(mesh, truth, sonar).semantic())
    search = TargetSearch(mesh, sonar, SearchConfig(yaw_bins=12))
    match = search.find(image)
    assert math.dist(search.place(match), (2.1, 1.0)) < 0.05
    bearing = math.atan2(1.0, 2.1) - float(match.bank.bearing)
    yaw = float(match.bank.yaws[match.scores.argmax()]) + bearing
    assert abs(math.remainder(yaw - 0.7, 2 * math.pi)) < math.radians(15.5)
    lean = LeanSearch(search, ("yaw", "x", "y"), LeanSearchConfig(yaw_bins=12)).find(image)
    assert abs(math.remainder(float(lean.poses.yaw[0]) - yaw, 2 * math.pi)) < math.radians(2.0)


@pytest.mark.parametrize(("frame", "shape"), [((128, 96), (64, 32)), ((60, 24), (60, 24))])
def test_coarse_templates_grow_behind_and_to_port_within_the_frame(
    frame: tuple[int, int], shape: tuple[int, int]
) -> None:
    drawn = np.random.default_rng(0).random((2, 50, 20)).astype(np.float32)
    padded = rounded_up(drawn, frame)
    assert padded.shape[1:] == shape
    np.testing.assert_array_equal(padded[:, :50, :20], drawn)
    assert (padded[:, 50:] == 0.5).all() and (padded[:, :, 20:] == 0.5).all()


def test_a_bank_says_that_its_object_is_out_of_view() -> None:
    with pytest.raises(OutOfViewError, match="an object at x 50.00 m, y 0.00 m is outside the sonar's view"):
        sj.template_bank(sj.objects.brick(), SONAR, [0.0], x=50.0)
