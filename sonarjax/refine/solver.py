"""Levenberg–Marquardt over a ladder of blurs (the only importer of jaxopt).

The template is rendered once an iteration, with its derivatives; in between, jaxopt minimises 1 − NCC of the template's
linear model inside a trust region, which costs next to nothing beside a render.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxopt import LevenbergMarquardt
from jaxtyping import Array, Bool, Float, Int

from sonarjax.refine.free import trusts
from sonarjax.refine.objective import ROW_STRIDE, Blur, Problem, box_around, crop_score, make_blur, normalised
from sonarjax.refine.template import (
    EITHER,
    VIEWS,
    EchoLaw,
    Subject,
    echo_laws,
    layers_with_slope,
    paint,
    paint_with_slope,
    semantic_template,
)

INSIDE = 0.98
"""Share of the bounds inside which a solution is an interior one."""
INNER_STEPS = 4
SETTLED_SHARE = 0.02
"""Of the trust region: after a smaller step the next blur is begun, or the search ends."""
POLISHED_SHARE = 1e-4
"""As `SETTLED_SHARE`, where the last blur is polished."""

STATIONARY_SHARE = 2.5e-3
"""As `SETTLED_SHARE`: a solution with no larger step to go counts as stationary, and may have a derivative."""


class Search(NamedTuple):
    """How one problem is searched: numbers only (of NumPy, or traced), so that all searches share compiled code."""

    bounds: Any
    """Least and largest step (2, step): the free numbers [rad, m] and a bounce's energy [1]."""
    blurs: Any
    """Standard deviations (blur,) of the blurs [range bins], coarse to fine."""
    iterations: Any
    """Renders at each blur, at most."""
    polish: Any
    """Further renders at the last blur, at most."""
    score_margin: Any
    """Bins and beams around the template over which its NCC is reported."""


class Found(NamedTuple):
    """The best of the iterations at the finest blur."""

    cost: Float[Array, ""]
    """1 − NCC of the blurred images; infinite where nothing could be compared."""
    step: Float[Array, "step"]
    """The free numbers [rad, m] from the start, and the bounce's energy for the echo."""
    template: Float[Array, "range beam"]
    """What is rendered there, see `draw`."""
    labels: Float[Array, "range beam"]
    """The semantic template there, less the background's 0.5."""
    slope: Float[Array, "step range beam"]
    """The fitted template's derivatives by each number of `step`."""
    remaining: Float[Array, "step"]
    """The step that the linear model would still take from there, as a share of the trust region."""


class Solution(NamedTuple):
    """Where a search ended."""

    best: Found
    """The best point."""
    weight: Float[Array, "range beam"]
    """1 where a pixel counted: it was measured, and lies inside the start's margin."""
    views: Int[Array, ""]
    """Which template was fitted, see `VIEWS`: where either would do, the one that fits the start better."""
    law: EchoLaw
    """How the echo is stored: of all laws that are tried the one that fits the start best."""
    start_score: Float[Array, ""]
    """NCC of the start's template, unblurred."""
    renders: Int[Array, ""]
    """How often the template was rendered."""


class _State(NamedTuple):
    """What the search carries from one render to the next."""

    level: Int[Array, ""]
    renders_here: Int[Array, ""]  # at this blur
    step: Float[Array, "step"]
    done: Bool[Array, ""]
    solution: Solution


def coarse_to_fine(problem: Problem, search: Search) -> Solution:
    """Minimise 1 − NCC at each blur in turn, until steps are small or the renders are used up."""
    shape = (problem.image.shape[0], problem.image.shape[1])
    last = len(search.blurs) - 1
    ladder = jax.vmap(lambda sigma: make_blur(shape, sigma))(search.blurs)
    trust = jnp.asarray(trusts(problem.subject.free))
    # A number that may not move takes no part.
    movable = jnp.where(search.bounds[1] > search.bounds[0], trust, 0.0)
    is_echo = problem.subject.views != VIEWS["semantic"]

    def iterate(state: _State) -> _State:
        blur = jax.tree.map(lambda v: v[state.level], ladder)
        solution, first = state.solution, state.solution.renders == 0
        layers, slopes = layers_with_slope(replace(problem.subject, views=solution.views), state.step)
        choose = partial(best_template, problem, layers, search)
        views, law = jax.lax.cond(first & is_echo, choose, lambda: (solution.views, solution.law))
        subject = replace(problem.subject, views=views, law=law)
        drawn, slope = paint_with_slope(subject, layers, slopes, state.step[-1])
        # Here rather than before the loop, which would compile the renderer twice.
        weight = jnp.where(first, problem.weight * box_around(drawn, problem.margin), solution.weight)
        start_score = crop_score(problem.image, drawn, problem.weight, search.score_margin)
        change, cost = _linear_step(problem.image, weight, blur, drawn, slope, movable)
        here = Found(cost, state.step, drawn, semantic_template(layers), slope, change / trust)
        finest = state.level == last
        better = finest & (cost < solution.best.cost)
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), here, solution.best)
        next_step = jnp.clip(state.step + change, *search.bounds)
        moved = jnp.abs((next_step - state.step) / trust).max()
        small = moved < jnp.where(finest & (search.polish > 0), POLISHED_SHARE, SETTLED_SHARE)
        # One more look at the last place reached: it may be the best.
        most = search.iterations + jnp.where(finest, search.polish + 1, 0)
        over = small | (state.renders_here + 1 >= most)
        return _State(
            level=jnp.where(over, jnp.minimum(state.level + 1, last), state.level),
            renders_here=jnp.where(over, 0, state.renders_here + 1),
            step=next_step,
            done=finest & over,
            solution=Solution(
                best, weight, views, law, jnp.where(first, start_score, solution.start_score), solution.renders + 1
            ),
        )

    first, zero = begun(problem, search), jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(
        lambda state: ~state.done, iterate, _State(zero, zero, first.best.step, jnp.zeros((), bool), first)
    ).solution


def begun(problem: Problem, search: Search) -> Solution:
    """A search before its first render."""
    shape = (problem.image.shape[0], problem.image.shape[1])
    start = jnp.clip(jnp.zeros(len(problem.subject.free) + 1), *search.bounds)
    dark, flat = jnp.zeros(shape), jnp.zeros((len(start), *shape))
    none = Found(jnp.asarray(jnp.inf), start, dark, dark, flat, jnp.ones_like(start))
    # Both templates are painted from the echo's views.
    views = jnp.where(problem.subject.views != VIEWS["semantic"], VIEWS["echo"], VIEWS["semantic"])
    return Solution(none, problem.weight, views, problem.subject.law, jnp.zeros(()), jnp.zeros((), jnp.int32))


def best_template(problem: Problem, layers: Array, search: Search) -> tuple[Int[Array, ""], EchoLaw]:
    """The template of the start's `layers`, as in `VIEWS`, and the echo's law, whose NCC with the image is largest."""

    def score(subject: Subject) -> Array:
        drawn = paint(subject, layers, jnp.zeros(()))
        return crop_score(problem.image, drawn, problem.weight, search.score_margin)

    semantic, echo = (jnp.int32(VIEWS[name]) for name in ("semantic", "echo"))
    laws = jax.tree.map(jnp.asarray, echo_laws())
    by_law = jax.lax.map(lambda law: score(replace(problem.subject, views=echo, law=law)), laws)
    law = jax.tree.map(lambda v: v[jnp.argmax(by_law)], laws)
    plain = (problem.subject.views == EITHER) & (score(replace(problem.subject, views=semantic)) > by_law.max())
    return jnp.where(plain, semantic, echo), law


def _linear_step(
    image: Array, weight: Array, blur: Blur, drawn: Array, slope: Array, trust: Array
) -> tuple[Array, Array]:
    """The step that fits the template's linear model best in the trust region, and 1 − NCC before it.

    Where nothing can be compared (no template, or no pixel of it measured) the step is zero and the cost infinite.
    """
    rows = weight[::ROW_STRIDE]
    seen = normalised(blur(image * weight), rows)
    centred = jnp.concatenate([drawn[None], slope * trust[:, None, None]]) * weight
    now, *change = blur(stop_gradient(centred))

    def residuals(parameters: Float[Array, "step"]) -> Float[Array, "pixel"]:
        share = jnp.tanh(parameters)
        moved = now + sum(share[k] * change[k] for k in range(len(trust)))
        return (normalised(moved, rows) - seen).reshape(-1)

    none = jnp.zeros(len(trust))
    solver = LevenbergMarquardt(
        residuals, maxiter=INNER_STEPS, damping_parameter=1e-3, tol=1e-6, xtol=1e-5, gtol=1e-6, solver="cholesky",
        materialize_jac=True, implicit_diff=False, jit=True, unroll=False,
    )  # fmt: skip
    found, _ = solver.run(none)
    cost = (residuals(none) ** 2).sum() / 2
    comparable = jnp.any(drawn * weight != 0) & jnp.isfinite(cost) & jnp.isfinite(found).all()
    step = jnp.where(comparable, jnp.nan_to_num(jnp.tanh(found)) * trust, 0.0)
    return step, jnp.where(comparable, cost, jnp.inf)
