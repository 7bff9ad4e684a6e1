"""What `geometry_std` adds to a yaw's error bar, against yaws that a wrong geometry really gives."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate import stated_std, yaw_std_of_geometry
from sonarjax.calibrate.parameters import changed_sonar
from sonarjax.sonar import GeometryStd

AZIMUTH = np.radians((np.arange(48) - 23.5) * 29 / 48).astype(np.float32)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20), azimuth=AZIMUTH, n_ranges=192, range_min=2.0, range_max=3.0)
MESH = sj.objects.target()
POSE = sj.Pose(2.3, 0.15, 0.8)
CONFIG = sj.RefineConfig(blurs=(1.0,), polish=0)
STATED = {"height": 0.02, "azimuth_scale": 0.04}


@pytest.fixture(scope="module")
def window():
    return sj.plan_refinement(MESH, SONAR, POSE, CONFIG)


def frame_of(sonar: sj.Sonar) -> np.ndarray:
    return np.asarray(sj.render(MESH, POSE, sonar).semantic())


def really(name: str, window) -> float:
    """Half the difference of the yaws that come out where the true geometry is a standard deviation to either side."""
    yaws = []
    for side in (-1, 1):
        true = changed_sonar(SONAR, (name,), jnp.array([side * STATED[name]]))
        yaws.append(float(sj.refine_yaw(frame_of(true), MESH, SONAR, POSE, config=CONFIG, window=window).yaw))
    return abs(math.remainder(yaws[1] - yaws[0], 2 * math.pi)) / 2


@pytest.mark.slow
def test_it_is_what_a_wrong_geometry_does_to_the_yaw(window):
    """A wrong sonar on a right frame moves the yaw as a right sonar does on a frame of the wrong one."""
    image = frame_of(SONAR)
    shares = {
        name: yaw_std_of_geometry(image, MESH, SONAR, POSE, {name: std}, CONFIG, window=window)
        for name, std in STATED.items()
    }
    for name, share in shares.items():
        assert share == pytest.approx(really(name, window), rel=0.3, abs=math.radians(0.15)), name
    both = yaw_std_of_geometry(image, MESH, SONAR, POSE, STATED, CONFIG, window=window)
    assert both == pytest.approx(math.hypot(*shares.values()), rel=1e-5)
    assert max(shares.values()) > math.radians(0.3), "nothing to see: the test would pass with zeros"


def test_an_incidence_limit_counts_only_if_there_is_one(monkeypatch):
    moved = []

    def refined(image, mesh, sonar, pose, **how):
        moved.append(float(sonar.highlight_max_incidence))
        return replace(pose, yaw=0.01 * moved[-1])

    monkeypatch.setattr(sys.modules["sonarjax.calibrate.yaw_error"], "refine_yaw", refined)
    stated, limited = {"highlight_max_incidence": 5.0}, SONAR.replace(highlight_max_incidence=60.0)
    image = np.zeros(SONAR.shape, np.float32)
    assert yaw_std_of_geometry(image, MESH, SONAR, POSE, stated, CONFIG) == 0.0
    assert yaw_std_of_geometry(image, MESH, limited, POSE, stated, CONFIG) == pytest.approx(0.05)
    assert sorted(moved) == [55.0, 60.0, 65.0]


@pytest.mark.parametrize(("up", "down", "std"), [(0.02, -0.02, 0.02), (0.02, 0.02, 0.02), (0.03, 0.0, 0.03 / 2**0.5)])
def test_a_yaw_that_turns_the_same_way_for_both_signs_counts(monkeypatch, up, down, std):
    def refined(image, mesh, sonar, pose, **how):
        by = float(sonar.tilt) - float(SONAR.tilt)
        return replace(pose, yaw=0.7 + (up if by > 1e-6 else down if by < -1e-6 else 0.0))

    monkeypatch.setattr(sys.modules["sonarjax.calibrate.yaw_error"], "refine_yaw", refined)
    image = np.zeros(SONAR.shape, np.float32)
    assert yaw_std_of_geometry(image, MESH, SONAR, POSE, {"tilt": 0.01}, CONFIG) == pytest.approx(std, rel=1e-4)


@pytest.mark.slow
def test_a_recognizer_adds_it_to_its_error_bar():
    """In quadrature; all else stays as it was."""
    image = frame_of(SONAR)
    stated = SONAR.replace(geometry_std=GeometryStd(azimuth_scale=0.04))
    plain, wide = (sj.Recognizer(MESH, s, segmenter="none")(image, threshold=0.5) for s in (SONAR, stated))
    assert (wide.yaw, wide.x, wide.y, wide.score) == (plain.yaw, plain.x, plain.y, plain.score)
    added = math.sqrt(wide.yaw_std**2 - plain.yaw_std**2)
    assert math.radians(0.3) < added < math.radians(3.0)


def test_only_what_is_stated_counts():
    assert stated_std(SONAR) == {}
    assert stated_std(SONAR.replace(geometry_std=GeometryStd(tilt=0.01))) == {"tilt": pytest.approx(0.01)}
    assert yaw_std_of_geometry(np.zeros(SONAR.shape, np.float32), MESH, SONAR, POSE, {}, CONFIG) == 0.0
