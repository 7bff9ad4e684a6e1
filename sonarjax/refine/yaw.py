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

from sonarjax.io.errors import SonarjaxError
from sonarjax.refine.objective import Problem, crop_score, moved, normalised, residuals, template
from sonarjax.refine.solver import coarse_to_fine
from sonarjax.render import place_window, window_shape
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

BOUNDS = (math.radians(40.0), 0.15, 0.15)
"""Largest change of yaw [rad], x [m] and y [m] from the start."""
BLURS_PX = (8.0, 2.0)
"""Standard deviations of the blur in range bins, coarse to fine: the coarse ones widen the basin."""
ITERATIONS = 5
SUB_BEAMS = 1
SLACK_M = 0.06
CONVERGED_STEP = 2e-3


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
    """Standard deviation of yaw [rad] from the curvature, given that the basin is the right one.

    Pixel errors are taken as independent and equal; on real, speckled frames it is too small. Not calibrated.
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
) -> YawEstimate:
    """Refine yaw, x and y of the object from `start` by Levenberg–Marquardt on 1 − NCC of the rendered template.

    `image` (range, beam) is the semantic image, or any grey one in which highlight is brighter than shadow; with a
    leading batch axis, `start` holds one pose a frame. A start whose fields have one more axis holds several
    hypotheses a frame, and the estimate keeps that axis. `mask`, of the image's shape, is true where a pixel was
    measured. `bounds` are the largest changes of yaw [rad], x and y [m].

    Raises SonarjaxError when the shapes do not fit the sonar.
    """
    image = jnp.asarray(image, jnp.float32)
    if image.ndim not in (2, 3) or image.shape[-2:] != sonar.shape:
        raise SonarjaxError(f"image: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    weight = jnp.ones(image.shape) if mask is None else jnp.asarray(mask, jnp.float32)
    if weight.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {weight.shape}")
    shape = _window_size(mesh, sonar, start)
    start = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), start)
    axes = jnp.broadcast_shapes(*(v.shape for v in jax.tree.leaves(start)))
    start = jax.tree.map(lambda v: jnp.broadcast_to(v, axes), start)
    frames = image.ndim - 2
    if len(axes) not in (frames, frames + 1) or axes[:frames] != image.shape[:frames]:
        raise SonarjaxError(f"start: expected one pose (or one axis of poses) for each image, got shape {axes}")
    settings = (jnp.asarray(bounds, jnp.float32), jnp.asarray(blurs, jnp.float32))
    return _refine(image, weight, mesh, sonar, start, settings, shape, iterations, sub_beams)


def _window_size(mesh: Mesh, sonar: Sonar, start: Pose) -> tuple[int, int]:
    """The window that holds every start; the whole frame where the start is not known before compilation."""
    if any(isinstance(v, jax.core.Tracer) for v in jax.tree.leaves((start, sonar))):
        return sonar.shape
    ground = np.hypot(np.asarray(start.x), np.asarray(start.y))
    shapes = [window_shape(mesh, sonar, float(g), SLACK_M) for g in (ground.min(), ground.max())]
    rows, columns = max(s[0] for s in shapes), max(s[1] for s in shapes)
    # Coarse steps: compiling the solver for another window costs far more than a few empty pixels.
    return min(-(-rows // 128) * 128, sonar.n_ranges), min(-(-columns // 16) * 16, sonar.n_beams)


@partial(jax.jit, static_argnames=("shape", "iterations", "sub_beams"))
def _refine(
    image: Array, weight: Array, mesh: Mesh, sonar: Sonar, start: Pose, settings: tuple[Array, Array],
    shape: tuple[int, int], iterations: int, sub_beams: int,
) -> YawEstimate:  # fmt: skip
    def one(frame: Array, measured: Array, pose: Pose) -> YawEstimate:
        return _refine_one(frame, measured, mesh, sonar, pose, settings, shape, iterations, sub_beams)

    def hypotheses(frame: Array, measured: Array, poses: Pose) -> YawEstimate:
        if poses.yaw.ndim == 0:
            return one(frame, measured, poses)
        return jax.vmap(lambda pose: one(frame, measured, pose))(poses)

    if image.ndim == 2:
        return hypotheses(image, weight, start)
    # One after another on a CPU, where a batch would only spill the caches; side by side on an accelerator.
    side_by_side = 1 if jax.default_backend() == "cpu" else len(image)
    return jax.lax.map(lambda args: hypotheses(*args), (image, weight, start), batch_size=side_by_side)


def _refine_one(
    image: Array, weight: Array, mesh: Mesh, sonar: Sonar, start: Pose, settings: tuple[Array, Array],
    shape: tuple[int, int], iterations: int, sub_beams: int,
) -> YawEstimate:  # fmt: skip
    bounds, blurs = settings
    window = place_window(shape, mesh, sonar, start.x, start.y, SLACK_M)
    corner = (window.row, window.column)
    part, measured = (jax.lax.dynamic_slice(v, corner, shape) for v in (image, weight))
    problem = Problem(part, measured, mesh, sonar, start, jnp.asarray(corner[0]), jnp.asarray(corner[1]))

    def difference(step: Array, problem: Problem, bounds: Array, blur: Array) -> Array:
        return residuals(step, problem, bounds, blur, sub_beams)

    step, last = coarse_to_fine(difference, jnp.zeros(3), blurs, iterations, problem, bounds)
    pose = moved(start, step, bounds)
    drawn = template(problem, pose, sub_beams)
    score = crop_score(part, drawn, measured, (MARGIN_BINS, MARGIN_BEAMS))
    inside = (jnp.abs(jnp.tanh(step)) < 0.98).all()
    std = _yaw_std(problem, pose, drawn, sub_beams)
    converged = inside & (last < CONVERGED_STEP) & jnp.isfinite(score)
    return YawEstimate(pose.yaw % (2 * jnp.pi), pose.x, pose.y, std, score, converged)


def _yaw_std(problem: Problem, pose: Pose, drawn: Array, sub_beams: int) -> Array:
    """Square root of the yaw entry of σ²(JᵀJ)⁻¹, J and σ of the unblurred image fitted by gain·template + offset."""

    def draw(values: Array) -> Array:
        moved_pose = Pose(values[1], values[2], values[0], pose.z, pose.roll, pose.pitch)
        return template(problem, moved_pose, sub_beams).reshape(-1)

    weight = problem.weight.reshape(-1)
    jacobian = jax.jacfwd(draw)(jnp.stack([pose.yaw, pose.x, pose.y])) * weight[:, None]
    fitted, seen = normalised(drawn, problem.weight), normalised(problem.image, problem.weight)
    gain = (fitted * seen).sum()
    left = ((seen - gain * fitted) ** 2).sum() / jnp.maximum(weight.sum() - 5, 1.0)
    scale = gain / jnp.sqrt(((drawn - drawn.mean()) ** 2 * problem.weight).sum() + 1e-9)
    information = (jacobian.T @ jacobian) * scale**2
    ridge = 1e-6 * jnp.trace(information) + 1e-12
    covariance = jnp.linalg.inv(information + ridge * jnp.eye(3)) * left
    return jnp.sqrt(jnp.maximum(covariance[0, 0], 0.0))
