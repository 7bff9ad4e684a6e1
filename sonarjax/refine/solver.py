"""Levenberg–Marquardt over a ladder of blurs (the only importer of jaxopt)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxopt import LevenbergMarquardt
from jaxtyping import Array, Float


def coarse_to_fine(
    residuals: Callable[..., Float[Array, "pixel"]],
    start: Float[Array, "parameter"],
    blurs: Float[Array, "level"],
    iterations: int,
    *args: Any,
) -> tuple[Float[Array, "parameter"], Float[Array, ""]]:
    """Minimise Σ residuals(p, *args, blur)² for each blur in turn, each from where the last one ended.

    Returns the parameters (parameter,) and the size of the Gauss–Newton step still to go at the finest level.
    """
    solver = LevenbergMarquardt(
        residuals,
        maxiter=iterations,
        damping_parameter=1e-3,
        tol=1e-6,
        xtol=1e-5,
        gtol=1e-6,
        solver="cholesky",
        materialize_jac=True,
        implicit_diff=False,
        jit=True,
        unroll=False,
    )

    def level(parameters: Array, blur: Array) -> tuple[Array, Array]:
        found, state = solver.run(parameters, *args, blur)
        return found, jnp.abs(jnp.linalg.solve(state.jtj + 1e-6 * jnp.eye(len(found)), state.gradient)).max()

    found, steps = jax.lax.scan(level, start, blurs)
    return found, steps[-1]
