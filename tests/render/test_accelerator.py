"""What an accelerator computes at once is what a CPU computes one by one.

The accelerator's way is taken here on the CPU, by saying that there is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import jax
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.cpu import CpuEngine, usual_engine
from sonarjax.scene.objects import brick

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9, range_min=1.5, range_max=4.0)
YAWS = np.linspace(0, 2 * math.pi, 40, endpoint=False)


@pytest.fixture
def an_accelerator(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    jax.clear_caches()  # what was traced for the CPU would be used again
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    yield
    jax.clear_caches()


def test_entry_points_use_plain_jax_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert not isinstance(usual_engine(), CpuEngine)


def test_a_cpu_has_its_own_engine() -> None:
    assert isinstance(usual_engine(), CpuEngine)


@pytest.mark.slow
def test_views_of_a_bank(request: pytest.FixtureRequest) -> None:
    one_by_one = sj.template_bank(brick(), SONAR, YAWS, x=2.3)
    request.getfixturevalue("an_accelerator")
    at_once = sj.template_bank(brick(), SONAR, YAWS, x=2.3)
    assert at_once.templates.shape == one_by_one.templates.shape
    np.testing.assert_allclose(at_once.templates, one_by_one.templates, atol=1e-4)


@pytest.mark.slow
def test_frames_that_are_refined(request: pytest.FixtureRequest, key: jax.Array) -> None:
    truth = sj.Pose(np.float32([2.3, 2.25]), np.float32([0.05, -0.1]), np.float32([0.7, 2.0]))
    frames = np.asarray(sj.render(brick(), truth, SONAR).semantic())
    frames = np.clip(frames + 0.05 * np.asarray(jax.random.normal(key, frames.shape)), 0, 1)
    start = sj.Pose(truth.x + 0.01, truth.y - 0.01, truth.yaw + 0.1)
    config = sj.RefineConfig(polish=0)
    one_by_one = sj.refine_yaw(frames, brick(), SONAR, start, config=config)
    request.getfixturevalue("an_accelerator")
    at_once = sj.refine_yaw(frames, brick(), SONAR, start, config=config)
    np.testing.assert_allclose(at_once.yaw, one_by_one.yaw, atol=math.radians(0.05))
    np.testing.assert_allclose(at_once.x, one_by_one.x, atol=2e-4)
    np.testing.assert_allclose(at_once.yaw, truth.yaw, atol=math.radians(1.0))
