"""Refinement in stages: most of the work goes to the best start, and what is not there is not reported."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.engine import Engine
from sonarjax.refine import MAP_REFINEMENT, RefinedStart, Start, refine_starts
from sonarjax.refine.pose import _refine
from sonarjax.refine.starts import kept_pose
from sonarjax.refine.yaw import YawEstimate
from sonarjax.scene.objects import box

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
MESH = sj.Mesh.from_arrays(*box((0.3, 0.14, 0.12), (0.0, 0.0, 0.06)))
TRUTH = sj.Pose(x=2.3, y=0.05, yaw=0.6)


class Counting(Engine):
    """Counts the refinements that it runs."""

    def __init__(self) -> None:
        self.refinements = 0

    def run(self, function: Any, *args: Any, **static: Any) -> Any:
        self.refinements += function is _refine
        return super().run(function, *args, **static)


@pytest.fixture(scope="module")
def frame() -> np.ndarray:
    return np.asarray(sj.render(MESH, TRUTH, SONAR).semantic())


def refined(
    frame: np.ndarray, *degrees_off: float, expected: tuple[sj.Pose, ...] = ()
) -> tuple[list[RefinedStart], int]:
    """Refined starts at these yaws beside the truth and at the `expected` poses, and the number of refinements."""
    search, engine = SimpleNamespace(mesh=MESH, sonar=SONAR), Counting()
    poses = [sj.Pose(TRUTH.x + 0.01, TRUTH.y - 0.01, TRUTH.yaw + math.radians(off)) for off in degrees_off]
    candidate: Any = SimpleNamespace(search=search, between_bins=lambda k: poses[k])
    starts = [Start(candidate, k, frame) for k in range(len(poses))]
    starts += [Start(candidate, 0, frame, pose) for pose in expected]
    found = refine_starts(starts, frame, frame, None, MAP_REFINEMENT, lambda _: None, engine)
    return found, engine.refinements


def off_deg(one: RefinedStart) -> float:
    return math.degrees(math.remainder(float(one.pose.yaw) - float(TRUTH.yaw), 2 * math.pi))


def test_a_refined_start_keeps_its_lift_and_lean() -> None:
    numbers = {"yaw": 0.4, "x": 2.1, "y": 0.1, "yaw_std": 0.01, "score": 0.9, "start_score": 0.5}
    true = jnp.array(True)
    estimate = YawEstimate(**{k: jnp.float32(v) for k, v in numbers.items()}, converged=true, determined=true)
    pose = kept_pose(estimate, sj.Pose(2.0, 0.0, 0.3, z=0.2, roll=0.1, pitch=-0.1))
    assert [float(v) for v in (pose.x, pose.yaw, pose.z, pose.roll, pose.pitch)] == pytest.approx(
        [2.1, 0.4, 0.2, 0.1, -0.1]
    )


def test_starts_that_meet_count_once_and_only_the_best_is_refined_to_the_end(frame: np.ndarray) -> None:
    found, refinements = refined(frame, 3.0, -4.0, 60.0)
    assert abs(off_deg(found[0])) < 0.3 and bool(found[0].estimate.converged)
    assert sum(abs(off_deg(one)) < 20.0 for one in found) == 1
    assert found == sorted(found, key=lambda one: -one.fit)
    assert refinements == 3 + 3 + 1  # on the map and briefly on the frame, and only the best one to its end


def test_both_yaws_of_a_box_that_looks_the_same_are_refined_to_the_end(frame: np.ndarray) -> None:
    found, refinements = refined(frame, 3.0, 177.0)
    assert sorted(abs(off_deg(one)) for one in found) == pytest.approx([0.0, 180.0], abs=0.3)
    assert refinements == 2 + 2 + 2


def test_an_expected_pose_counts_only_where_the_frame_shows_it(frame: np.ndarray) -> None:
    nowhere = sj.Pose(x=3.4, y=-0.4, yaw=0.0)
    found, _ = refined(frame, 3.0, expected=(nowhere, sj.Pose(TRUTH.x, TRUTH.y, TRUTH.yaw + 0.02)))
    assert len(found) == 1 and abs(off_deg(found[0])) < 0.3


def test_what_only_the_frame_shows_comes_behind_what_the_map_shows_too(frame: np.ndarray) -> None:
    """A strong echo elsewhere, such as a wall, can look more like the template than a noisy target does."""
    elsewhere = sj.Pose(TRUTH.x + 0.8, TRUTH.y, TRUTH.yaw)
    noise = 0.25 * np.random.default_rng(2).normal(size=frame.shape).astype(np.float32)
    strong = np.asarray(sj.render(MESH, elsewhere, SONAR).semantic())
    image = np.where(strong == 0.5, frame + noise, strong)
    search: Any = SimpleNamespace(mesh=MESH, sonar=SONAR)
    candidate: Any = SimpleNamespace(search=search, between_bins=lambda k: (elsewhere, TRUTH)[k])
    starts = [Start(candidate, 0, image), Start(candidate, 1, frame)]
    first, second = refine_starts(starts, image, frame, None, MAP_REFINEMENT, lambda _: None, Engine())
    assert first.score < second.score and first.fit > second.fit
    assert float(first.pose.x) == pytest.approx(float(TRUTH.x), abs=0.02)
