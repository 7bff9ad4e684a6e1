"""All yaws that one frame allows: a mixture of weighted modes, and the smallest set that holds a given probability.

A symmetric object looks the same at several yaws, and with noise so does a nearly symmetric one. A single yaw with an
error bar then claims too much. The modes are the refined hypotheses, and the other peaks of the bank's scores, which
were not refined. Where the scores are flat, as for a round object, every bin is such a peak.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sonarjax.io.errors import SonarjaxError

CIRCLE = 2 * math.pi
SAME_YAW = math.radians(8.0)
"""Refined hypotheses closer than this are one [rad]."""
FLAT = 0.005
"""Scores of a bank that differ by less are equal [NCC]: those of balls and upright cylinders differ by up to 0.003."""
UNIFORM_STD = CIRCLE / math.sqrt(12)
"""Standard deviation of a completely unknown yaw [rad]."""
REACH, STEPS, COARSE = 4.0, 64, 720
"""The density is sampled up to `REACH` standard deviations from a mode, in `STEPS` steps on each side, and in
`COARSE` steps around the circle.
"""


class YawMode(NamedTuple):
    """One yaw that the frame allows."""

    yaw: float
    """Absolute yaw [rad], in [0, 2π)."""
    yaw_std: float
    """Standard deviation [rad], given that this mode is the right one."""
    weight: float
    """Probability of this mode [1], given that the target is shown; the weights of all modes sum to 1."""


class YawInterval(NamedTuple):
    """One of several disjoint intervals of yaw."""

    low: float
    """Where it begins [rad], in [0, 2π)."""
    high: float
    """Where it ends [rad]: above `low`, hence above 2π if it crosses 0."""
    weight: float
    """Probability of a yaw in it [1]."""


class YawWeights(NamedTuple):
    """How hypotheses are weighted against each other, and how heavy the tails of their errors are."""

    softness: float
    """Difference in score that makes a refined hypothesis e times less likely [NCC]."""
    slope: float
    """Expected loss in refined score of a peak that was not refined, for each unit by which its bank score is
    lower [1].
    """
    unrefined: float
    """Further deduction from the score of such a peak [NCC]."""
    tail: float
    """Share of errors that are `tail_scale` times as large [1]."""
    tail_scale: float
    """Factor on the standard deviations of those errors [1]."""


YAW_WEIGHTS = YawWeights(softness=0.01, slope=1.0, unrefined=0.0, tail=0.0, tail_scale=2.0)
"""Fitted to drawn frames of seven objects, by devices that occur in no test (experiments/fit_yaw_set.py)."""


def shares(scores: np.ndarray, softness: float) -> np.ndarray:
    """Turn the scores of hypotheses, exactly one of which is right, into probabilities.

    Args:
        scores: Score of each hypothesis (hypothesis,) [NCC].
        softness: Difference in score that makes a hypothesis e times less likely [NCC].

    Returns:
        Probability of each hypothesis (hypothesis,) [1].
    """
    parts = np.exp((scores - scores.max()) / softness)
    return parts / parts.sum()


@dataclass(frozen=True)
class YawSet:
    """The yaws that a frame allows, given that it shows the target."""

    modes: tuple[YawMode, ...]
    """Separate modes, the most likely first."""
    tail: float = 0.0
    """Share of a mode's errors that are `tail_scale` times as large [1]."""
    tail_scale: float = 1.0
    """Factor on the standard deviations of those errors [1]."""

    def density(self, yaw: np.ndarray) -> np.ndarray:
        """Compute the probability density at some yaws.

        Args:
            yaw: Yaws (*batch) [rad].

        Returns:
            Probability density (*batch) [1/rad].
        """
        yaw = np.asarray(yaw, float)[..., None]
        total = np.zeros(yaw.shape[:-1])
        for mode in self.modes:
            off = np.remainder(yaw - mode.yaw + math.pi, CIRCLE) - math.pi + CIRCLE * np.arange(-1, 2)
            for share, scale in ((1 - self.tail, 1.0), (self.tail, self.tail_scale)):
                std = min(mode.yaw_std * scale, UNIFORM_STD)
                normal = np.exp(-((off / std) ** 2) / 2) / (std * math.sqrt(CIRCLE))
                total += mode.weight * share * normal.sum(-1)
        return total

    def intervals(self, coverage: float = 0.95) -> tuple[YawInterval, ...]:
        """Find the smallest set of yaws that has a given probability.

        It is the set of highest density (Hyndman, Computing and Graphing Highest Density Regions, The American
        Statistician 50, 1996), accurate to a few hundredths of a standard deviation.

        Args:
            coverage: Probability of the set [1], between 0 and 1.

        Returns:
            The set as disjoint intervals, the most likely first.

        Raises:
            SonarjaxError: The coverage is not between 0 and 1.
        """
        if not 0 < coverage < 1:
            raise SonarjaxError(f"coverage: expected a share between 0 and 1, got {coverage}")
        edges = self._edges()
        width = np.diff(edges)
        density = self.density((edges[:-1] + edges[1:]) / 2)
        mass = density * width
        order = np.argsort(-density, kind="stable")
        needed = int(np.searchsorted(np.cumsum(mass[order]), coverage * mass.sum())) + 1
        inside = np.zeros(len(mass), bool)
        inside[order[:needed]] = True
        return _joined(edges, inside, mass / mass.sum())

    def holds(self, yaw: float, coverage: float = 0.95) -> bool:
        """Check whether a yaw is in the smallest set that has a given probability.

        Args:
            yaw: The yaw [rad].
            coverage: Probability of the set [1], between 0 and 1.

        Returns:
            True if one of the `intervals` holds the yaw.

        Raises:
            SonarjaxError: The coverage is not between 0 and 1.
        """
        return any((yaw - one.low) % CIRCLE <= one.high - one.low for one in self.intervals(coverage))

    def _edges(self) -> np.ndarray:
        """Edges of the cells (cell + 1,) [rad] over one circle; cells are narrow near a mode."""
        steps = np.linspace(-REACH, REACH, 2 * STEPS + 1)
        parts = [np.linspace(0, CIRCLE, COARSE + 1)]
        for mode in self.modes:
            for scale in (1.0, self.tail_scale):
                parts.append(np.remainder(mode.yaw + steps * min(mode.yaw_std * scale, UNIFORM_STD), CIRCLE))
        return np.unique(np.concatenate(parts))


def _joined(edges: np.ndarray, inside: np.ndarray, mass: np.ndarray) -> tuple[YawInterval, ...]:
    """The cells (cell,) that are `inside`, as intervals; those at both ends of the circle are joined."""
    change = np.diff(np.concatenate([[0], inside.astype(int), [0]]))
    found = [
        YawInterval(float(edges[a]), float(edges[b]), float(mass[a:b].sum()))
        for a, b in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True)
    ]
    if len(found) > 1 and inside[0] and inside[-1]:
        first, last = found.pop(0), found.pop()
        found.append(YawInterval(last.low, first.high + CIRCLE, first.weight + last.weight))
    return tuple(sorted(found, key=lambda one: -one.weight))


def make_yaw_set(
    yaws: Sequence[float], stds: Sequence[float], scores: Sequence[float], curve: np.ndarray, curve_yaws: np.ndarray,
    weights: YawWeights,
) -> YawSet:  # fmt: skip
    """Make the set of yaws from refined hypotheses and from the other peaks of the bank's scores.

    Args:
        yaws: Yaws of the refined hypotheses (hypothesis,) [rad], best first.
        stds: Their standard deviations (hypothesis,) [rad].
        scores: Their scores (hypothesis,) [NCC].
        curve: The bank's scores (yaw,).
        curve_yaws: Yaws of the bank (yaw,) [rad], ascending around the circle.
        weights: How hypotheses are weighted.

    Returns:
        The set, with modes that do not overlap.
    """
    best, bin_std = max(scores), CIRCLE / len(curve) / math.sqrt(12)
    rows = [(float(y), min(float(s), UNIFORM_STD), float(v)) for y, s, v in zip(yaws, stds, scores, strict=True)]
    for yaw, height in _other_peaks(curve, np.asarray(curve_yaws), yaws):
        rows.append((yaw, bin_std, best - weights.slope * float(curve.max() - height) - weights.unrefined))
    share = shares(np.array([row[2] for row in rows]), weights.softness)
    modes = [YawMode(yaw % CIRCLE, std, float(w)) for (yaw, std, _), w in zip(rows, share, strict=True)]
    return YawSet(merged(modes), weights.tail, weights.tail_scale)


def _other_peaks(curve: np.ndarray, yaws: np.ndarray, known: Sequence[float]) -> list[tuple[float, float]]:
    """Yaw [rad] and height of the peaks of a curve (yaw,) that are over a bin away from all `known` yaws [rad]."""
    apart = max(1.5 * CIRCLE / len(curve), SAME_YAW)
    far = [all(abs(math.remainder(float(yaw) - one, CIRCLE)) > apart for one in known) for yaw in yaws]
    return [(float(yaws[k]), float(curve[k])) for k in np.flatnonzero(_on_top(curve) & np.array(far))]


def _on_top(curve: np.ndarray) -> np.ndarray:
    """Which bins (yaw,) of a curve are local maxima, or as high as the one they adjoin: round objects have no peak."""
    top = (curve >= np.roll(curve, 1)) & (curve >= np.roll(curve, -1))
    for peak in np.flatnonzero(top):
        for way in (np.arange(peak, peak + len(curve)), np.arange(peak, peak - len(curve), -1)):
            bins = way % len(curve)
            top[bins[np.logical_and.accumulate(np.abs(curve[bins] - curve[peak]) <= FLAT)]] = True
    return top


def merged(modes: Sequence[YawMode]) -> tuple[YawMode, ...]:
    """Merge modes that are closer than their error bars or `SAME_YAW`.

    Args:
        modes: Modes that may overlap.

    Returns:
        Modes without overlap, the most likely first.
    """
    left, found = sorted(modes, key=lambda mode: -mode.weight), list[YawMode]()
    while left:
        best = left[0]
        near = [m for m in left if abs(math.remainder(m.yaw - best.yaw, CIRCLE)) <= max(SAME_YAW, best.yaw_std)]
        left = [mode for mode in left if mode not in near]
        total = sum(mode.weight for mode in near)
        if total <= 0:
            continue
        apart = [(mode.weight / total, math.remainder(mode.yaw - best.yaw, CIRCLE), mode.yaw_std) for mode in near]
        middle = sum(share * off for share, off, _ in apart)
        variance = sum(share * (std**2 + (off - middle) ** 2) for share, off, std in apart)
        found.append(YawMode((best.yaw + middle) % CIRCLE, math.sqrt(variance), total))
    return tuple(sorted(found, key=lambda mode: -mode.weight))
