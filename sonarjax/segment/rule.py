"""The decision about a refined match: logistic combinations of evidence, fitted to validation frames.

One tells the target from other objects, another tells objects from bare floor and empty tanks. A frame shows the target
only if both say so, and the score is the smaller of both probabilities. Targets that look the same at all yaws are
judged by a third instead of the first; between these and plain targets, the two are mixed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sonarjax.io.errors import SonarjaxError

EVIDENCE = (
    "map_fit", "frame_fit", "coarse_fit", "unexplained", "left_over", "map_rise", "frame_rise", "frame_peak",
)  # fmt: skip
"""What a rule may weigh: the fields of `refine.Evidence`, then three numbers from the score curves over yaw.

`map_rise` is the score of the best of 36 yaw bins on the semantic map minus that of the fourth best (its neighbours
share its peak). `frame_rise` is the same for echo templates on the frame itself, and `frame_peak` is the best bin's
score there.
"""
RISES = ("map_rise", "frame_rise")
"""The items that say nothing about a round target, whose best yaw cannot stand out."""
FULL_RISE = 0.15
"""From this `own_rise` on, the rises count fully [NCC]; at 0 not at all.

`own_rise` is how far the target's best yaw can stand out: the rise of its best template's own scores. Chosen on the
validation frames of experiments/fit_decision.py.
"""


@dataclass(frozen=True)
class Logistic:
    """A probability whose log-odds are linear in the evidence."""

    weights: tuple[float, ...]
    """Weight of each item of `EVIDENCE` in the log-odds."""
    offset: float
    """The log-odds if all items are 0."""

    def odds(self, evidence: Mapping[str, float]) -> float:
        """Compute the log-odds.

        Args:
            evidence: Value of each item of `EVIDENCE`, by name; other names are ignored.

        Returns:
            The log-odds; not finite if an item is not.
        """
        return self.offset + sum(w * evidence[name] for w, name in zip(self.weights, EVIDENCE, strict=True))

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Compute the probability.

        Args:
            evidence: As in `odds`.

        Returns:
            Probability from 0 to 1; 0 if an item is not finite.
        """
        return _probability(self.odds(evidence))

    def as_json(self) -> dict[str, Any]:
        """Convert to JSON types.

        Returns:
            The weights by name, and the offset.
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
    presence: Logistic | None = None
    """That any object is shown, rather than nothing but floor and noise, if both are equally frequent; None if that
    was never fitted."""
    flat: Logistic | None = None
    """That an object shown is the target, by all items but `RISES`: for targets that look the same at all yaws. None
    judges them like other targets."""

    @property
    def target(self) -> Logistic:
        """The probability that an object shown is the target, if targets and other objects are equally frequent."""
        return Logistic(self.weights, self.offset)

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Compute the probability that the target is shown.

        The log-odds of `flat` and `target` are mixed by how far the target's best yaw can stand out: all `flat` where
        `own_rise` is 0, all `target` from `FULL_RISE` on.

        Args:
            evidence: Value of each item of `EVIDENCE`, and of `own_rise` if there is a `flat`; other names are ignored.

        Returns:
            The smaller of two probabilities from 0 to 1: that of the target, and `presence`. 0 if an item is not
            finite.
        """
        odds = self.target.odds(evidence)
        if self.flat is not None:
            full = min(max(evidence["own_rise"] / FULL_RISE, 0.0), 1.0)
            odds = full * odds + (1 - full) * self.flat.odds(evidence)
        target = _probability(odds)
        return target if self.presence is None else min(target, self.presence.probability(evidence))

    def as_json(self) -> dict[str, Any]:
        """Convert the rule to JSON types.

        Returns:
            The rule as stored under `rule` in the metadata of a weights file.
        """
        parts = {"presence": self.presence, "flat": self.flat}
        return {
            **self.target.as_json(),
            "threshold": self.threshold,
            "false_alarms": self.false_alarms,
            **{name: part.as_json() for name, part in parts.items() if part is not None},
        }


def _probability(odds: float) -> float:
    """The probability for log-odds; 0 if they are not finite."""
    return 1 / (1 + math.exp(-min(max(odds, -50.0), 50.0))) if math.isfinite(odds) else 0.0


def read_rule(found: Any, name: str) -> IdentificationRule | None:
    """Read a rule that `as_json` wrote; None if there is none. `name` is the file's name in messages.

    Raises:
        SonarjaxError: What was found is not a rule.
    """
    if found is None:
        return None
    try:
        threshold, alarms = (float(found[key]) for key in ("threshold", "false_alarms"))
        presence, flat = (None if (part := found.get(key)) is None else _read(part) for key in ("presence", "flat"))
        target = _read(found)
        rule = IdentificationRule(target.weights, target.offset, threshold, alarms, presence, flat)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise SonarjaxError(f"{name}: metadata: expected a `rule` with weights for {', '.join(EVIDENCE)}") from error
    parts = [part for part in (rule.target, rule.presence, rule.flat) if part is not None]
    if not all(math.isfinite(v) for part in parts for v in (*part.weights, part.offset, rule.threshold)):
        raise SonarjaxError(f"{name}: metadata: `rule` holds values that are not finite")
    return rule


def _read(found: Mapping[str, Any]) -> Logistic:
    return Logistic(tuple(float(found["weights"][key]) for key in EVIDENCE), float(found["offset"]))


RULES: dict[str, IdentificationRule] = {
    "none": IdentificationRule(
        weights=(5.604, 4.517, -16.27, 0.1025, -13.71, 27.41, 27.41, -13.02),
        offset=18.9,
        threshold=0.5,
        false_alarms=0.163,
        presence=Logistic(
            weights=(-0.2783, 4.995, -6.275, 0.3451, -11.67, -1.141, -1.141, 5.593),
            offset=7.833,
        ),
        flat=Logistic(
            weights=(3.012, 12.36, -17.93, -0.901, -10.35, 0.0, 0.0, -7.915),
            offset=13.95,
        ),
    )
}
"""Rules of segmenters that have no weights file, by name; from experiments/fit_decision.py."""
