"""`refine_yaw`: continuous yaw and position, by differentiating the rendered template (beyond the paper)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.records import record
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.implicit import attach, hessian, is_minimum, without_gradient
from sonarjax.refine.objective import Problem, crop_score, make_blur, normalised
from sonarjax.refine.solver import SETTLED_SHARE, STATIONARY_SHARE, TRUST, Found, Search, Solution, coarse_to_fine
from sonarjax.refine.template import BOUNCE_BOUNDS, VIEWS, Subject, nominal_law, pose_at
from sonarjax.render import RenderQuality, WindowSize, place_window, plan_window
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.render.simulate import one_by_one
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

SLACK_M = 0.06
"""Room around the start inside the window [m]."""
CORRELATED_BEAMS = 5
"""Beams over which residuals err together, less and less, in `yaw_std`."""
INSIDE = 0.98
"""Share of the bounds inside which a solution is an interior one."""


@record
class YawEstimate:
    """A refined hypothesis; every field has the batch shape of the starts, and none is ever NaN."""

    yaw: Float[Array, "*batch"]
    """Absolute yaw [rad], in [0, 2π)."""
    x: Float[Array, "*batch"]
    """Forward position [m]."""
    y: Float[Array, "*batch"]
    """Position to port [m]."""
    yaw_std: Float[Array, "*batch"]
    """Standard deviation of yaw [rad] from the curvature and the residuals of each beam, given the right basin.

    On labels of a render it has the size of the error; errors that neighbouring beams share make it too small.
    Infinite where nothing could be compared."""
    score: Float[Array, "*batch"]
    """NCC (eq. 4) of the refined template, over its own box with the bank's margin; 0 where there is none."""
    start_score: Float[Array, "*batch"]
    """NCC of the start's template, over its own box with the same margin."""
    converged: Bool[Array, "*batch"]
    """True when the last step was small and the result is inside its bounds."""
    determined: Bool[Array, "*batch"]
    """True when it is polished to an interior minimum, and so has a derivative; without polishing always False."""

    @property
    def pose(self) -> Pose:
        """The estimate as a `Pose` [m, rad] on the floor: z, roll and pitch are 0, whatever the start had."""
        return Pose(self.x, self.y, self.yaw)


@record
class Drawn:
    """What was drawn at the solutions, each in its own window of the frame."""

    template: Float[Array, "*batch row column"]
    """The template that was fitted, as what it differs from the bare floor."""
    labels: Float[Array, "*batch row column"]
    """The semantic template, less the background's 0.5."""
    row: Int[Array, "*batch"]
    """First range bin of the window."""
    column: Int[Array, "*batch"]
    """First beam of the window."""


def refine_yaw(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    start: Pose,
    *,
    mask: Any = None,
    config: RefineConfig = RefineConfig(),
    window: WindowSize | None = None,
    engine: Engine = PLAIN,
) -> YawEstimate:
    """Refine yaw, x and y of the object from `start` by Levenberg–Marquardt on 1 − NCC of the rendered template.

    `image` (range, beam) is the semantic image, or any grey one in which highlight is brighter than shadow; with a
    leading batch axis, `start` holds one pose a frame. A start whose fields have one more axis holds several
    hypotheses a frame, and the estimate keeps that axis. `mask`, of the image's shape, is true where a pixel was
    measured. `window` is the part of the frame that is rendered: plan it with `plan_refinement` where the call is
    traced, else all of the frame is.

    yaw, x and y have derivatives by image, mesh vertices and sonar (reverse mode; see `implicit`), provided
    `config.polish` is not 0; where `determined` is False they are zero.

    Raises SonarjaxError when the shapes do not fit the sonar.
    """
    return refine_and_draw(image, mesh, sonar, start, mask, config, window, engine)[0]


def refine_and_draw(
    image: Any, mesh: Mesh, sonar: Sonar, start: Pose, mask: Any, config: RefineConfig, window: WindowSize | None,
    engine: Engine,
) -> tuple[YawEstimate, Drawn]:  # fmt: skip
    """As `refine_yaw`, with what was drawn at the solutions."""
    traced = is_traced(image, mask, mesh, sonar, start)
    array = jnp if traced else np  # on the host NumPy cuts and joins without compiling anything
    image = array.asarray(image, np.float32)
    if image.ndim not in (2, 3) or image.shape[-2:] != sonar.shape:
        raise SonarjaxError(f"image: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    weight = array.ones(image.shape, np.float32) if mask is None else array.asarray(mask, np.float32)
    if weight.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {weight.shape}")
    frames, axes = image.ndim - 2, start.shape
    if len(axes) not in (frames, frames + 1) or axes[:frames] != image.shape[:frames]:
        raise SonarjaxError(f"start: expected one pose (or one axis of poses) for each image, got shape {axes}")
    size = window or plan_refinement(mesh, sonar, start, config)
    # One long list of frames and starts.
    starts = jax.tree.map(lambda v: array.asarray(v).reshape(-1), start)
    count = math.prod(axes)
    which = np.arange(count) // max(count // max(math.prod(axes[:frames]), 1), 1)
    images, weights = (v.reshape(-1, *sonar.shape) for v in (image, weight))
    settings = _settings(config)
    static = {"size": size, "quality": config.quality, "polished": config.polish > 0}
    if traced:
        jobs = images[which], weights[which], starts
        found = one_by_one(lambda job: _refine(*job[:2], mesh, sonar, job[2], *settings, **static), jobs)
        return jax.tree.map(lambda v: v.reshape((*axes, *v.shape[1:])), found)

    def job(k: int) -> tuple[YawEstimate, Drawn]:
        begin = jax.tree.map(lambda v: v[k], starts)
        done = engine.run(_refine, images[which[k]], weights[which[k]], mesh, sonar, begin, *settings, **static)
        return jax.tree.map(np.asarray, done)

    found = engine.map(job, range(count))
    return jax.tree.map(lambda *v: jax.device_put(np.stack(v).reshape((*axes, *v[0].shape))), *found)


def prepare_refinement(
    mesh: Mesh, sonar: Sonar, start: Pose, config: RefineConfig, engine: Engine, window: WindowSize | None = None
) -> None:
    """Have `engine` compile the refinement of one start of frames of this sonar, before there is a frame."""
    image = np.zeros(sonar.shape, np.float32)
    begin = jax.tree.map(np.asarray, start)
    size = window or plan_refinement(mesh, sonar, start, config)
    static = {"size": size, "quality": config.quality, "polished": config.polish > 0}
    engine.prepare(_refine, image, image, mesh, sonar, begin, *_settings(config), **static)


def is_traced(*trees: Any) -> bool:
    """True where a leaf of these pytrees is being traced: a function around this one is compiled or differentiated."""
    return any(isinstance(v, jax.core.Tracer) for v in jax.tree.leaves(trees))


def plan_refinement(mesh: Mesh, sonar: Sonar, start: Pose, config: RefineConfig) -> WindowSize:
    """Size of the window that `refine_yaw` renders, for starts [m, rad] of any shape; a host function.

    The window is large enough for the object and its shadow at each start, however it is turned, `SLACK_M` around it
    included. The object itself touches no more than the planned beams while x and y stay within the bounds. Where
    tracing hides the places, the mesh or the sonar, it is the whole frame.
    """
    if is_traced(start, sonar, mesh):
        return WindowSize(sonar.shape, sonar.n_beams)
    ground = np.hypot(np.asarray(start.x), np.asarray(start.y))
    nearest = max(float(ground.min()) - max(config.bounds[1:]), 0.0)
    shapes = [plan_window(mesh, sonar, float(g), SLACK_M).shape for g in (ground.min(), ground.max())]
    rows, columns = max(s[0] for s in shapes), max(s[1] for s in shapes)
    # Coarse steps: compiling the solver for another window costs far more than a few empty pixels.
    shape = min(-(-rows // 128) * 128, sonar.n_ranges), min(-(-columns // 32) * 32, sonar.n_beams)
    beams = plan_window(mesh, sonar, nearest).object_columns
    assert beams is not None
    return WindowSize(shape, min(-(-beams // 16) * 16, sonar.n_beams))


def _settings(config: RefineConfig) -> tuple[Any, ...]:
    """A config's numbers, which are traced: searches of all kinds share compiled code."""
    bounds = [*((-most, most) for most in config.bounds), BOUNCE_BOUNDS[config.template]]
    search = Search(
        bounds=np.asarray(bounds, np.float32).T,
        blurs=np.asarray(config.blurs, np.float32),
        iterations=np.int32(config.iterations),
        polish=np.int32(config.polish),
        score_margin=np.array([MARGIN_BINS, MARGIN_BEAMS], np.int32),
    )
    everywhere = np.full(2, 1 << 20, np.int32)
    margin = everywhere if config.margin is None else np.array(config.margin, np.int32)
    return search, np.float32(config.sharpness), np.int32(VIEWS[config.template]), margin


@partial(jax.jit, static_argnames=("size", "quality", "polished"))
def _refine(
    image: Array, weight: Array, mesh: Mesh, sonar: Sonar, start: Pose, search: Search, sharpness: Array, views: Array,
    margin: Array, *, size: WindowSize, quality: RenderQuality, polished: bool,
) -> tuple[YawEstimate, Drawn]:  # fmt: skip
    """One start in one image: the window is cut out, searched, and the derivative attached."""
    window = without_gradient(place_window(size, mesh, sonar, start.x, start.y, SLACK_M))
    part, measured = (jax.lax.dynamic_slice(v, (window.row, window.column), size.shape) for v in (image, weight))
    subject = Subject(mesh, sonar, start, window, sharpness, views, nominal_law(), quality)
    problem = Problem(part, measured, subject, margin)
    fixed = without_gradient(problem)
    solution = coarse_to_fine(fixed, search)
    best = solution.best
    score = crop_score(fixed.image, best.template, solution.weight, search.score_margin)
    # The last step of a search that has settled is small: it is taken without another render.
    left = jnp.abs(best.remaining)
    last = jnp.where(left.max() < SETTLED_SHARE, best.remaining * jnp.asarray(TRUST), 0.0)
    step = jnp.clip(best.step + last, *search.bounds)
    inside = jnp.abs(step) < INSIDE * search.bounds[1]
    converged = inside[:3].all() & (left[:3].max() < SETTLED_SHARE) & jnp.isfinite(best.cost)
    determined = jnp.zeros((), bool)
    if polished:
        fitted = _as_solved(problem, solution)
        blur = make_blur(size.shape, search.blurs[-1])
        free = inside & (search.bounds[1] > 0) & (step > search.bounds[0])
        curvature = hessian(without_gradient(fitted), blur, step)
        settled = converged & (left[:3].max() < STATIONARY_SHARE)
        determined = settled & is_minimum(curvature, free)
        step = attach(step, fitted, blur, curvature, free, determined)
    pose = pose_at(without_gradient(start), step)
    estimate = YawEstimate(
        yaw=pose.yaw % (2 * jnp.pi),
        x=pose.x,
        y=pose.y,
        yaw_std=_yaw_std(fixed.image, solution.weight, best),
        score=jnp.nan_to_num(score),
        start_score=jnp.nan_to_num(solution.start_score),
        converged=converged,
        determined=determined,
    )
    row, column = jnp.asarray(window.row), jnp.asarray(window.column)
    return estimate, without_gradient(Drawn(best.template, best.labels, row, column))


def _as_solved(problem: Problem, solution: Solution) -> Problem:
    """The problem with pixels and template as the search chose them: its objective no longer depends on the start."""
    return problem._replace(
        weight=solution.weight, subject=replace(problem.subject, views=solution.views, law=solution.law)
    )


def _yaw_std(image: Array, weight: Array, found: Found) -> Array:
    """Square root of the yaw entry of (JᵀJ)⁻¹·B·(JᵀJ)⁻¹, J of the image fitted by gain·template + offset.

    B sums the outer products of the Jᵀr of pairs of beams, those `CORRELATED_BEAMS` and more apart left out (Newey and
    West, Econometrica 55, 1987): residuals along a beam and of its neighbours err together where an edge is a little
    off, so the plain σ²(JᵀJ)⁻¹ is far too small. Infinite where nothing could be compared.
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
    ridge = 1e-6 * jnp.trace(information) + 1e-12
    inverse = jnp.linalg.inv(information + ridge * jnp.eye(len(information)))
    apart = np.abs(np.arange(image.shape[1])[:, None] - np.arange(image.shape[1]))
    together = jnp.asarray(np.maximum(1 - apart / CORRELATED_BEAMS, 0.0), jnp.float32)
    covariance = inverse @ (by_beam @ together @ by_beam.T) @ inverse
    known = jnp.isfinite(found.cost) & jnp.isfinite(covariance[0, 0]) & (information[0, 0] > 0)
    return jnp.where(known, jnp.sqrt(jnp.maximum(covariance[0, 0], 0.0)), jnp.inf)
