"""Levenberg–Marquardt over a ladder of blurs (the only importer of jaxopt).

The template is rendered once an iteration, with its derivatives; in between, jaxopt minimises 1 − NCC of the template's
linear model inside a trust region, which costs next to nothing beside a render.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxopt import LevenbergMarquardt
from jaxtyping import Array, Bool, Float

from sonarjax.refine.objective import ROW_STRIDE, Blur, Problem, box_around, make_blur, normalised
from sonarjax.refine.template import draw_with_slope
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar

TRUST = (0.12, 0.02, 0.02, 0.2)  # largest step in yaw [rad], x, y [m] and a bounce's energy that is believed
INNER_STEPS = 4


class Found(NamedTuple):
    """The best of the iterations at the finest blur."""

    cost: Float[Array, ""]
    """1 − NCC of the blurred images."""
    step: Float[Array, "step"]
    """Yaw [rad], x [m] and y [m] from the start, and the bounce's energy for the echo."""
    template: Float[Array, "range beam"]
    """What is rendered there, see `draw`."""
    slope: Float[Array, "step range beam"]
    """Its derivatives by each number of `step`."""
    remaining: Float[Array, "step"]
    """The step that the linear model would still take from there, as a share of the trust region."""
    weight: Float[Array, "range beam"]
    """1 where a pixel counted: it was measured, and lies inside the start's margin if there is one."""


def coarse_to_fine(
    problem: Problem, mesh: Mesh, sonar: Sonar, bounds: Float[Array, "2 step"],
    blurs: Float[Array, "blur"], iterations: int, sub_beams: int, template: str, margin: tuple[int, int] | None,
) -> Found:  # fmt: skip
    """Minimise 1 − NCC for each blur [range bins] in turn, `iterations` times each, between `bounds` [rad, m, m, 1].

    With a `margin` (bins, beams) only the box of the first template and so much around it counts.
    """
    shape = (problem.image.shape[0], problem.image.shape[1])
    ladder = jax.vmap(lambda sigma: make_blur(shape, sigma))(blurs)
    level = jnp.repeat(jnp.arange(len(blurs)), iterations)
    # One more look at the last place reached: it may be the best.
    level = jnp.append(level, len(blurs) - 1)
    start = jnp.zeros(bounds.shape[1])
    trust = jnp.asarray(TRUST[: len(start)])

    def iterate(carry: tuple[Array, Array, Found], turn: tuple[Array, Bool[Array, ""]]) -> tuple[Any, None]:
        step, weight, best = carry
        level, first = turn
        blur = jax.tree.map(lambda v: v[level], ladder)
        drawn, slope = draw_with_slope(problem, mesh, sonar, step, sub_beams, template)
        if margin is not None:  # here rather than before the loop, which would compile the renderer twice
            weight = jnp.where(first, weight * box_around(drawn, margin), weight)
        move, cost = _linear_step(problem._replace(weight=weight), blur, drawn, slope, trust)
        here = Found(cost, step, drawn, slope, move / trust, weight)
        better = (level == len(blurs) - 1) & (cost < best.cost)
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), here, best)
        return (jnp.clip(step + move, *bounds), weight, best), None

    dark, flat = jnp.zeros(shape), jnp.zeros((len(start), *shape))
    none = Found(jnp.asarray(jnp.inf), start, dark, flat, jnp.ones_like(start), problem.weight)
    turns = level, jnp.arange(len(level)) == 0
    (_, _, best), _ = jax.lax.scan(iterate, (start, problem.weight, none), turns)
    return best


def _linear_step(problem: Problem, blur: Blur, drawn: Array, slope: Array, trust: Array) -> tuple[Array, Array]:
    """The step that fits the template's linear model best in the trust region, and 1 − NCC before it."""
    weight = problem.weight[::ROW_STRIDE]
    seen = normalised(blur(problem.image * problem.weight), weight)
    centred = jnp.concatenate([drawn[None], slope * trust[:, None, None]]) * problem.weight
    now, *change = blur(stop_gradient(centred))

    def residuals(parameters: Float[Array, "step"]) -> Float[Array, "pixel"]:
        share = jnp.tanh(parameters)
        moved = now + sum(share[k] * change[k] for k in range(len(trust)))
        return (normalised(moved, weight) - seen).reshape(-1)

    none = jnp.zeros(len(trust))
    solver = LevenbergMarquardt(
        residuals, maxiter=INNER_STEPS, damping_parameter=1e-3, tol=1e-6, xtol=1e-5, gtol=1e-6, solver="cholesky",
        materialize_jac=True, implicit_diff=False, jit=True, unroll=False,
    )  # fmt: skip
    found, _ = solver.run(none)
    return jnp.tanh(found) * trust, (residuals(none) ** 2).sum() / 2
