"""Fewer Gaussians for a mixture: those that agree become one, of the rest the heaviest are kept."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

COMPARED = 4
"""Yaw, x, y and rate: components are alike where these are."""
LEAST_STD = 1e-4
"""Differences below are none [rad, m, rad/frame], however sure a component is."""
ALIKE = 1.5
"""Largest ratio of the standard deviations of yaw of components that are joined: a frame that may be far off is another
explanation than the same frame taken at its word, and their mean would be neither."""


class Mixture(NamedTuple):
    """Weighted Gaussians, and which earlier one each continues."""

    log_weight: Float[Array, "component"]
    mean: Float[Array, "component state"]
    covariance: Float[Array, "component state state"]
    parent: Int[Array, "component"]


def wrapped(angle: Array) -> Array:
    """An angle [rad] in [-π, π)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


def reduced(mixture: Mixture, count: int, merge: Array) -> Mixture:
    """`count` components: again and again the heaviest is joined by all within `merge` of its standard deviations.

    Mean and covariance of what is joined are kept (Salmond, Mixture Reduction Algorithms for Target Tracking in
    Clutter, 1990); nothing far apart is, nor what differs much in how sure it is. Yaw is the first number, and
    circular.
    """

    def one(left: Array, _: None) -> tuple[Array, Mixture]:
        best = jnp.argmax(left)
        apart = mixture.mean - mixture.mean[best]
        apart = apart.at[:, 0].set(wrapped(apart[:, 0]))
        std = jnp.sqrt(jnp.maximum(jnp.diag(mixture.covariance[best])[:COMPARED], LEAST_STD**2))
        near = (jnp.abs(apart[:, :COMPARED]) <= merge * std).all(axis=1)
        ratio = mixture.covariance[:, 0, 0] / jnp.maximum(mixture.covariance[best, 0, 0], LEAST_STD**2)
        near &= (ratio <= ALIKE**2) & (ratio >= ALIKE**-2)
        near = near.at[best].set(True)
        chosen = jnp.where(near, left, -jnp.inf)
        total = jax.scipy.special.logsumexp(chosen)
        share = jnp.where(jnp.isfinite(total), jnp.exp(chosen - total), 0.0)
        middle = share @ apart
        around = apart - middle
        covariance = jnp.einsum("k,kij->ij", share, mixture.covariance) + jnp.einsum(
            "k,ki,kj->ij", share, around, around
        )
        # A slot that nothing is left for keeps something harmless.
        covariance = jnp.where(jnp.isfinite(total), covariance, mixture.covariance[best])
        joined = Mixture(total, mixture.mean[best] + middle, covariance, mixture.parent[best])
        return jnp.where(near, -jnp.inf, left), joined

    return jax.lax.scan(one, mixture.log_weight, None, length=count)[1]
