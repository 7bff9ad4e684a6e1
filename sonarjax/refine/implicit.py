"""The derivative of a refined pose by what it was refined from: the implicit function theorem at the solution.

At a stationary point z of F(z, θ), dz/dθ = −H⁻¹ ∂²F/∂z∂θ with H = ∂²F/∂z² (Krantz and Parks, The Implicit Function
Theorem, 2002). Both second derivatives are central differences of first derivatives, with displacements longer than the
roughness that pixels give F. Gauss–Newton's JᵀJ alone would omit the residuals' contribution, which is large on noisy
frames.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from sonarjax.refine.free import displacements
from sonarjax.refine.objective import Blur, Problem, misfit

LEAST_CURVATURE = 1e-3
"""Least eigenvalue of the Hessian, in units of the displacements, as a share of the largest; below it the
solution is not determined.
"""


def hessian(problem: Problem, blur: Blur, step: Float[Array, "step"]) -> Float[Array, "step step"]:
    """Second derivatives of the misfit at `step`, as differences of its forward-mode gradients."""

    def gradient(at: Array) -> Array:
        return jax.vmap(lambda along: jax.jvp(lambda s: misfit(problem, blur, s), (at,), (along,))[1])(
            jnp.eye(len(step))
        )

    away = jnp.asarray(displacements(problem.subject.free))
    ahead = jnp.diag(away)
    slopes = jax.lax.map(gradient, jnp.concatenate([step + ahead, step - ahead]))
    up, down = slopes[: len(step)], slopes[len(step) :]
    rows = (up - down) / (2 * away[:, None])
    return (rows + rows.T) / 2


def is_minimum(
    curvature: Float[Array, "step step"], free: Bool[Array, "step"], scale: Float[Array, "step"]
) -> Bool[Array, ""]:
    """True if the misfit clearly curves upwards in every `free` direction, in units of `scale` (step,)."""
    scaled = curvature * scale[:, None] * scale
    most = jnp.abs(jnp.where(free, jnp.diag(scaled), 0.0)).max()
    # Held numbers get the largest curvature, so that they do not count.
    scaled = jnp.where(free[:, None] & free, scaled, jnp.diag(jnp.full(len(scale), most)))
    ok = jnp.isfinite(scaled).all() & (most > 0)
    lowest = jnp.linalg.eigvalsh(jnp.where(ok, scaled, jnp.eye(len(scale)))).min()
    return ok & (lowest > LEAST_CURVATURE * most) & free.any()


@jax.custom_vjp
def attach(
    solution: Float[Array, "step"], problem: Problem, blur: Blur, curvature: Float[Array, "step step"],
    free: Bool[Array, "step"], determined: Bool[Array, ""],
) -> Float[Array, "step"]:  # fmt: skip
    """`solution` unchanged, with its derivative by everything in `problem`; the derivative is zero unless `determined`.

    `curvature` is the misfit's Hessian there. Numbers that are not `free` lie on a bound or are not fitted, and leave
    the system of equations. A minimum does not depend on the start, which therefore gets no derivative.
    """
    return solution


def _forward(solution: Any, problem: Any, blur: Any, curvature: Any, free: Any, determined: Any) -> Any:
    return solution, (solution, problem, blur, curvature, free, determined)


def _backward(kept: Any, wanted: Float[Array, "step"]) -> Any:
    solution, problem, blur, curvature, free, determined = kept
    held = ~free
    system = jnp.where(held[:, None] | held, jnp.eye(len(solution)), curvature)
    direction = jnp.linalg.solve(system, jnp.where(held, 0.0, wanted))
    usable = determined & jnp.isfinite(direction).all()
    direction = jnp.where(usable, direction, 0.0)
    # The mixed derivative along `direction` is the difference of two gradients by θ.
    size = jnp.maximum(jnp.abs(direction / jnp.asarray(displacements(problem.subject.free))).max(), 1e-12)
    shift = direction / size

    leaves, tree = jax.tree.flatten(problem)
    inexact = [jnp.issubdtype(jnp.result_type(v), jnp.inexact) for v in leaves]
    floats = [v for v, real in zip(leaves, inexact, strict=True) if real]

    def at(step: Array) -> list[Array]:
        def of(values: list[Array]) -> Array:
            given = iter(values)
            joined = [next(given) if real else v for v, real in zip(leaves, inexact, strict=True)]
            return misfit(jax.tree.unflatten(tree, joined), blur, step, reverse=True)

        return jax.grad(of)(floats)

    slopes = jax.lax.map(at, jnp.stack([solution + shift, solution - shift]))
    found = iter([jnp.where(usable, -size * (v[0] - v[1]) / 2, 0.0) for v in slopes])
    by_problem = [next(found) if real else _no_tangent(v) for v, real in zip(leaves, inexact, strict=True)]
    by_problem = jax.tree.unflatten(tree, by_problem)
    zeros = [jax.tree.map(_zero_tangent, v) for v in (blur, curvature, free, determined)]
    return jnp.zeros_like(wanted), by_problem, *zeros


def _no_tangent(value: Any) -> np.ndarray:
    """What JAX expects as the derivative by an integer."""
    return np.zeros(np.shape(value), jax.dtypes.float0)


def _zero_tangent(value: Any) -> Any:
    real = jnp.issubdtype(jnp.result_type(value), jnp.inexact)
    return jnp.zeros_like(value) if real else _no_tangent(value)


attach.defvjp(_forward, _backward)


def without_gradient(tree: Any) -> Any:
    """All leaves of a pytree as constants."""
    return jax.tree.map(stop_gradient, tree)
