"""Candidates: how their evidence is compared, against closed forms, and the windows that they share."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.engine import PLAIN
from sonarjax.refine import (
    COMPARISON,
    MAP_REFINEMENT,
    Candidate,
    Look,
    Start,
    agreeing,
    candidates,
    compared,
    plan_refinement,
    plan_shared,
)
from sonarjax.scene.objects import box

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20), height=0.9)


def evidence(**more: float) -> dict[str, float]:
    return dict.fromkeys(COMPARISON, 0.5) | more


def looks(*names: str) -> list[Look]:
    searches: list[Any] = [SimpleNamespace(name=name) for name in names]
    return [Look(Candidate(search, None, 2.3, 0.0)) for search in searches]  # type: ignore[arg-type]


def test_probabilities_are_those_of_the_weighed_evidence() -> None:
    better = 0.5 + 1 / COMPARISON["frame_fit"]  # one more in the log-odds
    ranked = compared(looks("a", "b", "c"), [evidence(), evidence(frame_fit=better), evidence()])
    assert [look.name for look, _ in ranked] == ["b", "a", "c"]
    assert [share for _, share in ranked] == pytest.approx([math.e / (math.e + 2), *2 * [1 / (math.e + 2)]])


def test_what_fits_better_counts_for_a_candidate_and_what_is_left_against_it() -> None:
    for name in ("map_fit", "frame_fit", "coarse_fit", "unexplained", "left_over"):
        more = compared(looks("less", "more"), [evidence(), evidence(**{name: 0.6})])[0][0].name
        assert more == ("less" if name in ("unexplained", "left_over") else "more"), name


@pytest.mark.parametrize(
    ("size", "beams"), [((0.1, 0.1, 0.1), 32), ((0.5, 0.1, 0.05), 48), ((0.1, 0.1, 0.4), 48), ((0.3, 0.3, 0.3), 48)]
)
def test_a_shared_window_holds_what_is_needed_and_is_one_of_few(size: tuple[float, float, float], beams: int) -> None:
    mesh, at = sj.Mesh.from_arrays(*box(size, (0.0, 0.0, size[2] / 2))), sj.Pose(2.3)
    shared = plan_shared(mesh, SONAR, at, MAP_REFINEMENT)
    assert shared.holds(plan_refinement(mesh, SONAR, at, MAP_REFINEMENT))
    assert shared.shape[0] in (256, 512) and shared.shape[1] in (64, 96)
    assert shared.object_columns == beams


def matched(x: float, y: float, best: int) -> Candidate:
    """A box of 20 x 20 cm that matched best at one of 36 yaw bins, which were rendered for a target straight ahead."""
    search: Any = SimpleNamespace(mesh=sj.Mesh.from_arrays(*box((0.2, 0.2, 0.1), (0.0, 0.0, 0.05))))
    bank = SimpleNamespace(x=2.3, y=0.0, yaws=np.arange(36) * math.radians(10.0))
    match: Any = SimpleNamespace(bank=bank, scores=np.eye(36)[best])
    return Candidate(search, match, x, y)


@pytest.mark.parametrize(
    ("x", "y", "best", "same"),
    [
        (2.3, 0.0, 0, True),
        (2.3, 0.0, 1, True),
        (2.3, 0.0, 35, True),
        (2.3, 0.0, 34, False),
        (2.3, 0.13, 35, True),
        (2.45, 0.0, 0, False),
        (2.3, 0.15, 0, False),
        (2.3, 0.0, 2, False),
    ],
)
def test_matches_agree_within_the_object_and_a_neighbouring_bin(x: float, y: float, best: int, same: bool) -> None:
    assert agreeing(matched(2.3, 0.0, 0), matched(x, y, best)) is same


def test_yaws_agree_whatever_the_bearings_of_their_banks() -> None:
    turned = matched(2.3, 0.12, 0)
    turned.match.bank.y = 0.9  # a bank rendered at another bearing: its bins are 21 deg less here
    assert not agreeing(matched(2.3, 0.12, 0), turned)
    turned.match.scores = np.eye(36)[2]
    assert agreeing(matched(2.3, 0.12, 0), turned)


def test_of_a_candidates_refinements_the_better_fit_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = iter([0.9, 0.4, 0.3, 0.7])
    image, found_in = np.zeros((4, 4), np.float32), SimpleNamespace(search=SimpleNamespace(mesh=None, sonar=None))
    starts = [Start(found_in, 0, image, sj.Pose(yaw=yaw)) for yaw in (0.0, 2.0)]  # type: ignore[arg-type]
    monkeypatch.setattr(candidates, "make_starts", lambda *given: starts)
    monkeypatch.setattr(candidates, "refine_and_draw", lambda *given: (None, None))
    monkeypatch.setattr(candidates, "evidence_of", lambda *given: SimpleNamespace(frame_fit=next(fits)))
    monkeypatch.setattr(candidates, "curve_evidence", lambda *given: {})
    pair = [Look(SimpleNamespace(score=0.5))] * 2  # type: ignore[arg-type]
    seen = candidates.quick_evidence(pair, image, image, None, MAP_REFINEMENT, lambda *given: None, PLAIN)
    assert [one["frame_fit"] for one in seen] == [0.9, 0.7]


def test_one_of_several_is_matched_again_by_its_echoes_where_it_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "locate", lambda *given: given)
    search: Any = SimpleNamespace(nearest=lambda match: {"matched": 3}[match])
    seen: Any = SimpleNamespace(search=search, match="matched")
    image = np.zeros((4, 4), np.float32)
    again: Any = (search, image, None, "frame", 3)
    assert candidates.by_echoes(Look(seen, seen), image, None) == Look(seen, again)
    assert candidates.by_echoes(Look(seen), image, None) == Look(seen)
