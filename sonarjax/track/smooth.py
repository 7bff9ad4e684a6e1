"""Smooth the beliefs of a log: update each frame's belief by the later frames, which the filter did not know.

Each component of the last belief has a history: the chain of components that it continues. Along it the states are
smoothed backwards (Rauch, Tung and Striebel, Maximum Likelihood Estimates of Linear Dynamic Systems, AIAA Journal 3,
1965). The weight of a history at a frame is what the filter gave it there plus what the later frames add, which fades
in the same way.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.exact import full_precision
from sonarjax.track.belief import RATE, STATES, YAW, Belief, Numbers, predicted, with_limited_yaw
from sonarjax.track.reduce import signed

RIDGE = 1e-6
"""Added to the diagonal of a predicted covariance, as a share of it: an object at rest has no spread of rates."""
LEAST_VARIANCE = 1e-10
"""Also added to that diagonal [rad², m²]."""


@jax.jit
def run_smoother(beliefs: Belief, numbers: Numbers) -> Belief:
    """Smooth the beliefs of a filter; afterwards each component is one complete history.

    Histories that the filter dropped are lost. `parent` and `gain` lose their meaning.

    Args:
        beliefs: The beliefs of the filter (frame, component).
        numbers: The numbers of motion and config that the filter used.

    Returns:
        The smoothed beliefs (frame, component).
    """
    last = jax.tree.map(lambda v: v[-1], beliefs)
    earlier, later = (jax.tree.map(lambda v, cut=cut: v[cut], beliefs) for cut in (slice(None, -1), slice(1, None)))
    alive = jnp.where(jnp.isfinite(last.log_weight), 0.0, -jnp.inf)
    start = jnp.arange(len(last.log_weight)), last.mean, last.covariance, alive

    def one(carry: Any, pair: Any) -> tuple[Any, Belief]:
        which, mean, covariance, added = carry
        before, after = pair
        parent = after.parent[which]
        added = after.fading * (added + after.gain[which])
        added = added - jax.scipy.special.logsumexp(added)
        prediction = predicted(before, after.sonar, after.elapsed, numbers)
        expected = jax.tree.map(lambda v: v[parent], prediction)
        smoothed = jax.vmap(_smoothed)(
            before.mean[parent],
            before.covariance[parent],
            expected.mean,
            expected.covariance,
            expected.cross,
            mean,
            covariance,
        )
        traced_back = jax.vmap(_traced_back)(expected.transition, expected.noise, mean, covariance)
        unknown = parent == 0  # the history had not begun here, so only later frames say anything about it
        new_mean, new_covariance = (
            jnp.where(unknown.reshape(-1, *[1] * (back.ndim - 1)), back, forth)
            for back, forth in zip(traced_back, smoothed, strict=True)
        )
        new_mean = new_mean.at[:, YAW].set(new_mean[:, YAW] % (2 * jnp.pi))
        weight = before.log_weight[parent] + added
        weight = weight - jax.scipy.special.logsumexp(weight)
        found = replace(before, log_weight=weight, mean=new_mean, covariance=new_covariance)
        return (parent, new_mean, new_covariance, added), found

    rest = jax.lax.scan(one, start, (earlier, later), reverse=True)[1]
    return jax.tree.map(lambda v, end: jnp.concatenate([v, end[None]]), rest, last)


@full_precision
def _smoothed(
    mean: Array, covariance: Array, expected: Array, spread: Array, cross: Array, mean_after: Array,
    covariance_after: Array,
) -> tuple[Array, Array]:  # fmt: skip
    ridge = RIDGE * jnp.diag(jnp.diag(spread)) + LEAST_VARIANCE * jnp.eye(STATES)
    gain = jnp.linalg.solve(spread + ridge, cross.T).T
    gap = (mean_after - expected).at[YAW].set(signed(mean_after[YAW] - expected[YAW]))
    return mean + gain @ gap, covariance + gain @ (covariance_after - spread) @ gain.T


@full_precision
def _traced_back(transition: Array, noise: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """The state before `mean`, if nothing else is known about the object; its shared errors stay as they are."""
    back = jnp.eye(STATES).at[YAW, RATE].set(-transition[YAW, RATE])
    drift = noise.at[4, 4].set(0.0)
    return back @ mean, with_limited_yaw(back @ (covariance + drift) @ back.T)[0]
