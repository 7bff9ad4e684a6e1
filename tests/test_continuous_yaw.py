"""What the experiments on continuous yaw compute themselves: errors, calibration, the loss, symmetric objects."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments import continuous_yaw, symmetric_objects, yaw_basin, yaw_landscape
from sonarjax.io import SonarjaxError
from sonarjax.refine.free import ON_FLOOR, trusts
from sonarjax.refine.objective import make_blur
from sonarjax.refine.solver import _linear_step

# ---------------------------------------------------------------- errors and error bars


def test_signed_errors_go_the_short_way_round():
    found, true = np.radians([1.0, 359.0, 180.0]), np.radians([359.0, 1.0, 170.0])
    np.testing.assert_allclose(continuous_yaw.signed_error_deg(found, true), [2.0, -2.0, 10.0])


def test_the_offset_from_the_grid_is_what_the_floor_is_made_of():
    offsets = [continuous_yaw.grid_offset_deg(math.radians(yaw)) for yaw in (0.0, 12.0, 358.0, 344.0)]
    np.testing.assert_allclose(offsets, [0.0, 2.0, -2.0, 4.0], atol=1e-9)
    drawn = np.radians(np.random.default_rng(0).uniform(0, 360, 20_000))
    errors = np.abs([continuous_yaw.grid_offset_deg(yaw) for yaw in drawn])
    np.testing.assert_allclose(errors.mean(), continuous_yaw.FLOOR["mean"], rtol=0.02)
    np.testing.assert_allclose(np.sqrt((errors**2).mean()), continuous_yaw.FLOOR["rms"], rtol=0.02)


def test_calibration_of_normal_errors_is_that_of_a_normal_variate(rng):
    std = rng.uniform(0.2, 1.0, 20_000)
    row = continuous_yaw.calibration("x", std * rng.normal(size=std.size), std)
    for key, value in continuous_yaw.NORMAL.items():
        assert row[key] == pytest.approx(value, abs=0.02), key


def test_calibration_leaves_out_what_went_astray_but_says_so():
    row = continuous_yaw.calibration("x", np.array([0.5, -0.5, 90.0]), np.ones(3))
    assert row["within_1_std"] == 1.0
    assert row["within_2_std_all"] == pytest.approx(2 / 3)
    assert continuous_yaw.calibration("x", np.array([90.0]), np.ones(1))["median_z"] is None


@pytest.mark.parametrize("wrong", [{"step_deg": 15}, {"step_deg": 0}, {"timed": ("truth",)}])
def test_settings_that_cannot_be_measured_are_refused(wrong):
    with pytest.raises(SonarjaxError, match=next(iter(wrong))):
        continuous_yaw.Settings(**wrong)


def test_shares_within_a_degree_and_two():
    assert yaw_basin.shares(np.array([0.5, 1.5, 3.0, 1.0])) == {"within_1": 0.5, "within_2": 0.75, "median": 1.25}


# ---------------------------------------------------------------- the loss


def test_the_loss_is_the_one_that_the_solver_minimises(rng):
    shape, trust = (24, 10), jnp.asarray(trusts(ON_FLOOR))
    image, drawn = (jnp.asarray(rng.uniform(size=shape), jnp.float32) for _ in range(2))
    slope = jnp.asarray(0.1 * rng.normal(size=(len(trust), *shape)), jnp.float32)
    blur = make_blur(shape, 1.5)
    _, cost = jax.jit(lambda *images: _linear_step(image, jnp.ones(shape), blur, *images, trust))(
        drawn, slope
    )  # compiled: kept on disk
    assert float(yaw_landscape.loss(image, blur, drawn)) == pytest.approx(float(cost), rel=1e-4)
    assert float(yaw_landscape.loss(image, blur, image)) == pytest.approx(0.0, abs=1e-5)


def test_central_differences_of_a_parabola_are_its_derivative():
    settings = yaw_landscape.Settings(line_deg=1.0)
    line = np.radians(yaw_landscape.line_deg(settings))
    assert np.degrees(line[[1, -2]]) == pytest.approx([-1.0, 1.0])  # one point beside what is reported
    np.testing.assert_allclose(yaw_landscape.central(3 * line[:, None] ** 2), 6 * line[1:-1, None], atol=1e-12)


def test_derivatives_are_judged_blur_by_blur(rng):
    truth = rng.normal(size=(2, 9, len(yaw_landscape.CONFIG.blurs)))
    ours = truth * np.array([1.0, 1.1, -1.0])
    rows = yaw_landscape.summary_of(ours, truth, ours)
    assert [row["error"] for row in rows] == pytest.approx([0.0, 0.1, 2.0])
    assert [row["sign"] for row in rows] == [1.0, 1.0, 0.0]
    assert [row["own_error"] for row in rows] == [0.0, 0.0, 0.0]


# ---------------------------------------------------------------- symmetric objects


@pytest.mark.parametrize("name", symmetric_objects.OBJECTS)
def test_objects_look_the_same_after_their_period(name):
    mesh, period = symmetric_objects.OBJECTS[name].make(), symmetric_objects.OBJECTS[name].period_deg
    corners = np.unique(np.asarray(mesh.vertices).round(5), axis=0)

    def turned(degrees: float) -> np.ndarray:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def apart(other: np.ndarray) -> float:
        return float(np.linalg.norm(corners[:, None] - other[None], axis=2).min(axis=1).max())

    assert mesh.closed
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-6)  # it stands on the floor
    assert apart(turned(period)) < 1e-4
    assert apart(turned(period / 2)) > 0.01  # and after no less


def test_hypotheses_are_judged_modulo_the_period():
    yaw = np.array([[10.0, 191.0], [12.5, np.nan], [190.0, 13.0], [10.0, np.nan]])
    score = np.array([[0.9, 0.8], [0.9, np.nan], [0.9, 0.9], [0.9, np.nan]])
    row = symmetric_objects.judge(yaw, score, np.full(4, 10.0), 180.0, 2.0)
    assert row["two"] == 0.5
    assert row["two_within"] == 0.25  # the third frame's second yaw is 3° off
    assert row["all_within"] == 0.5
    assert row["best_median"] == pytest.approx(0.0, abs=1e-6)
    assert row["gap_deg"] == pytest.approx((179.0 + 177.0) / 2)
    assert row["score_gap"] == pytest.approx(0.05)
