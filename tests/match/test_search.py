"""What a search makes of distances at which its target cannot be rendered."""

from __future__ import annotations

import math
from typing import Any

import pytest

import sonarjax as sj
from sonarjax.io.errors import OutOfViewError
from sonarjax.match import search as module
from sonarjax.match.search import TargetSearch

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))


def failing(error: Exception) -> Any:
    def template_bank(*_: Any, **__: Any) -> Any:
        raise error

    return template_bank


def test_only_a_target_that_is_out_of_view_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any other complaint, such as of a slice without room, is not mistaken for it."""
    search = TargetSearch(sj.objects.brick(), SONAR)
    monkeypatch.setattr(module, "template_bank", failing(OutOfViewError("far away")))
    assert search._render(2.5, False, False) is None
    monkeypatch.setattr(module, "template_bank", failing(sj.SonarjaxError("no room")))
    with pytest.raises(sj.SonarjaxError, match="no room"):
        search._render(2.5, False, False)
