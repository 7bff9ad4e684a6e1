"""Optimistix as an oracle: its Levenberg–Marquardt, on the same residuals, ends where our solvers end."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate.linearise import OWN, Blocks
from sonarjax.calibrate.look import LOOK, LOOK_STD
from sonarjax.calibrate.solver import BOUNCE, BOUNCE_STD, LOOKS, Point, make_prior, solve_jointly
from sonarjax.refine.free import ON_FLOOR, trusts
from sonarjax.refine.objective import Problem, compare, make_blur
from sonarjax.refine.template import VIEWS, Subject, draw, nominal_law
from sonarjax.render import place_window

optimistix = pytest.importorskip("optimistix")

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
TRUTH = sj.Pose(2.31, 0.04, 0.7)


@pytest.mark.slow  # compiles the renderer three times
def test_refined_pose_is_optimistixs() -> None:
    mesh, config = sj.objects.target(), sj.RefineConfig(sharpness=0.0)
    image = sj.render(mesh, TRUTH, SONAR).semantic()
    start = sj.Pose(2.30, 0.05, 0.7 + math.radians(2.0))
    size = sj.plan_refinement(mesh, SONAR, start, config)
    ours = sj.refine_yaw(image, mesh, SONAR, start, config=config, window=size)
    assert bool(ours.determined)
    window = place_window(size, mesh, SONAR, start.x, start.y, 0.06)
    part = jax.lax.dynamic_slice(image, (window.row, window.column), size.shape)
    semantic = jnp.int32(VIEWS["semantic"])
    subject = Subject(mesh, SONAR, start, window, jnp.float32(0.0), semantic, nominal_law(), config.quality, ON_FLOOR)
    problem = Problem(part, jnp.ones(size.shape), subject, jnp.full(2, 1 << 20))
    blur, trust = make_blur(size.shape, config.blurs[-1]), jnp.asarray(trusts(ON_FLOOR))[:3]

    def residuals(scaled: jax.Array, _: None) -> jax.Array:
        step = jnp.append(scaled * trust, 0.0)
        return compare(problem.image, draw(subject, step), problem.weight, blur)

    solver = optimistix.LevenbergMarquardt(rtol=1e-5, atol=1e-5)
    found = optimistix.least_squares(residuals, solver, jnp.zeros(3), options={"jac": "fwd"}, max_steps=60, throw=False)
    yaw, x, y = np.asarray(found.value * trust) + np.array([start.yaw, start.x, start.y])
    print(f"\nyaw {math.degrees(float(ours.yaw) - yaw):.4f}°, x {1e3 * float(ours.x - x):.3f} mm apart")
    assert math.degrees(abs(float(ours.yaw) - yaw)) < 0.02
    assert max(abs(float(ours.x) - x), abs(float(ours.y) - y)) < 2e-4


def test_joint_solution_is_optimistixs() -> None:
    """Frames that share numbers: eliminating each frame's own ones ends at the minimum over all numbers at once."""
    rng = np.random.default_rng(4)
    free, std, frames = ("tilt", "height"), np.array([0.05, 0.1]), 4
    shared = len(free) + LOOKS
    slopes, constants = rng.normal(size=(frames, 80, OWN + shared)), 0.05 * rng.normal(size=(frames, 80))
    begin = np.concatenate([[0, 0], LOOK])

    def bent(numbers, k):
        """Residuals of a frame, not linear in its numbers: own ones first, shared ones as moved from `begin`."""
        straight = constants[k] + slopes[k] @ numbers
        return straight + 0.3 * straight**2

    def evaluate(point: Point) -> list[Blocks]:
        found = []
        for k, own in enumerate(point.own):
            numbers = np.concatenate([own, point.shared - begin])
            residual = bent(numbers, k)
            jacobian = (1 + 0.6 * (constants[k] + slopes[k] @ numbers))[:, None] * slopes[k]
            found.append(
                Blocks(jacobian.T @ jacobian, jacobian.T @ residual, (residual**2).sum() / 2, residual[:3] ** 2)
            )
        return found

    at = Point(begin, np.tile([0.0, 0.0, 0.0, BOUNCE], (frames, 1)))
    fit = solve_jointly(evaluate, at, make_prior(free, std), iterations=100)

    def everything(numbers: jax.Array, _: None) -> jax.Array:
        moved, own = numbers[:shared], numbers[shared:].reshape(frames, OWN)
        parts = [bent(jnp.concatenate([own[k], moved]), k) for k in range(frames)]
        prior = [moved / np.concatenate([std, LOOK_STD]), (own[:, OWN - 1] - BOUNCE) / BOUNCE_STD]
        return jnp.concatenate([*parts, *prior])

    first = jnp.concatenate([jnp.zeros(shared), jnp.asarray(at.own, jnp.float32).reshape(-1)])
    solver = optimistix.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
    found = np.asarray(optimistix.least_squares(everything, solver, first, max_steps=200, throw=False).value)
    assert fit.converged
    np.testing.assert_allclose(fit.point.shared - begin, found[:shared], atol=1e-3)
    np.testing.assert_allclose(fit.point.own.reshape(-1), found[shared:], atol=1e-3)
