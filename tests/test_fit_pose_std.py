"""What `experiments.fit_pose_std` computes itself, and that what it found is what ships."""

from __future__ import annotations

import json
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import fit_pose_std
from experiments.common.leaning import errors
from experiments.fit_pose_std import Measured
from sonarjax.refine import POSE_ERROR_BAR, PoseErrorBar, PoseEstimate
from sonarjax.refine.free import ALL
from sonarjax.scene import Pose

RNG = np.random.default_rng(11)
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "fit_pose_std.json"


def drawn(bar: PoseErrorBar, count: int) -> Measured:
    """Errors as large as the error bar says."""
    angle = RNG.random(count) < 0.5
    std = np.where(angle, math.radians(1.0), 0.002) * RNG.uniform(0.05, 2.0, count)
    known = Measured(np.zeros(count), std, angle, np.full(count, "a"), np.ones(count))
    return Measured(np.abs(RNG.normal(size=count)) * fit_pose_std._std(bar, known), std, angle, known.name, known.views)


def test_the_fit_finds_the_error_bar_that_errors_were_drawn_from() -> None:
    bar = PoseErrorBar(factor=1.5, place=0.003, angle=math.radians(1.5))
    assert fit_pose_std.fit_pose_error_bar(drawn(bar, 20000)) == pytest.approx(bar, rel=0.1)


def test_errors_of_angles_are_the_short_way_round() -> None:
    truth = Pose(1.0, 2.0, 0.1, 0.3, -0.1, 0.0)
    pose = Pose(1.5, 2.0, 2 * math.pi - 0.1, 0.2, 0.1, 0.0)
    yes, one = jnp.bool_(True), jnp.float32(1)
    found = PoseEstimate(pose, jnp.zeros((6, 6)), one, one, yes, yes, jnp.ones(6, bool), jnp.ones(6), ALL)
    assert errors(truth, found) == pytest.approx([-0.2, 0.5, 0.0, -0.1, 0.2, 0.0], abs=1e-6)


def test_what_ships_is_what_was_found() -> None:
    (report,) = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert POSE_ERROR_BAR._asdict() == pytest.approx(report["error_bar"], rel=1e-3, abs=1e-6)
