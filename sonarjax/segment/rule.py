"""The decision about a refined match: logistic combinations of evidence, fitted to validation frames.

One tells the target from other objects, the other tells objects from bare floor and empty tanks. A frame shows the
target only if both say so, and the score is the smaller of both probabilities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sonarjax.io.errors import SonarjaxError

EVIDENCE = (
    "map_fit", "frame_fit", "coarse_fit", "unexplained", "left_over", "map_rise", "frame_rise", "frame_peak",
    "map_own_rise", "frame_own_rise",
)  # fmt: skip
"""What a rule may weigh: the fields of `refine.Evidence`, then five numbers from the score curves over yaw.

`map_rise` is the score of the best yaw bin on the semantic map minus that of the fourth best (its neighbours share its
peak). `frame_rise` is the same for echo templates on the frame itself, and `frame_peak` is the best bin's score
there. `map_own_rise` and `frame_own_rise` are about how large the rises can be for this target: 0 for a round one.
"""

ADDED = ("map_own_rise", "frame_own_rise")
"""Items that a rule of an earlier version does not have: they then weigh nothing."""


@dataclass(frozen=True)
class Presence:
    """The probability that a frame shows any object, rather than nothing but floor and noise."""

    weights: tuple[float, ...]
    """Weight of each item of `EVIDENCE` in the log-odds."""
    offset: float
    """The log-odds if all items are 0."""

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Compute the probability that an object is shown.

        Args:
            evidence: Value of each item of `EVIDENCE`, by name; other names are ignored.

        Returns:
            Probability from 0 to 1, if frames with and without an object are equally frequent; 0 if an item is not
            finite.
        """
        return _logistic(self.weights, self.offset, evidence)

    def as_json(self) -> dict[str, Any]:
        """Convert to JSON types.

        Returns:
            What is stored under `presence` in a rule.
        """
        return {"weights": dict(zip(EVIDENCE, self.weights, strict=True)), "offset": self.offset}


@dataclass(frozen=True)
class IdentificationRule:
    """The probability that a frame shows the target, and the least probability that identifies it."""

    weights: tuple[float, ...]
    """Weight of each item of `EVIDENCE` in the log-odds that an object shown is the target."""
    offset: float
    """The log-odds if all items are 0."""
    threshold: float
    """Least probability of an identified target [1]."""
    false_alarms: float
    """Share of other objects among the validation frames that were identified at that threshold [1]."""
    presence: Presence | None = None
    """Whether any object is shown; None if that was never fitted."""

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Compute the probability that the target is shown.

        Args:
            evidence: Value of each item of `EVIDENCE`, by name; other names are ignored.

        Returns:
            The smaller of two probabilities from 0 to 1: that an object shown is the target, if targets and other
            objects are equally frequent, and that any object is shown (`Presence`). 0 if an item is not finite.
        """
        target = _logistic(self.weights, self.offset, evidence)
        return target if self.presence is None else min(target, self.presence.probability(evidence))

    def as_json(self) -> dict[str, Any]:
        """Convert the rule to JSON types.

        Returns:
            The rule as stored under `rule` in the metadata of a weights file.
        """
        return {
            "weights": dict(zip(EVIDENCE, self.weights, strict=True)),
            "offset": self.offset,
            "threshold": self.threshold,
            "false_alarms": self.false_alarms,
            **({} if self.presence is None else {"presence": self.presence.as_json()}),
        }


def _logistic(weights: tuple[float, ...], offset: float, evidence: Mapping[str, float]) -> float:
    """The probability for log-odds that are linear in the evidence; 0 if they are not finite."""
    odds = offset + sum(w * evidence[name] for w, name in zip(weights, EVIDENCE, strict=True))
    return 1 / (1 + math.exp(-min(max(odds, -50.0), 50.0))) if math.isfinite(odds) else 0.0


def read_rule(found: Any, name: str) -> IdentificationRule | None:
    """Read a rule that `as_json` wrote; None if there is none. `name` is the file's name in messages.

    Raises:
        SonarjaxError: What was found is not a rule.
    """
    if found is None:
        return None
    try:
        offset, threshold, alarms = (float(found[key]) for key in ("offset", "threshold", "false_alarms"))
        there = found.get("presence")
        presence = None if there is None else Presence(_weights(there), float(there["offset"]))
        rule = IdentificationRule(_weights(found), offset, threshold, alarms, presence)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SonarjaxError(f"{name}: metadata: expected a `rule` with weights for {', '.join(EVIDENCE)}") from error
    parts = (rule,) if rule.presence is None else (rule, rule.presence)
    if not all(math.isfinite(v) for part in parts for v in (*part.weights, part.offset, rule.threshold)):
        raise SonarjaxError(f"{name}: metadata: `rule` holds values that are not finite")
    return rule


def _weights(found: Mapping[str, Any]) -> tuple[float, ...]:
    weights = dict.fromkeys(ADDED, 0.0) | dict(found["weights"])
    return tuple(float(weights[key]) for key in EVIDENCE)


RULES: dict[str, IdentificationRule] = {
    "none": IdentificationRule(
        weights=(-0.3161, 6.666, -11.85, -0.7573, -8.863, 31.74, 31.74, -3.4, -9.635, -9.635),
        offset=11.47,
        threshold=0.5,
        false_alarms=0.150,
        presence=Presence(
            weights=(-0.3177, 5.078, -6.288, 0.3499, -11.56, 0.02899, 0.02888, 5.822, -0.9227, -0.9227),
            offset=7.722,
        ),
    )
}
"""Rules of segmenters that have no weights file, by name; from experiments/fit_decision.py."""
