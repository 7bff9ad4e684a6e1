"""The decision about a refined match: a logistic combination of evidence, fitted to validation frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sonarjax.io.errors import SonarjaxError

EVIDENCE = (
    "map_fit", "frame_fit", "coarse_fit", "unexplained", "left_over", "map_rise", "frame_rise", "frame_peak",
)  # fmt: skip
"""What a rule may weigh: the fields of `refine.Evidence`, then what the score curves over yaw tell.

`map_rise` is the best yaw bin's score on the map less that of the fourth best (its neighbours share its peak),
`frame_rise` the same of matching the frame itself, and `frame_peak` is the best bin's score there."""


@dataclass(frozen=True)
class IdentificationRule:
    """The probability that the target is what a frame shows, and the least one that identifies it."""

    weights: tuple[float, ...]
    """Weight of each number of `EVIDENCE` in the log-odds."""
    offset: float
    """The log-odds where all of them are 0."""
    threshold: float
    """Least probability of an identified target [1]."""
    false_alarms: float
    """Share of other objects that were identified among the validation frames, at that threshold [1]."""

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Probability [1] that the target is shown, where targets and others are equally frequent."""
        odds = self.offset + sum(w * evidence[name] for w, name in zip(self.weights, EVIDENCE, strict=True))
        return 1 / (1 + math.exp(-min(max(odds, -50.0), 50.0))) if math.isfinite(odds) else 0.0

    def as_json(self) -> dict[str, Any]:
        """The rule in JSON's own types: what a weights file's metadata hold under `rule`."""
        return {
            "weights": dict(zip(EVIDENCE, self.weights, strict=True)),
            "offset": self.offset,
            "threshold": self.threshold,
            "false_alarms": self.false_alarms,
        }


def read_rule(found: Any, name: str) -> IdentificationRule | None:
    """The rule that `as_json` gave; None where there is none.

    Raises SonarjaxError that names the file, `name`, when it is no rule.
    """
    if found is None:
        return None
    try:
        weights = tuple(float(found["weights"][key]) for key in EVIDENCE)
        rule = IdentificationRule(weights, *(float(found[key]) for key in ("offset", "threshold", "false_alarms")))
    except (KeyError, TypeError, ValueError) as error:
        raise SonarjaxError(f"{name}: metadata: expected a `rule` with weights of {', '.join(EVIDENCE)}") from error
    if not all(math.isfinite(v) for v in (*rule.weights, rule.offset, rule.threshold)):
        raise SonarjaxError(f"{name}: metadata: `rule` holds values that are not finite")
    return rule


RULES: dict[str, IdentificationRule] = {
    "none": IdentificationRule(
        weights=(2.724, 7.531, -14.78, 0.5205, -12.22, 27.75, 27.75, -11.96),
        offset=15.58,
        threshold=0.5,
        false_alarms=0.133,
    )
}
"""Rules of segmenters that have no weights file, by name; experiments/fit_decision.py."""
