"""What experiments judge by: circular errors, accuracy at a threshold, chance; and tables for terminal and README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import bootstrap

WITHIN_BIN_DEG = 5.0 + 0.5
"""Largest error [deg] of the right one of the 10° bins: half a bin, and what turning it to its bearing is off."""


def yaw_error_deg(found: Any, true: Any, period_deg: float = 360.0) -> Any:
    """Absolute circular difference [deg] of yaws [rad], of objects that look the same every `period_deg`."""
    turn = np.degrees(np.asarray(found, float) - np.asarray(true, float))
    return np.abs((turn + period_deg / 2) % period_deg - period_deg / 2)


def accuracy(score: np.ndarray, right: np.ndarray, is_target: np.ndarray, threshold: float) -> float:
    """Share of frames (frame,) that are the paper's success: target with the right bin, or another object refused."""
    said = score >= threshold
    return float(np.where(is_target, said & right, ~said).mean())


def best_accuracy(score: np.ndarray, right: np.ndarray, is_target: np.ndarray) -> tuple[float, float]:
    """The largest accuracy over all thresholds, as the paper sets its own on the test set, and that threshold."""
    cuts = np.append(np.unique(score), np.inf)
    reached = [accuracy(score, right, is_target, cut) for cut in cuts]
    best = int(np.argmax(reached))
    return reached[best], float(min(cuts[best], 1.0))


def summary_deg(errors: np.ndarray) -> dict[str, float]:
    """Median, mean, RMS, 95th percentile and share within 1° of absolute errors [deg] (frame,)."""
    return {
        "median": float(np.median(errors)),
        "mean": float(errors.mean()),
        "rms": float(np.sqrt((errors**2).mean())),
        "p95": float(np.percentile(errors, 95)),
        "within_1": float((errors <= 1.0).mean()),
    }


def percentile_gap(errors: Any, others: Any, percentile: float, seed: int = 0) -> tuple[float, float, float]:
    """A percentile of errors (frame,) less that of others (frame,) on the same frames, and its range by chance.

    All three have the unit of the errors. The range is the middle 95 % of a paired bootstrap over frames (Efron and
    Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13), too narrow where neighbouring frames are alike.
    """

    def gap(one: np.ndarray, other: np.ndarray, axis: int = -1) -> Any:
        return np.percentile(one, percentile, axis=axis) - np.percentile(other, percentile, axis=axis)

    both, rng = (np.asarray(errors), np.asarray(others)), np.random.default_rng(seed)
    low, high = bootstrap(both, gap, paired=True, method="percentile", rng=rng).confidence_interval
    return float(gap(*both)), float(low), float(high)


def formatted(value: float | str, spec: str) -> str:
    """A number in the format `spec`; of several runs it is text already, mean ± spread."""
    return value if isinstance(value, str) else format(value, spec)


def markdown(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table; floats with three decimals (two from 10 on, none from 100 on), absent values as a dash."""

    def cell(value: Any) -> str:
        if value is None:
            return "–"
        if not isinstance(value, float):
            return str(value)
        return f"{value:.{0 if abs(value) >= 100 else 2 if abs(value) >= 10 else 3}f}"

    lines = [head, ["---"] * len(head), *([cell(v) for v in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def columns(rows: Sequence[Mapping[str, Any]], heads: Mapping[str, str]) -> str:
    """A table of rows by name: `heads` gives each key's title, in order."""
    return markdown(list(heads.values()), [[row.get(key) for key in heads] for row in rows])
