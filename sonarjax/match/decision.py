"""Eq. 5: from the score curve over yaw to a decision, and to the hypotheses that a symmetric object leaves open.

Takes scores (yaw,) and yaws (yaw,) [rad], and returns frozen records. `decide` and `peaks` run
under jit and vmap, `between_bins` on the host.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.records import record


@record
class Decision:
    """Eq. 5: whether it is the target, and at which yaw bin."""

    identified: Bool[Array, "*batch"]
    """True if the best score reaches the threshold."""
    score: Float[Array, "*batch"]
    """Best correlation over the bank, -1 to 1."""
    yaw_bin: Int[Array, "*batch"]
    """Index of the best yaw bin."""
    yaw: Float[Array, "*batch"]
    """Yaw of that bin [rad]."""


@record
class Peaks:
    """Hypotheses of yaw, best first; unused entries are padding."""

    yaw: Float[Array, "*batch peak"]
    """Yaw of the peak's bin [rad]; NaN in padding."""
    score: Float[Array, "*batch peak"]
    """Correlation there, -1 to 1; -inf in padding."""
    yaw_bin: Int[Array, "*batch peak"]
    """Index of the bin; 0 in padding."""
    prominence: Float[Array, "*batch peak"]
    """Height above the higher of the two saddles that lead to higher scores (correlation); 0 in padding."""
    valid: Bool[Array, "*batch peak"]
    """True if the entry is a peak."""


def decide(scores: Float[Array, " yaw"], yaws: Float[Array, " yaw"], threshold: Any) -> Decision:
    """Decide by the best score whether the target is shown, and at which yaw (eq. 5).

    Args:
        scores: Score of each yaw (yaw,).
        yaws: Yaws (yaw,) [rad].
        threshold: Least score at which the target counts as identified.

    Returns:
        The best score: `identified`, `score`, its index `yaw_bin` and its `yaw` [rad].
    """
    scores, yaws = jnp.asarray(scores), jnp.asarray(yaws)
    best = jnp.argmax(scores)
    return Decision(scores[best] >= threshold, scores[best], best, yaws[best])


@partial(jax.jit, static_argnames="max_peaks")
def peaks(
    scores: Float[Array, " yaw"],
    yaws: Float[Array, " yaw"],
    *,
    max_peaks: int = 4,
    min_height: Any = 0.8,
    min_prominence: Any = 0.02,
    min_separation: Any = 0.5,
) -> Peaks:
    """Find the local maxima of the score curve over the full circle, best first.

    The best bin is always the first hypothesis.

    Args:
        scores: Scores (yaw,).
        yaws: Yaws (yaw,) [rad], ascending around the circle: the last bin neighbours the first.
        max_peaks: Most hypotheses.
        min_height: Least score of another hypothesis, as a share of the best.
        min_prominence: Least height over the saddle to any higher score (correlation).
        min_separation: Least distance from every better hypothesis [rad]; 0.5 rad is three bins of the paper's 10°.

    Returns:
        Arrays (peak,) of length `max_peaks`: `yaw` [rad], `score`, `yaw_bin`, `prominence`, and `valid`, which is false
        for padding.
    """
    scores, yaws = jnp.asarray(scores), jnp.asarray(yaws)
    rise = prominence(scores)
    best = jnp.max(scores)
    local = (scores >= jnp.roll(scores, 1)) & (scores >= jnp.roll(scores, -1))
    # With a negative best score, a share of it would lie above it: so subtract from the best score instead.
    high = scores >= best - (1 - min_height) * jnp.abs(best)
    standing = (local & high & (rise >= min_prominence)) | (jnp.arange(scores.size) == jnp.argmax(scores))

    def take(left: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        chosen = jnp.argmax(jnp.where(left, scores, -jnp.inf))
        apart = jnp.abs(jnp.angle(jnp.exp(1j * (yaws - yaws[chosen])))) >= min_separation
        apart &= jnp.arange(scores.size) != chosen
        return left & apart, (chosen, left[chosen])

    _, (chosen, valid) = jax.lax.scan(take, standing, length=max_peaks)
    return Peaks(
        yaw=jnp.where(valid, yaws[chosen], jnp.nan),
        score=jnp.where(valid, scores[chosen], -jnp.inf),
        yaw_bin=jnp.where(valid, chosen, 0),
        prominence=jnp.where(valid, rise[chosen], 0.0),
        valid=valid,
    )


def between_bins(scores: Float[np.ndarray, " yaw"], best: int) -> float:
    """Find the maximum of the parabola through the best bin and its two neighbours.

    Args:
        scores: Scores (yaw,) over the full circle.
        best: Index of the best bin.

    Returns:
        Position of the maximum relative to bin `best` [bins], -0.5 to 0.5; 0 if the parabola has no maximum.
    """
    left, middle, right = (float(scores[(best + k) % len(scores)]) for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    return 0.0 if bend >= 0 else min(max(0.5 * (left - right) / bend, -0.5), 0.5)


def prominence(scores: Float[Array, " yaw"]) -> Float[Array, " yaw"]:
    """Height (yaw,) of each bin above the higher of its two saddles, left and right, on the closed circle.

    A saddle is the lowest score on the way to the first higher bin; for the best bin it is the lowest score of all.
    """
    count = scores.shape[0]
    steps = jnp.arange(count)

    def saddle(direction: int) -> Array:
        walk = scores[(steps[:, None] + direction * steps) % count]  # (bin, step)
        before = jnp.cumsum(walk > scores[:, None], axis=1) == 0
        return jnp.min(jnp.where(before, walk, jnp.inf), axis=1)

    return scores - jnp.maximum(saddle(1), saddle(-1))
