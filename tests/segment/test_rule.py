"""The identification rule: its probability, and what is refused in a weights file."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from sonarjax.io import SonarjaxError
from sonarjax.segment import EVIDENCE, IdentificationRule
from sonarjax.segment.rule import FULL_RISE, Logistic, read_rule

RULE = IdentificationRule(tuple(float(k) for k in range(len(EVIDENCE))), -1.5, 0.4, 0.05)
PRESENCE = Logistic((2.0, *(0.0 for _ in EVIDENCE[1:])), -1.0)


def test_probability_is_logistic_in_the_evidence() -> None:
    evidence = {name: 0.1 for name in EVIDENCE}
    odds = -1.5 + 0.1 * sum(range(len(EVIDENCE)))
    assert RULE.probability(evidence) == pytest.approx(1 / (1 + math.exp(-odds)))
    assert RULE.probability(evidence | {EVIDENCE[-1]: 1e9}) == pytest.approx(1.0)
    assert RULE.probability(evidence | {EVIDENCE[-1]: math.nan}) == 0.0


def test_the_target_is_no_likelier_than_that_anything_is_shown() -> None:
    rule = replace(RULE, presence=PRESENCE)
    for fit in (-1.0, 0.2, 3.0):
        evidence = dict.fromkeys(EVIDENCE, 0.1) | {"map_fit": fit}
        there = 1 / (1 + math.exp(1.0 - 2.0 * fit))
        assert PRESENCE.probability(evidence) == pytest.approx(there)
        assert rule.probability(evidence) == pytest.approx(min(RULE.probability(evidence), there))
    assert rule.probability(dict.fromkeys(EVIDENCE, 0.1) | {"map_fit": math.nan}) == 0.0


def test_a_rule_comes_back_from_its_json() -> None:
    with_presence = replace(RULE, presence=PRESENCE)
    for rule in (RULE, with_presence, replace(with_presence, flat=replace(PRESENCE, offset=2.0))):
        assert read_rule(json.loads(json.dumps(rule.as_json())), "w.safetensors") == rule
    assert read_rule(None, "w.safetensors") is None


def test_a_flat_target_is_judged_by_its_own_weights() -> None:
    flat = Logistic((1.0, 2.0, *(0.0 for _ in EVIDENCE[2:])), 0.25)
    rule = replace(RULE, flat=flat)
    evidence = dict.fromkeys(EVIDENCE, 0.1)
    odds = RULE.target.odds(evidence), flat.odds(evidence)
    assert odds[1] == pytest.approx(0.55)
    for own_rise, share in ((0.0, 0.0), (0.25 * FULL_RISE, 0.25), (FULL_RISE, 1.0), (0.9, 1.0)):
        known = 1 / (1 + math.exp(-(share * odds[0] + (1 - share) * odds[1])))
        assert rule.probability(evidence | {"own_rise": own_rise}) == pytest.approx(known)
    assert rule.probability(evidence | {"own_rise": math.nan}) == 0.0


@pytest.mark.parametrize(
    "broken",
    [
        [],
        {"weights": {}},
        RULE.as_json() | {"offset": "x"},
        RULE.as_json() | {"threshold": math.inf},
        3,
        "rule",
        RULE.as_json() | {"presence": {"weights": {}, "offset": 0.0}},
        RULE.as_json() | {"presence": 1.0},
        RULE.as_json() | {"flat": {"weights": {}, "offset": 0.0}},
        RULE.as_json() | {"presence": PRESENCE.as_json() | {"offset": math.nan}},
    ],
)
def test_a_broken_rule_names_the_file(broken: object) -> None:
    with pytest.raises(SonarjaxError, match="w.safetensors: metadata: "):
        read_rule(broken, "w.safetensors")
