"""What `experiments.fit_yaw_set` computes itself, the objects it draws, and that what it found is what ships."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from experiments import fit_yaw_set
from experiments.common.symmetric_frames import turned_objects
from experiments.fit_yaw_set import Told, told_of
from sonarjax.refine import YAW_WEIGHTS, YawMode, YawSet

RNG = np.random.default_rng(5)
ONE_PEAK = -np.minimum(np.arange(36), 36 - np.arange(36)) / 36
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "fit_yaw_set.json"


def drawn_told(softness: float, count: int) -> list[Told]:
    """Two hypotheses a frame; the first is right as often as its score says, with errors of its error bar."""
    told = []
    for _ in range(count):
        gap = RNG.uniform(0, 3 * softness)
        right = RNG.random() < 1 / (1 + math.exp(-gap / softness))
        yaws = np.array([1.0, 4.0])
        true = yaws[0 if right else 1] + 0.02 * RNG.normal()
        rows = np.stack([yaws, [0.02, 0.02], [0.8, 0.8 - gap]], axis=-1)
        told.append(Told("a", True, float(true), rows, ONE_PEAK, 1.0, {}))
    return told


def test_the_fit_finds_the_softness_that_frames_were_drawn_with():
    weights, steps = fit_yaw_set.fit(drawn_told(0.02, 150))
    assert weights.softness in (0.015, 0.02, 0.03)
    assert steps[-1]["density"] >= steps[0]["density"]


def test_sets_hold_what_they_say_on_such_frames():
    told = drawn_told(0.02, 500)
    row = fit_yaw_set.judge(told, YAW_WEIGHTS._replace(softness=0.02, tail=0.0, tail_scale=2.0))
    assert row["within_68"] == pytest.approx(0.68, abs=0.06)
    assert row["within_95"] == pytest.approx(0.95, abs=0.03)
    assert row["first"] == pytest.approx(row["first_weight"], abs=0.06)
    assert (row["weight_decided"] or 0.0) > (row["weight_open"] or 0.0)


def test_the_true_mode_is_the_nearest_one_that_is_near():
    allowed = YawSet((YawMode(1.0, 0.02, 0.7), YawMode(4.0, 0.02, 0.3)))
    assert fit_yaw_set.true_weight(allowed, 4.05) == 0.3
    assert fit_yaw_set.true_weight(allowed, 1.0 + 2 * math.pi) == 0.7
    assert fit_yaw_set.true_weight(allowed, 2.5) == 0.0


def test_an_infinite_error_bar_comes_back_from_json():
    found = {"name": "a", "exact": True, "true": 1.0, "hypotheses": [[1.0, None, 0.5]], "curve": [0.0] * 36}
    assert told_of(found | {"first_yaw": 0.0, "evidence": {}}).hypotheses[0, 1] == math.inf


@pytest.mark.parametrize("name", ["two-fold pile", "long box", "low box", "pile, 1 cm off two-fold", "corner"])
def test_objects_look_the_same_after_their_period(name):
    mesh, period = turned_objects()[name]
    corners = np.unique(np.asarray(mesh.vertices).round(5), axis=0)
    turn = math.radians(180.0 if period == 360.0 else period)
    rotation = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    off = np.linalg.norm(corners[:, None] - (corners @ rotation.T)[None], axis=2).min(axis=1).max()
    assert off < 1e-4 if period < 360.0 else off > 0.01


def test_what_was_found_is_what_ships():
    (report,) = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert report["weights"] == pytest.approx(YAW_WEIGHTS._asdict())
