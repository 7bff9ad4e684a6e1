"""`refine_yaw`: continuous yaw and position, by differentiating the rendered template (beyond the paper)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sonarjax._cores import SINGLE_CORE, is_traced, on_all_cores, quick_jit
from sonarjax.io.errors import SonarjaxError
from sonarjax.refine.objective import Problem, crop_score, normalised
from sonarjax.refine.solver import Found, coarse_to_fine
from sonarjax.refine.template import BESIDES, pose_at
from sonarjax.render import Window, object_columns, place_window, window_shape
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

BOUNDS = (math.radians(40.0), 0.15, 0.15)
"""Largest change of yaw [rad], x [m] and y [m] from the start."""
BLURS_PX = (8.0, 2.0, 0.8)
"""Standard deviations of the blur in range bins, coarse to fine: the coarse ones widen the basin."""
ITERATIONS = 4
SUB_BEAMS = 1
SHARPNESS = 10.0
SLACK_M = 0.06
CONVERGED_SHARE = 0.05  # of the trust region: a step still to go that counts as none


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class YawEstimate:
    """A refined hypothesis; every field has the batch shape of the starts."""

    yaw: Float[Array, "*batch"]
    """Absolute yaw [rad], in [0, 2π)."""
    x: Float[Array, "*batch"]
    """Forward position [m]."""
    y: Float[Array, "*batch"]
    """Position to port [m]."""
    yaw_std: Float[Array, "*batch"]
    """Standard deviation of yaw [rad] from the curvature and the residuals of each beam, given the right basin.

    On labels of a render it has the size of the error; errors that neighbouring beams share make it too small.
    """
    score: Float[Array, "*batch"]
    """NCC (eq. 4) of the refined template, over its own box with the bank's margin."""
    converged: Bool[Array, "*batch"]
    """True when the last step was small and the result is inside its bounds."""

    @property
    def pose(self) -> Pose:
        """The estimate as a `Pose` [m, rad]."""
        return Pose(self.x, self.y, self.yaw)


def refine_yaw(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    start: Pose,
    *,
    mask: Any = None,
    bounds: tuple[float, float, float] = BOUNDS,
    blurs: tuple[float, ...] = BLURS_PX,
    iterations: int = ITERATIONS,
    sub_beams: int = SUB_BEAMS,
    sharpness: float = SHARPNESS,
    margin: tuple[int, int] | None = None,
    template: str = "semantic",
) -> YawEstimate:
    """Refine yaw, x and y of the object from `start` by Levenberg–Marquardt on 1 − NCC of the rendered template.

    `image` (range, beam) is the semantic image, or any grey one in which highlight is brighter than shadow; with a
    leading batch axis, `start` holds one pose a frame. A start whose fields have one more axis holds several
    hypotheses a frame, and the estimate keeps that axis. `mask`, of the image's shape, is true where a pixel was
    measured. `bounds` are the largest changes of yaw [rad], x and y [m]. `sharpness` is for images of labels, where a
    pixel is of one class or another; 0 fits a grey image, which mixes them. With a `margin` (bins, beams) only the box
    of the start's template and so much around it counts: for a grey image, whose floor is no even background, and a
    start that is good already. The `template` is the semantic image, or the `echo` for a frame as the device stored
    it: shadow, floor, each facet as bright as the elevation that its echo gathers makes it, and the object's bounce on
    the floor, whose strength is fitted too (`sharpness` plays no part then).

    Raises SonarjaxError when the shapes do not fit the sonar, or for an unknown template.
    """
    if template not in BESIDES:
        raise SonarjaxError(f"template: expected one of {', '.join(BESIDES)}, got {template!r}")
    image = jnp.asarray(image, jnp.float32)
    if image.ndim not in (2, 3) or image.shape[-2:] != sonar.shape:
        raise SonarjaxError(f"image: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    weight = jnp.ones(image.shape) if mask is None else jnp.asarray(mask, jnp.float32)
    if weight.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {weight.shape}")
    start = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), start)
    axes = jnp.broadcast_shapes(*(v.shape for v in jax.tree.leaves(start)))
    frames = image.ndim - 2
    if len(axes) not in (frames, frames + 1) or axes[:frames] != image.shape[:frames]:
        raise SonarjaxError(f"start: expected one pose (or one axis of poses) for each image, got shape {axes}")
    shape, beams = window_size(mesh, sonar, start, bounds)
    # One long list of frames and starts, so that every core has its share. On a CPU they go one by one: whatever their
    # number, they share compiled code.
    starts = jax.tree.map(lambda v: jnp.broadcast_to(v, axes).reshape(-1), start)
    count = math.prod(axes)
    which = jnp.arange(count) // max(count // max(math.prod(axes[:frames]), 1), 1)
    images, weights = (v.reshape(-1, *sonar.shape) for v in (image, weight))
    limits, sharp, sigmas = _limits(bounds, template), jnp.float32(sharpness), jnp.asarray(blurs, jnp.float32)

    def part(jobs: tuple[Any, Pose]) -> YawEstimate:
        of, begin = jobs
        return _refine(
            images[of], weights[of], mesh, sonar, begin, limits, sharp, sigmas,
            shape, beams, iterations, sub_beams, margin, template,
        )  # fmt: skip

    traced = is_traced(images, weights, mesh, sonar)
    found = part((which, starts)) if traced else on_all_cores(part, (which, starts), most=1)
    return jax.tree.map(lambda v: v.reshape(axes), found)


def window_size(mesh: Mesh, sonar: Sonar, start: Pose, bounds: tuple[float, ...]) -> tuple[tuple[int, int], int]:
    """Shape (range, beam) [pixels] of the window that `refine_yaw` looks at, and how many beams the object may touch.

    The window is large enough for the object and its shadow at each pose of `start` ([m] and [rad], of any shape),
    however it is turned, `SLACK_M` around it included. The object itself touches no more beams than the second number
    while x and y stay within `bounds`, the largest changes of yaw [rad], x and y [m]. Both are the whole frame's where
    tracing hides the places or the sonar.
    """
    if is_traced(start, sonar):
        return sonar.shape, sonar.n_beams
    ground = np.hypot(np.asarray(start.x), np.asarray(start.y))
    nearest = max(float(ground.min()) - max(bounds[1:]), 0.0)
    shapes = [window_shape(mesh, sonar, float(g), SLACK_M) for g in (ground.min(), ground.max())]
    rows, columns = max(s[0] for s in shapes), max(s[1] for s in shapes)
    # Coarse steps: compiling the solver for another window costs far more than a few empty pixels.
    shape = min(-(-rows // 128) * 128, sonar.n_ranges), min(-(-columns // 32) * 32, sonar.n_beams)
    return shape, min(-(-object_columns(mesh, sonar, nearest) // 16) * 16, sonar.n_beams)


def _limits(bounds: tuple[float, ...], template: str) -> Float[Array, "2 step"]:
    """Least and largest value of each number that is fitted: steps from the start, and what `BESIDES` names."""
    return jnp.array([*((-most, most) for most in bounds), *BESIDES[template]], jnp.float32).T


_STATIC = ("shape", "beams", "iterations", "sub_beams", "margin", "template")


@partial(quick_jit, options=SINGLE_CORE, static_argnames=_STATIC)
def _refine(
    images: Array, weights: Array, mesh: Mesh, sonar: Sonar, starts: Pose,
    bounds: Array, sharpness: Array, blurs: Array,
    shape: tuple[int, int], beams: int, iterations: int, sub_beams: int,
    margin: tuple[int, int] | None, template: str,
) -> YawEstimate:  # fmt: skip
    def one(job: tuple[Array, Array, Pose]) -> YawEstimate:
        image, weight, start = job
        window = place_window(shape, mesh, sonar, start.x, start.y, SLACK_M)
        corner = (window.row, window.column)
        part, measured = (jax.lax.dynamic_slice(v, corner, shape) for v in (image, weight))
        inner = Window(window.row, window.column, shape, beams)
        problem = Problem(part, measured, start, inner, sharpness)
        found = coarse_to_fine(problem, mesh, sonar, bounds, blurs, iterations, sub_beams, template, margin)
        return _estimate(problem._replace(weight=found.weight), found, bounds)

    # One after another on a CPU, where a batch would only spill the caches; side by side on an accelerator.
    side_by_side = None if jax.default_backend() == "cpu" else len(images)
    return jax.lax.map(one, (images, weights, starts), batch_size=side_by_side)


def _estimate(problem: Problem, found: Found, bounds: Array) -> YawEstimate:
    pose = pose_at(problem.start, found.step)
    score = crop_score(problem.image, found.template, problem.weight, (MARGIN_BINS, MARGIN_BEAMS))
    inside = (jnp.abs(found.step[:3]) < 0.98 * bounds[1, :3]).all()
    converged = inside & (jnp.abs(found.remaining[:3]).max() < CONVERGED_SHARE) & jnp.isfinite(score)
    return YawEstimate(pose.yaw % (2 * jnp.pi), pose.x, pose.y, _yaw_std(problem, found), score, converged)


def _yaw_std(problem: Problem, found: Found) -> Array:
    """Square root of the yaw entry of (JᵀJ)⁻¹·B·(JᵀJ)⁻¹, J of the image fitted by gain·template + offset.

    B sums the outer products of each beam's Jᵀr (White 1980, by clusters): residuals along a beam err together where
    an edge is a little off, so the plain σ²(JᵀJ)⁻¹ is far too small.
    """
    weight, drawn = problem.weight, found.template
    fitted, seen = normalised(drawn, weight), normalised(problem.image, weight)
    gain = (fitted * seen).sum()
    left = seen - gain * fitted
    centred = (drawn - (drawn * weight).sum() / jnp.maximum(weight.sum(), 1.0)) * weight
    scale = gain / jnp.sqrt((centred**2).sum() + 1e-9)
    slope = found.slope * weight * scale
    information = jnp.einsum("irb,jrb->ij", slope, slope)
    by_beam = jnp.einsum("irb,rb->ib", slope, left)
    ridge = 1e-6 * jnp.trace(information) + 1e-12
    inverse = jnp.linalg.inv(information + ridge * jnp.eye(len(information)))
    covariance = inverse @ (by_beam @ by_beam.T) @ inverse
    return jnp.sqrt(jnp.maximum(covariance[0, 0], 0.0))
