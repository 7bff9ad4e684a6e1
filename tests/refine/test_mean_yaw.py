"""The mean over the poses near the best fit: its weights in closed form, its scores on renders, and what it gains."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.cpu import CpuEngine
from sonarjax.engine import Engine
from sonarjax.refine import MAP_REFINEMENT, Drawn, Start, on_frame, plan_refinement, refine_starts, with_mean_yaw
from sonarjax.refine.mean_yaw import SHIFTS, TURNS, mean_turn, mean_yaw, prepare_mean_yaw, scores_near
from sonarjax.refine.objective import ROW_STRIDE, make_blur
from sonarjax.refine.yaw import refine_and_draw
from sonarjax.scene.objects import box, join

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
CORNER = sj.Mesh.from_arrays(
    *join(box((0.34, 0.12, 0.10), (0.0, 0.0, 0.05)), box((0.12, 0.24, 0.16), (0.11, 0.14, 0.08)))
)
TRUTH = sj.Pose(x=2.3, y=0.05, yaw=0.6)
HOW = on_frame(MAP_REFINEMENT)
SIZE = plan_refinement(CORNER, SONAR, TRUTH, HOW)


@pytest.fixture(scope="module")
def frame() -> np.ndarray:
    return np.asarray(sj.render(CORNER, TRUTH, SONAR).semantic())


@pytest.fixture(scope="module")
def drawn(frame: np.ndarray) -> Drawn:
    """The template at the truth."""
    still = replace(HOW, bounds=(1e-6, 1e-6, 1e-6))
    return refine_and_draw(frame, CORNER, SONAR, TRUTH, None, still, SIZE, Engine())[1]


def scores(image: np.ndarray, drawn: Drawn, mask: np.ndarray | None = None) -> np.ndarray:
    return scores_near(image, mask, CORNER, SONAR, TRUTH, drawn, HOW, SIZE, Engine())


def best(found: np.ndarray) -> tuple[float, ...]:
    """Turn [rad], shift in bins and shift in beams of the highest score."""
    turn, *shifts = np.unravel_index(found.argmax(), found.shape)
    return float(TURNS[turn]), *(float(SHIFTS[k, axis]) for axis, k in enumerate(shifts))


def test_a_normal_likelihood_gives_its_own_mean() -> None:
    """The scores are those for which (1 − r²)^(−n/2) is a normal density of yaw, 0.4 of a step off the middle."""
    step = float(TURNS[1] - TURNS[0])
    mean, std, n = 0.4 * step, 0.7 * step, 300.0
    bins, beams = SHIFTS.T
    log = -0.5 * (((TURNS - mean) / std) ** 2)[:, None, None] - 0.5 * (bins[:, None] ** 2 + beams**2)
    found = np.sqrt(1 - (1 - 0.8**2) * np.exp(-2 * log / n))
    assert mean_turn(found, n) == pytest.approx(mean, abs=0.02 * step)


def test_the_number_of_pixels_says_how_sharp_the_likelihood_is() -> None:
    found = np.full((len(TURNS), len(SHIFTS), len(SHIFTS)), 0.5)
    found[-1, 3, 1] = 0.9
    assert mean_turn(found, 0.0) == pytest.approx(0.0, abs=1e-7)
    assert 0 < mean_turn(found, 3.0) < mean_turn(found, 30.0) < mean_turn(found, 300.0)
    assert mean_turn(found, 300.0) == pytest.approx(float(TURNS[-1]), rel=1e-6)


def test_a_blur_that_shifts_is_a_blur_of_the_shifted_image(rng: np.random.Generator) -> None:
    image = np.zeros((40, 24), np.float32)
    image[8:30, 6:18] = rng.normal(size=(22, 12))
    moved = make_blur(image.shape, 1.5, (3.0, -2.0))(jnp.asarray(image))
    expected = make_blur(image.shape, 1.5)(jnp.asarray(np.roll(image, (3, -2), (0, 1))))
    rows = slice(8 // ROW_STRIDE, 32 // ROW_STRIDE)  # away from the edge, where weights sum to 1 in another way
    np.testing.assert_allclose(moved[rows, 6:18], expected[rows, 6:18], atol=1e-5)


@pytest.mark.parametrize("turn", range(len(TURNS)))
def test_the_turn_that_is_shown_scores_highest(drawn: Drawn, turn: int) -> None:
    shown = sj.render(CORNER, replace(TRUTH, yaw=TRUTH.yaw + float(TURNS[turn])), SONAR).semantic()
    assert best(scores(np.asarray(shown), drawn)) == (float(TURNS[turn]), 0.0, 0.0)


def test_the_shift_that_is_shown_scores_highest(frame: np.ndarray, drawn: Drawn) -> None:
    assert best(scores(np.roll(frame, 1, axis=0), drawn)) == (0.0, 1.0, 0.0)
    assert best(scores(np.roll(frame, -1, axis=1), drawn))[2] < -0.5


def test_the_yaw_of_a_clean_frame_stays(frame: np.ndarray, drawn: Drawn) -> None:
    found = mean_yaw(frame, None, CORNER, SONAR, TRUTH, drawn, HOW, SIZE, Engine())
    assert found == pytest.approx(float(TRUTH.yaw), abs=math.radians(0.01))


def test_what_was_not_measured_does_not_count(frame: np.ndarray, drawn: Drawn) -> None:
    mask = np.ones(frame.shape, bool)
    mask[:, :44] = False
    hidden = np.where(mask, frame, np.nan)
    np.testing.assert_array_equal(scores(hidden, drawn, mask), scores(np.where(mask, frame, 0.3), drawn, mask))
    nowhere = np.zeros(frame.shape, bool)
    assert mean_yaw(frame, nowhere, CORNER, SONAR, TRUTH, drawn, HOW, SIZE, Engine()) == pytest.approx(0.6, abs=1e-6)


def test_a_pose_that_was_not_refined_keeps_its_yaw(frame: np.ndarray) -> None:
    search = SimpleNamespace(mesh=CORNER, sonar=SONAR)
    candidate: Any = SimpleNamespace(search=search, between_bins=lambda k: TRUTH)
    start = Start(candidate, 0, frame)
    found = refine_starts([start], frame, frame, None, MAP_REFINEMENT, lambda _: SIZE, Engine())[0]
    noise = np.random.default_rng(1).uniform(size=frame.shape).astype(np.float32)
    estimate = replace(found.estimate, converged=jnp.asarray(False), score=jnp.float32(0), start_score=jnp.float32(0.1))
    lost = found._replace(estimate=estimate)
    assert with_mean_yaw(lost, noise, None, MAP_REFINEMENT, Engine()) is lost
    moved = with_mean_yaw(found, noise, None, MAP_REFINEMENT, Engine())
    assert moved.pose.yaw != found.pose.yaw and moved.pose.x == found.pose.x
    assert moved.pose.yaw.dtype == np.float32


@pytest.mark.slow
def test_recognize_reports_the_mean_yaw(frame: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """The yaw alone moves: place, score and evidence stay those of the best fit."""
    recognizer = sj.Recognizer(CORNER, SONAR, segmenter="none")
    best = recognizer(frame, threshold=0.5)
    monkeypatch.setattr("sonarjax.refine.staged.mean_yaw", lambda *args: float(args[4].yaw) + 0.02)
    moved = recognizer(frame, threshold=0.5)
    assert moved.yaw == pytest.approx(best.yaw + 0.02, abs=1e-3)
    assert (moved.x, moved.y, moved.score, moved.evidence) == (best.x, best.y, best.score, best.evidence)


def test_what_is_prepared_is_what_runs(frame: np.ndarray, drawn: Drawn) -> None:
    engine = CpuEngine()
    prepare_mean_yaw(CORNER, SONAR, HOW, SIZE, engine)
    assert len(engine._programs) == 1
    pose = sj.Pose(*(np.float32(v) for v in (TRUTH.x, TRUTH.y, TRUTH.yaw)))
    mean_yaw(frame, None, CORNER, SONAR, pose, drawn, HOW, SIZE, engine)
    assert len(engine._programs) == 1
