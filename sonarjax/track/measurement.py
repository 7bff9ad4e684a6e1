"""Turn a recognizer's hypotheses into a `Measurement`, and a belief into its modes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.recognition import Hypothesis, Recognition
from sonarjax.refine import SAME_YAW, shares
from sonarjax.track.belief import RATE, YAW, Belief, Measurement
from sonarjax.track.motion import TrackConfig

UNRULED = {True: 0.9, False: 0.1}
"""Probability that a frame shows the target if a plain threshold identified it, and if not; used where no rule
gives a probability.
"""
ROOT = math.sqrt(2.0)
ONE_STD = math.erf(1 / ROOT)
HALVINGS, TINY = 24, 1e-9
LEAST_PROBABILITY = 1e-4
"""Modes of a belief with a smaller probability are left out."""


@dataclass(frozen=True)
class Mode:
    """One possible pose of the object in the common frame, with its error bars in case it is the right one."""

    yaw: float
    """Yaw [rad], in [0, 2π)."""
    x: float
    """Position along the common frame's x [m]."""
    y: float
    """Position along the common frame's y [m]."""
    rate: float
    """Growth of yaw [rad/frame]."""
    covariance: np.ndarray
    """Covariance (state, state) of yaw, x, y and rate."""
    yaw_std: float
    """Half of the interval around `yaw` that holds 68 % of this mode [rad], as a normal standard deviation does.

    Because of the tails, the square root of the covariance's entry is larger.
    """
    probability: float
    """Probability of this mode [1], among all modes and the possibility of another place."""


def measurement_of(
    found: Recognition | None, yaw_bins: int, config: TrackConfig, sonar: np.ndarray, elapsed: float
) -> Measurement:
    """Turn the hypotheses of a recognition into a measurement.

    Each hypothesis is entered twice: with the error of its error bar, and with the larger one of the tails.

    Args:
        found: The recognition; None for a frame that could not be recognized.
        yaw_bins: Number of yaw bins of the recognizer, for the error of a hypothesis without an error bar.
        config: How frames are weighted.
        sonar: Pose of the sonar in the common frame (3,): x, y [m] and yaw [rad].
        elapsed: Time since the previous frame [frames].

    Returns:
        The measurement; its axis (hypothesis,) is twice as long as `config.hypotheses` says.
    """
    count = config.hypotheses
    weight = np.full((2, count), -np.inf)
    pose, std = np.zeros((2, count, 3)), np.ones((2, count, 3))
    miss = 0.0
    if found is not None:
        right = probability(found) * (1 - config.misses)
        miss = math.log1p(-right)
        best = found.hypotheses[:count]
        parts = shares(np.array([h.score for h in best]), config.softness)
        for k, one in enumerate(best):
            pose[:, k] = one.yaw, *_place(one, found)
            std[:, k] = _yaw_std(one, yaw_bins, config), config.place_std, config.place_std
            if np.isfinite(std[0, k, 0]) and right > 0:
                weight[:, k] = np.log(right * parts[k]) + np.log([1 - config.tail, config.tail])
        std[1] *= config.tail_scale
        if not np.isfinite(weight).any():
            miss = 0.0
    flat = pose.reshape(-1, 3), np.where(np.isfinite(std), std, 1.0).reshape(-1, 3)
    values = (weight.reshape(-1), np.asarray(miss), *flat, np.asarray(sonar), np.asarray(elapsed))
    return Measurement(*(jnp.asarray(v, jnp.float32) for v in values))


def probability(found: Recognition) -> float:
    """Probability that a frame shows the target [1]: from the score if a rule made it, else from the threshold alone.

    A threshold other than one half is read as the score at which the odds are even: a user who lowers it knows that the
    target is present more often than in the rule's validation frames.
    """
    if found.score == found.score_bank:
        return UNRULED[bool(found.identified)]
    score, even = (min(max(value, 0.0), 1.0) for value in (found.score, found.threshold))
    shown, absent = score * (1 - even), even * (1 - score)
    return shown / (shown + absent) if shown + absent > 0 else float(found.identified)


def _yaw_std(one: Hypothesis, yaw_bins: int, config: TrackConfig) -> float:
    """Standard deviation [rad] of the part of the error that differs from frame to frame."""
    std = 2 * math.pi / yaw_bins / math.sqrt(12) if one.yaw_std is None else one.yaw_std
    return config.yaw_scale * std


def _place(one: Hypothesis, found: Recognition) -> tuple[float, float]:
    return (found.x if one.x is None else one.x), (found.y if one.y is None else one.y)


def modes_of(belief: Belief) -> tuple[Mode, ...]:
    """List the possible poses of one belief; components of one yaw are joined.

    Args:
        belief: The belief (component,).

    Returns:
        The modes, the most likely first. They are empty if only the component 'anywhere' has a weight.
    """
    log_weight = np.asarray(belief.log_weight, float)
    weight = np.exp(log_weight[1:])
    mean, covariance = (np.asarray(v, float)[1:] for v in (belief.mean, belief.covariance))
    found: list[Mode] = []
    while weight.max(initial=0.0) > 0:
        best = int(weight.argmax())
        apart = mean[:, : RATE + 1] - mean[best, : RATE + 1]
        apart[:, YAW] = (apart[:, YAW] + math.pi) % (2 * math.pi) - math.pi
        alike = np.abs(apart[:, YAW]) <= max(SAME_YAW, math.sqrt(max(covariance[best, YAW, YAW], 0.0)))
        share = np.where(alike, weight, 0.0)
        total = float(share.sum())
        if found and total < LEAST_PROBABILITY:
            break
        share /= total
        middle = share @ apart
        around = apart - middle
        own = np.einsum("k,kij->ij", share, covariance[:, : RATE + 1, : RATE + 1])
        yaw, x, y, rate = (mean[best, : RATE + 1] + middle).tolist()
        spread = own + np.einsum("k,ki,kj->ij", share, around, around)
        width = _half_width(share, around[:, YAW], np.sqrt(np.maximum(covariance[:, YAW, YAW], 0.0)))
        certain = min(total, 1.0)  # the weights are rounded, so their sum may exceed 1 a little
        found.append(Mode(yaw % (2 * math.pi), x, y, rate, spread, width, certain))
        weight = np.where(alike, 0.0, weight)
    return tuple(sorted(found, key=lambda mode: -mode.probability))


def _half_width(share: np.ndarray, middle: np.ndarray, std: np.ndarray) -> float:
    """Half-width around 0 that holds as much of a mixture as one standard deviation holds of a normal distribution."""
    used = [
        (s, m, max(d, TINY)) for s, m, d in zip(share.tolist(), middle.tolist(), std.tolist(), strict=True) if s > 0
    ]
    low, high = 0.0, max(abs(m) + 2 * d for _, m, d in used)
    for _ in range(HALVINGS):
        width = (low + high) / 2
        held = sum(s * (math.erf((width - m) / d / ROOT) + math.erf((width + m) / d / ROOT)) / 2 for s, m, d in used)
        low, high = (width, high) if held < ONE_STD else (low, width)
    return (low + high) / 2


def each_of(beliefs: Belief) -> list[Belief]:
    """Split beliefs (frame, component) into one belief for each frame."""
    fetched = jax.tree.map(np.asarray, beliefs)
    return [jax.tree.map(lambda v, k=k: v[k], fetched) for k in range(len(fetched.elapsed))]
