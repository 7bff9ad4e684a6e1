"""Covariance and observability against what linear least squares does, and against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.refine.uncertainty import FINEST, Normal, error_covariance, observability, prior_std

PRIOR = np.array([0.4, 0.1, 0.2])
KNOWN = jnp.asarray(True)


def normal(information, noise):
    return Normal(jnp.asarray(information, jnp.float32), jnp.asarray(noise, jnp.float32))


def test_errors_of_a_held_number_are_passed_on():
    """A linear model of 200 pixels with white noise: the estimate is computed 4000 times with one number held."""
    rng = np.random.default_rng(0)
    slope = rng.normal(size=(200, 3))
    slope[:, 1] += 0.8 * slope[:, 0]
    sigma, held = 0.3, np.array([False, True, False])
    errors = []
    for _ in range(4000):
        wrong = rng.normal() * PRIOR[1]  # by which the held number is off
        seen = slope[:, 1] * -wrong + sigma * rng.normal(size=200)
        fitted, *_ = np.linalg.lstsq(slope[:, ~held], seen, rcond=None)
        errors.append([fitted[0], wrong, fitted[1]])
    measured = np.cov(np.array(errors).T)
    information = slope.T @ slope
    said = error_covariance(normal(information, sigma**2 * information), jnp.asarray(PRIOR), jnp.asarray(held), KNOWN)
    np.testing.assert_allclose(said, measured, atol=0.06 * np.abs(measured).max())
    free = error_covariance(normal(information, sigma**2 * information), jnp.asarray(PRIOR), jnp.zeros(3, bool), KNOWN)
    np.testing.assert_allclose(free, sigma**2 * np.linalg.inv(information), rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("weak", [1.0, 1e-2, 1e-4, 1e-6])
def test_the_less_is_said_about_a_number_the_less_it_is_known(weak):
    """Whatever is said about another number in another unit: yaw by `weak`, x by 2000 per square metre."""
    information = np.diag([weak, 2e3, 2e3])
    found = error_covariance(normal(information, 1e-3 * information), jnp.asarray(PRIOR), jnp.zeros(3, bool), KNOWN)
    np.testing.assert_allclose(found, 1e-3 * np.linalg.inv(information), rtol=1e-3)


def test_observability_is_what_is_left_of_the_prior():
    """Independent numbers told with standard deviations of 1, 0.55 and 0.1 of their priors: left are s/√(1 + s²)."""
    share = np.array([1.0, 0.55, 0.1])
    information = np.diag(1 / (share * PRIOR) ** 2)
    found = observability(normal(information, information), jnp.asarray(PRIOR), KNOWN, 3)
    np.testing.assert_array_equal(found.observable, share / np.sqrt(1 + share**2) <= 0.5)
    np.testing.assert_array_equal(found.observable, [False, True, True])
    np.testing.assert_allclose(found.singular_values, np.sort(1 / share)[::-1], rtol=2e-2)
    # Residuals that err together four times over say a quarter of it.
    less = observability(normal(information, 4 * information), jnp.asarray(PRIOR), KNOWN, 3)
    np.testing.assert_allclose(less.singular_values, np.sort(0.5 / share)[::-1], rtol=2e-2)


def test_a_frame_without_noise_is_not_believed_beyond_what_templates_are_good_for():
    information = np.diag([1e-4, 1.0, 1.0]) / PRIOR**2
    found = observability(normal(information, np.zeros((3, 3))), jnp.asarray(PRIOR), KNOWN, 3)
    assert float(found.singular_values[0]) <= FINEST
    assert float(found.singular_values[-1]) == pytest.approx(0.01 * float(found.singular_values[0]), rel=1e-2)


def test_where_nothing_is_known():
    information = np.diag([0.0, 1.0, 1.0])
    nothing = jnp.asarray(False)
    covariance = error_covariance(normal(information, information), jnp.asarray(PRIOR), jnp.zeros(3, bool), nothing)
    assert np.isinf(np.diag(np.asarray(covariance))).all() and not np.isnan(np.asarray(covariance)).any()
    found = observability(normal(information, information), jnp.asarray(PRIOR), nothing, 2)
    assert not np.asarray(found.observable).any() and (np.asarray(found.singular_values) == 0).all()


def test_the_prior_of_bounds_is_uniform():
    draws = np.random.default_rng(1).uniform([-0.3, 0.0], [0.3, 1.0], (100_000, 2))
    bounds = jnp.array([[-0.3, 0.0], [0.3, 1.0]])
    np.testing.assert_allclose(prior_std(bounds), draws.std(axis=0), rtol=1e-2)
