"""How well a frame determines the free numbers of a pose: their covariance, and which are determined at all."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sonarjax.exact import full_precision
from sonarjax.refine.objective import normalised
from sonarjax.refine.solver import Found

CORRELATED_BEAMS = 5
"""Residuals fewer beams apart than this count as correlated; their weight falls linearly with their distance."""
OBSERVABLE = 0.5
"""A number is determined if at most this share of its prior's standard deviation is left [1]."""
FINEST = 40.0
"""No number is assumed to be known better than its prior's standard deviation divided by this [1], with the
usual bounds 2 mm and 0.6°. On noisy frames templates are not more exact, and a facet of a tessellated body
would pass for an edge that determines yaw.
"""
LEAST_SHARE = 1e-3
"""Directions with a smaller share of the information are not used to judge how noisy it is [1]."""


RIDGE = 1e-6
"""Added to the information before it is inverted, as a share of what it says of each number [1]."""


class Normal(NamedTuple):
    """The normal equations of one frame at a solution, in units of the image's norm."""

    information: Float[Array, "step step"]
    """JᵀJ, where J is the Jacobian of the image fitted by gain·template + offset."""
    noise: Float[Array, "step step"]
    """Covariance of Jᵀ·residual: its outer products, summed over pairs of beams."""


class Observability(NamedTuple):
    """Which numbers of a step the frames determine."""

    observable: Bool[Array, "step"]
    """Which numbers they determine."""
    singular_values: Float[Array, "pose"]
    """Singular values of what the frames say about the pose's numbers, in units of their priors, largest first."""


@full_precision
def normal_equations(
    image: Float[Array, "range beam"], weight: Float[Array, "range beam"], found: Found
) -> Normal:  # fmt: skip
    """The normal equations of the image (range, beam) fitted by gain·template + offset.

    `noise` sums the outer products of Jᵀr over pairs of beams less than `CORRELATED_BEAMS` apart (Newey and West,
    Econometrica 55, 1987). Where an edge is slightly off, residuals along a beam and in its neighbours err together, so
    the plain σ²(JᵀJ)⁻¹ is far too small.
    """
    drawn = found.template
    fitted, seen = normalised(drawn, weight), normalised(image, weight)
    gain = (fitted * seen).sum()
    left = seen - gain * fitted
    centred = (drawn - (drawn * weight).sum() / jnp.maximum(weight.sum(), 1.0)) * weight
    scale = gain / jnp.sqrt((centred**2).sum() + 1e-9)
    slope = found.slope * weight * scale
    information = jnp.einsum("irb,jrb->ij", slope, slope)
    by_beam = jnp.einsum("irb,rb->ib", slope, left)
    apart = np.abs(np.arange(image.shape[1])[:, None] - np.arange(image.shape[1]))
    together = jnp.asarray(np.maximum(1 - apart / CORRELATED_BEAMS, 0.0), jnp.float32)
    return Normal(information, by_beam @ together @ by_beam.T)


@full_precision
def error_covariance(
    normal: Normal, prior: Float[Array, "step"], held: Bool[Array, "step"], known: Bool[Array, ""]
) -> Float[Array, "step step"]:
    """Covariance (step, step) of the errors of a step; infinite on the diagonal where nothing is known.

    For fitted numbers it is (JᵀJ)⁻¹·B·(JᵀJ)⁻¹.

    Args:
        normal: The normal equations.
        prior: Standard deviations of the prior (step,).
        held: Numbers that were held at their start (step,). Their errors are those of the prior, and pass on to the
            others.
        known: False if nothing is known.
    """
    information, noise = normal
    size = len(information)
    fixed = held[:, None] | held
    inverse = _inverse(jnp.where(fixed, jnp.eye(size), information))
    spread = inverse @ jnp.where(fixed, 0.0, noise) @ inverse
    passed_on = -inverse @ jnp.where(held & ~held[:, None], information, 0.0) + jnp.diag(held.astype(jnp.float32))
    covariance = spread + (passed_on * jnp.where(held, prior**2, 0.0)) @ passed_on.T
    variance = jnp.diag(covariance)
    known = known & jnp.isfinite(variance) & ((jnp.diag(information) > 0) | held)
    off = jnp.where(known[:, None] & known, covariance, 0.0)
    return jnp.where(jnp.eye(size, dtype=bool), jnp.where(known, jnp.maximum(variance, 0.0), jnp.inf), off)


def _inverse(information: Float[Array, "step step"]) -> Float[Array, "step step"]:
    """The inverse, with a ridge.

    Each number is scaled to an information of 1 of its own first. A ridge in mixed units would drown a number about
    which little is known, and make it seem the better known the less is said about it.
    """
    told = jnp.diag(information)
    scale = 1 / jnp.sqrt(jnp.where(told > 0, told, 1.0))
    scaled = information * scale[:, None] * scale
    return jnp.linalg.inv(scaled + RIDGE * jnp.eye(len(told))) * scale[:, None] * scale


@full_precision
def observability(normal: Normal, prior: Float[Array, "step"], known: Bool[Array, ""], count: int) -> Observability:
    """Which numbers are determined, from the information in units of the `prior` (step,), standard deviations.

    The first `count` numbers are the pose's. None is determined if `known` is false. Because residuals err together,
    the information overstates what the frame says. A single factor corrects this, as in `calibrate`; a sandwich
    estimate for each direction would be mere noise where there is hardly any information.
    """
    scale = prior[:, None] * prior
    information, noise = (jnp.nan_to_num(v * scale) for v in normal)
    size = len(information)
    inverse = jnp.linalg.inv(information + (LEAST_SHARE * jnp.trace(information) + 1e-12) * jnp.eye(size))
    counted = jnp.trace(inverse @ noise) / jnp.maximum(jnp.trace(inverse @ information), 1e-12)
    counted = jnp.maximum(counted, jnp.trace(information) / FINEST**2) + 1e-12
    told = information / counted
    left = jnp.sqrt(jnp.diag(jnp.linalg.inv(told + jnp.eye(size))))
    rest = told[count:, count:] + jnp.eye(size - count)
    alone = told[:count, :count] - told[:count, count:] @ jnp.linalg.solve(rest, told[count:, :count])
    values = jnp.sqrt(jnp.maximum(jnp.linalg.eigvalsh(alone)[::-1], 0.0))
    return Observability(known & (left <= OBSERVABLE), jnp.where(known, values, 0.0))


def prior_std(bounds: Float[Array, "2 step"]) -> Float[Array, "step"]:
    """Standard deviations (step,) of numbers that may lie anywhere within `bounds` (2, step)."""
    return (bounds[1] - bounds[0]) / math.sqrt(12.0)
