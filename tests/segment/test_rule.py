"""The identification rule: its probability, and what is refused in a weights file."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from sonarjax.io import SonarjaxError
from sonarjax.segment import EVIDENCE, IdentificationRule
from sonarjax.segment.rule import ADDED, Presence, read_rule

RULE = IdentificationRule(tuple(float(k) for k in range(len(EVIDENCE))), -1.5, 0.4, 0.05)
PRESENCE = Presence((2.0, *(0.0 for _ in EVIDENCE[1:])), -1.0)


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
    for rule in (RULE, with_presence):
        assert read_rule(json.loads(json.dumps(rule.as_json())), "w.safetensors") == rule
    assert read_rule(None, "w.safetensors") is None


def test_an_earlier_rule_weighs_what_was_added_by_nothing() -> None:
    earlier = RULE.as_json()
    for name in ADDED:
        del earlier["weights"][name]
    found = read_rule(earlier, "w.safetensors")
    assert found is not None and found.weights[-2:] == (0.0, 0.0) and found.weights[:-2] == RULE.weights[:-2]
    with pytest.raises(SonarjaxError, match="w.safetensors"):
        read_rule(earlier | {"weights": {name: 1.0 for name in EVIDENCE[1:]}}, "w.safetensors")


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
        RULE.as_json() | {"presence": PRESENCE.as_json() | {"offset": math.nan}},
    ],
)
def test_a_broken_rule_names_the_file(broken: object) -> None:
    with pytest.raises(SonarjaxError, match="w.safetensors: metadata: "):
        read_rule(broken, "w.safetensors")
