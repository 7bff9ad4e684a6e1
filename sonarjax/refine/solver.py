"""Levenberg–Marquardt at a sequence of blurs, coarse to fine (the only importer of jaxopt).

The template and its derivatives are rendered once in each iteration. In between, jaxopt minimises 1 − NCC of the
template's linear model inside a trust region, which costs next to nothing compared to a render.
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
"""A solution within this share of its bounds counts as an interior one."""
INNER_STEPS = 4
SETTLED_SHARE = 0.02
"""Share of the trust region. After a smaller step the next blur begins, or the search ends."""
POLISHED_SHARE = 1e-4
"""As `SETTLED_SHARE`, while the last blur is polished."""

STATIONARY_SHARE = 2.5e-3
"""As `SETTLED_SHARE`. A solution whose remaining step is smaller counts as stationary, and may have a derivative."""


class Search(NamedTuple):
    """How one problem is searched. It holds only numbers (NumPy's, or traced), so that all searches share
    compiled code.
    """

    bounds: Any
    """Least and largest step (2, step): of the free numbers [rad, m] and of the bounces' energies [1]."""
    blurs: Any
    """Standard deviations (blur,) of the blurs [range bins], coarse to fine."""
    iterations: Any
    """Most renders at each blur."""
    polish: Any
    """Most further renders at the last blur."""
    score_margin: Any
    """Bins and beams around the template over which its NCC is computed."""


class Found(NamedTuple):
    """The best of the iterations at the finest blur."""

    cost: Float[Array, ""]
    """1 − NCC of the blurred images; infinite if nothing could be compared."""
    step: Float[Array, "step"]
    """The free numbers [rad, m] relative to the start, and the bounces' energies for the echo."""
    template: Float[Array, "range beam"]
    """The fitted template there, see `draw`."""
    labels: Float[Array, "range beam"]
    """The semantic template there, minus the background's 0.5."""
    slope: Float[Array, "step range beam"]
    """The fitted template's derivatives by each number of `step`."""
    remaining: Float[Array, "step"]
    """The step that the linear model would still take from there, as a share of the trust region."""


class Solution(NamedTuple):
    """The result of a search."""

    best: Found
    """The best point."""
    weight: Float[Array, "range beam"]
    """1 where a pixel counted: it was measured, and lies inside the margin of the start's template."""
    views: Int[Array, ""]
    """Which template was fitted, see `VIEWS`; if either was allowed, the one that fits the start better."""
    law: EchoLaw
    """How the echo is stored: of all laws that are tried, the one that fits the start best."""
    start_score: Float[Array, ""]
    """NCC of the start's template, without blur."""
    renders: Int[Array, ""]
    """Number of renders of the template."""


class _State(NamedTuple):
    """What the search carries from one render to the next."""

    level: Int[Array, ""]
    renders_here: Int[Array, ""]  # at this blur
    step: Float[Array, "step"]
    done: Bool[Array, ""]
    solution: Solution


def coarse_to_fine(problem: Problem, search: Search) -> Solution:
    """Minimise 1 − NCC at each blur in turn, until steps are small or no renders are left."""
    shape = (problem.image.shape[0], problem.image.shape[1])
    last = len(search.blurs) - 1
    ladder = jax.vmap(lambda sigma: make_blur(shape, sigma))(search.blurs)
    trust = jnp.asarray(trusts(problem.subject.free))
    # Numbers without room to move are left out.
    movable = jnp.where(search.bounds[1] > search.bounds[0], trust, 0.0)
    is_echo = problem.subject.views != VIEWS["semantic"]

    def iterate(state: _State) -> _State:
        blur = jax.tree.map(lambda v: v[state.level], ladder)
        solution, first = state.solution, state.solution.renders == 0
        layers, slopes = layers_with_slope(replace(problem.subject, views=solution.views), state.step)
        choose = partial(best_template, problem, layers, search)
        views, law = jax.lax.cond(first & is_echo, choose, lambda: (solution.views, solution.law))
        subject = replace(problem.subject, views=views, law=law)
        drawn, slope = paint_with_slope(subject, layers, slopes, state.step[len(problem.subject.free) :])
        # Computed inside the loop: before it, the renderer would be compiled a second time.
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
        # One more render, because the last point reached may be the best.
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
    start = jnp.clip(jnp.zeros(search.bounds.shape[1]), *search.bounds)
    dark, flat = jnp.zeros(shape), jnp.zeros((len(start), *shape))
    none = Found(jnp.asarray(jnp.inf), start, dark, dark, flat, jnp.ones_like(start))
    # The views of the echo serve for both templates.
    views = jnp.where(problem.subject.views != VIEWS["semantic"], VIEWS["echo"], VIEWS["semantic"])
    return Solution(none, problem.weight, views, problem.subject.law, jnp.zeros(()), jnp.zeros((), jnp.int32))


def best_template(problem: Problem, layers: Array, search: Search) -> tuple[Int[Array, ""], EchoLaw]:
    """The template (see `VIEWS`) and echo law with the largest NCC with the image, given the `layers` at the start."""

    def score(subject: Subject) -> Array:
        drawn = paint(subject, layers, jnp.zeros(len(layers) - 1))
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
    """The step that fits the template's linear model best within the trust region, and 1 − NCC before it.

    If nothing can be compared (no template, or none of its pixels measured), the step is zero and the cost infinite.
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
