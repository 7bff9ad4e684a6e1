"""Reduce a mixture to fewer Gaussians: similar ones are merged, and of the rest the heaviest are kept."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sonarjax.exact import full_precision

COMPARED = 4
"""Components are compared in their first four numbers: yaw, x, y and rate."""
LEAST_STD = 1e-4
"""Smaller differences are ignored [rad, m, rad/frame], however certain a component is."""
ALIKE = 1.5
"""Largest ratio of the yaw standard deviations of components that are merged. A frame with the wide error of a
tail is another explanation than the same frame with its stated error, and their mean would be neither.
"""


class Mixture(NamedTuple):
    """Weighted Gaussians, each with the number of the earlier one that it continues."""

    log_weight: Float[Array, "component"]
    mean: Float[Array, "component state"]
    covariance: Float[Array, "component state state"]
    parent: Int[Array, "component"]


def signed(angle: Array) -> Array:
    """An angle [rad] brought into [-π, π)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


@full_precision
def reduced(mixture: Mixture, count: int, merge: Array) -> Mixture:
    """Reduce to `count` components: repeatedly merge the heaviest with all within `merge` of its standard deviations.

    Merging keeps mean and covariance (Salmond, Mixture Reduction Algorithms for Target Tracking in Clutter, 1990).
    Components that lie far apart, or that differ much in certainty, are not merged. The first number is yaw, which is
    circular.
    """

    def one(left: Array, _: None) -> tuple[Array, Mixture]:
        best = jnp.argmax(left)
        apart = mixture.mean - mixture.mean[best]
        apart = apart.at[:, 0].set(signed(apart[:, 0]))
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
        # If no component is left for this place, it keeps a harmless covariance.
        covariance = jnp.where(jnp.isfinite(total), covariance, mixture.covariance[best])
        joined = Mixture(total, mixture.mean[best] + middle, covariance, mixture.parent[best])
        return jnp.where(near, -jnp.inf, left), joined

    return jax.lax.scan(one, mixture.log_weight, None, length=count)[1]
