"""What the experiments outside our own simulator are judged by, against closed forms and simulated errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from experiments import fit_decision, fit_error_bar, outside
from experiments.common.outside import OutsideFrame, OutsideSet
from experiments.common.runs import Job
from experiments.common.scores import area
from experiments.common.segmenters import loaded
from experiments.common.validation import shown_in, symmetric_scenes
from experiments.fit_decision import Measured
from experiments.outside import Verdict
from sonarjax.refine import ERROR_BAR, ErrorBar
from sonarjax.segment import EVIDENCE

RNG = np.random.default_rng(7)
FITTED = Path(__file__).parents[1] / "docs/results/fit_error_bar.json"


def measured(own: np.ndarray, **values: np.ndarray) -> Measured:
    count = len(own)
    names = ("own_rise", "error_deg", "std_deg", "bank", "refined", "agree")
    plain = {name: np.zeros(count) for name in names}
    return Measured(**({"evidence": np.zeros((count, 2)), "own": own} | plain | values))


def test_area_counts_the_pairs_in_the_right_order() -> None:
    score, own = RNG.normal(size=60).round(1), RNG.random(60) < 0.4
    pairs = [(a > b) + 0.5 * (a == b) for a in score[own] for b in score[~own]]
    assert area(score, own) == pytest.approx(np.mean(pairs))


def test_the_logistic_fit_finds_the_log_odds_it_was_drawn_from() -> None:
    evidence = RNG.normal(size=(20000, 2)) * [1.0, 0.1]
    odds = 1.5 * evidence[:, 0] - 20.0 * evidence[:, 1]
    own = RNG.random(len(odds)) < 1 / (1 + np.exp(-odds))
    weights, offset = fit_decision.fit_logistic(evidence, own)
    assert weights == pytest.approx([1.5, -20.0], rel=0.08)
    assert offset == pytest.approx(0.0, abs=0.08)


def test_error_bars_are_fitted_to_errors_drawn_from_them() -> None:
    drawn, count = ErrorBar(-2.0, 0.6, -0.4, -0.2), 8000
    drop, std = RNG.uniform(0.0, 0.2, count), np.exp(RNG.uniform(-4.0, 0.0, count))
    given = fit_error_bar.Measured(std, drop, RNG.uniform(0.01, 1.0, count), np.zeros(count))
    error = np.abs(RNG.normal(size=count)) * np.degrees(fit_error_bar.std_of(drawn, given))
    found = fit_error_bar.fit_error_bar(replace(given, error_deg=error))
    assert fit_error_bar.std_of(found, given) == pytest.approx(fit_error_bar.std_of(drawn, given), rel=0.15)
    assert found.odds == pytest.approx(drawn.odds, abs=0.02)
    assert fit_error_bar.fit_error_bar(replace(given, error_deg=error), with_score=False).odds == 0


def test_the_error_bar_that_ships_is_the_one_that_was_fitted() -> None:
    (report,) = json.loads(FITTED.read_text(encoding="utf-8"))
    assert ERROR_BAR._asdict() == pytest.approx(report["error_bar"], rel=1e-3)


def test_a_frame_is_right_where_the_target_is_found_with_its_yaw() -> None:
    """Found and close, found and far, missed, refused, taken for the target, ended in an error."""
    own = np.array([True, True, True, False, False, False])
    score = np.array([0.9, 0.9, 0.1, 0.1, 0.9, np.nan])
    identified = np.array([True, True, False, False, True, False])
    error = np.array([1.0, 40.0, 2.0, 90.0, 90.0, np.nan])
    row = outside._summary(Verdict(score, identified, error, np.full(6, 1.5)), own)
    assert row["right"] == pytest.approx(2 / 6) and row["errors"] == 1
    assert row["identified"] == pytest.approx(2 / 3) and row["refused"] == pytest.approx(1 / 3)
    assert row["astray"] == pytest.approx(1 / 3)
    assert row["within_1"] == pytest.approx(0.5) and row["within_2"] == pytest.approx(1.0)


def test_the_gain_over_another_score_has_a_lower_end() -> None:
    own = RNG.random(200) < 0.5
    good, poor = (Verdict(own + spread * RNG.normal(size=200), own, *np.zeros((2, 200))) for spread in (0.3, 2.0))
    gain = outside._against(good, poor, own)
    assert 0 < gain["auc_gap_low"] < gain["auc_gap"] < 0.5
    assert outside._against(good, good, own)["auc_gap"] == 0


def test_error_bars_that_rank_frames_have_a_large_ratio() -> None:
    std = RNG.uniform(0.2, 2.0, 800)
    ranked = [[std.tolist(), (np.abs(RNG.normal(size=800)) * std).tolist()]]
    ratio = outside._rank_ratio(ranked)
    assert ratio is not None and 3.0 < ratio < 8.0
    assert outside._rank_ratio([[std.tolist(), [1.0] * 800]]) == pytest.approx(1.0)
    assert outside._rank_ratio([]) is None


def test_several_trainings_give_a_mean_and_its_largest_deviation(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One training finds every target, the other every second one."""
    own = np.tile([True, True, False, False], 20)

    def verdict(_: Any, frames: Any, name: str, rule_of: str) -> Verdict:
        found = own if name != "second" else own & (np.arange(len(own)) % 2 == 0)
        return Verdict(own + 0.1, found, np.linspace(0.1, 1.0, len(own)), np.linspace(0.1, 1.0, len(own)))

    sonar = sj.Sonar.preset("didson-hf", tilt=0.3, height=0.9)
    frames = [OutsideFrame(np.zeros((2, 2)), sonar, bool(one), 0.0) for one in own]
    monkeypatch.setattr(outside, "_verdict", verdict)
    monkeypatch.delenv("SONARJAX_EXTERNAL_DATA", raising=False)
    monkeypatch.delenv("SONARJAX_REAL_DATA", raising=False)
    monkeypatch.setattr(outside, "judge_set", lambda *_: OutsideSet("judge", sj.objects.target(), frames))
    settings = outside.Settings(judged=("offset",), own=(), external_sets=(), trainings=("second",))
    report = outside.run(settings, Job(tmp_path, 0))
    row = report["rows"][0]
    assert row["right"] == "0.875 ± 0.125" and row["identified"] == "0.750 ± 0.250" and row["refused"] == 1.0
    assert [one["rows"][0]["right"] for one in report["trainings"]] == [1.0, 0.75]
    assert "0.875 ± 0.125" in outside.table(report)


def test_the_rule_of_another_segmenter_decides_for_weights_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[tuple[Any, float | None]] = []

    def recognizer(*_: Any, segmenter: sj.Segmenter, engine: Any) -> Any:
        found = SimpleNamespace(score=0.9, yaw=0.0, yaw_std=0.1, identified=True)
        return lambda image, threshold: used.append((segmenter, threshold)) or found

    monkeypatch.setattr(sj, "Recognizer", recognizer)
    frame = OutsideFrame(np.zeros((2, 2)), sj.Sonar.preset("didson-hf", tilt=0.3, height=0.9), True, 0.0)
    judged = OutsideSet("judge", sj.objects.target(), [frame])
    for name, rule_of in (("paper-cpu", ""), ("paper-cpu", "pix2pix"), ("none", "pix2pix")):
        assert outside._verdict(judged, judged.frames, name, rule_of).identified.all()
    rules, thresholds = [segmenter.rule for segmenter, _ in used], [threshold for _, threshold in used]
    assert rules == [None, loaded("pix2pix").rule, loaded("none").rule]
    assert thresholds == [loaded("paper-cpu").threshold, None, None]


def test_a_score_is_no_higher_than_the_probability_that_anything_is_shown() -> None:
    """Two groups that the first rule cannot tell apart, one of them without any fit: the second rule does."""
    evidence = np.zeros((60, 8))
    evidence[:40, :2] = 0.8 + 0.05 * RNG.normal(size=(40, 2))
    evidence[40:, :2] = 0.2 + 0.05 * RNG.normal(size=(20, 2))
    own, filled = np.arange(40) % 2 == 0, np.arange(60) < 40
    evidence[:40, 3] = np.where(own, 0.1, 0.4) + 0.02 * RNG.normal(size=40)
    given = measured(np.append(own, np.zeros(20, bool)), evidence=evidence, own_rise=np.ones(60))
    rule = fit_decision.fit_rule(given, filled, filled, filled)
    found = fit_decision.score(rule, given) >= fit_decision.THRESHOLD
    alone = fit_decision.score(replace(rule, presence=None), given) >= fit_decision.THRESHOLD
    assert alone[~filled].all() and (found[filled] == own).all() and not found[~filled].any()


def test_symmetric_targets_are_judged_without_the_rises() -> None:
    """The rises tell targets from others where they can, the fit to the map does everywhere."""
    count = 400
    own, flat = np.arange(count) % 2 == 0, np.arange(count) >= count // 2
    evidence = 0.05 * RNG.normal(size=(count, len(EVIDENCE)))
    evidence[:, 0] += np.where(own, 0.10, 0.0)
    evidence[:, 5:7] += np.where(own & ~flat, 0.3, 0.0)[:, None]
    given = measured(own, evidence=evidence, own_rise=np.where(flat, 0.0, 0.4))
    every, filled = np.ones(count, bool), np.arange(count) % 10 > 0
    rule = fit_decision.fit_rule(given, ~flat, every, filled)
    assert rule.flat is not None and rule.flat.weights[5:7] == (0.0, 0.0)
    found = fit_decision.score(replace(rule, presence=None), given) >= fit_decision.THRESHOLD
    missed = fit_decision.score(replace(rule, presence=None, flat=None), given) < fit_decision.THRESHOLD
    assert (found == own)[~flat].mean() > 0.97 and (found == own)[flat].mean() > 0.75
    assert missed[own & flat].mean() > 0.8


def test_symmetric_validation_objects_look_the_same_when_turned() -> None:
    """Their own mirror image is never shown as another object, and the other one is not the target again."""
    turns = {"spool": 2 * np.pi / 20, "low drum": 2 * np.pi / 24, "prism": np.pi / 2, "long box": np.pi}
    assert set(turns) == set(symmetric_scenes())
    for name, scene in symmetric_scenes().items():
        corners, others = (np.asarray(mesh.vertices, float) for mesh in (scene.target, scene.other))
        cos, sin = np.cos(turns[name]), np.sin(turns[name])
        turned = corners @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        apart = [np.linalg.norm(v[:, None] - corners[None], axis=-1).min(axis=1).max() for v in (turned, others)]
        assert apart[0] < 1e-5 < 0.01 < apart[1]
        assert {shown_in(name, turn) for turn in range(8)} == {0, 1}
