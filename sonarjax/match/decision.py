"""Eq. 5: from the score curve over yaw to a decision, and to the hypotheses that a symmetric object leaves open.

Takes scores (yaw,) and yaws (yaw,) [rad], returns frozen records. All of it runs under jit and vmap.
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
    """Eq. 5: is it the target, and at which yaw bin."""

    identified: Bool[Array, "*batch"]
    """True where the best score reaches the threshold."""
    score: Float[Array, "*batch"]
    """Best correlation over the bank, -1 to 1."""
    yaw_bin: Int[Array, "*batch"]
    """Index of the best yaw bin."""
    yaw: Float[Array, "*batch"]
    """Yaw of that bin [rad]."""


@record
class Peaks:
    """Hypotheses of yaw, best first; entries beyond the last one are padding."""

    yaw: Float[Array, "*batch peak"]
    """Yaw of the peak's bin [rad]; NaN in padding."""
    score: Float[Array, "*batch peak"]
    """Correlation there, -1 to 1; -inf in padding."""
    yaw_bin: Int[Array, "*batch peak"]
    """Index of the bin; 0 in padding."""
    prominence: Float[Array, "*batch peak"]
    """Height above the higher of the two saddles that lead to higher ground (correlation); 0 in padding."""
    valid: Bool[Array, "*batch peak"]
    """True where the entry is a peak."""


def decide(scores: Float[Array, " yaw"], yaws: Float[Array, " yaw"], threshold: Any) -> Decision:
    """Eq. 5: the best of `scores` (yaw,) at its yaw [rad], identified if it is at least `threshold` (correlation)."""
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
    """Local maxima of the score curve over the full circle, best first, at most `max_peaks`.

    `yaws` (yaw,) [rad] ascend around the circle: the last bin neighbours the first. The best bin is always the first
    hypothesis. Others need the share `min_height` of its score, a `min_prominence` (correlation) over the saddle to
    anything higher, and a `min_separation` [rad] from every better one (0.5 rad is three bins of the paper's 10°).
    """
    scores, yaws = jnp.asarray(scores), jnp.asarray(yaws)
    rise = prominence(scores)
    best = jnp.max(scores)
    local = (scores >= jnp.roll(scores, 1)) & (scores >= jnp.roll(scores, -1))
    # measured from below a negative best score too, where a share of it would lie above it
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
    """Where the parabola through bin `best` and its neighbours is highest, in bins from it: -0.5 to 0.5.

    `scores` (yaw,) go around the full circle.
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
