"""The identification rule: its probability, and what is refused in a weights file."""

from __future__ import annotations

import math

import pytest

from sonarjax.io import SonarjaxError
from sonarjax.segment import EVIDENCE, IdentificationRule
from sonarjax.segment.rule import read_rule

RULE = IdentificationRule(tuple(float(k) for k in range(len(EVIDENCE))), -1.5, 0.4, 0.05)


def test_probability_is_logistic_in_the_evidence() -> None:
    evidence = {name: 0.1 for name in EVIDENCE}
    odds = -1.5 + 0.1 * sum(range(len(EVIDENCE)))
    assert RULE.probability(evidence) == pytest.approx(1 / (1 + math.exp(-odds)))
    assert RULE.probability(evidence | {EVIDENCE[-1]: 1e9}) == pytest.approx(1.0)
    assert RULE.probability(evidence | {EVIDENCE[-1]: math.nan}) == 0.0


def test_a_rule_comes_back_from_its_json() -> None:
    assert read_rule(RULE.as_json(), "w.safetensors") == RULE
    assert read_rule(None, "w.safetensors") is None


@pytest.mark.parametrize(
    "broken",
    [[], {"weights": {}}, RULE.as_json() | {"offset": "x"}, RULE.as_json() | {"threshold": math.inf}, 3, "rule"],
)
def test_a_broken_rule_names_the_file(broken: object) -> None:
    with pytest.raises(SonarjaxError, match="w.safetensors: metadata: "):
        read_rule(broken, "w.safetensors")
