"""Block elimination against the dense solution; covariance against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from sonarjax.calibrate.covariance import certainty, error_covariance, overcounted
from sonarjax.calibrate.linearise import OWN, Blocks
from sonarjax.calibrate.look import LOOK, LOOK_STD
from sonarjax.calibrate.solver import BOUNCE, BOUNCE_STD, LOOKS, Point, make_prior, solve_jointly
from sonarjax.io.errors import SonarjaxError

FREE, STD = ("tilt", "height"), np.array([0.05, 0.1])
SHARED = len(FREE) + LOOKS
FRAMES = 5


@pytest.fixture(scope="module")
def linear():
    """Jacobians (frame, residual, number) and residuals (frame, residual) at zero of a linear problem."""
    rng = np.random.default_rng(1)
    return rng.normal(size=(FRAMES, 60, OWN + SHARED)), 0.02 * rng.normal(size=(FRAMES, 60))


def evaluate(linear):
    jacobians, constants = linear

    def at(point: Point) -> list[Blocks]:
        found = []
        for jacobian, constant, own in zip(jacobians, constants, point.own, strict=True):
            residual = constant + jacobian @ np.concatenate([own, point.shared - np.concatenate([[0, 0], LOOK])])
            found.append(
                Blocks(jacobian.T @ jacobian, jacobian.T @ residual, (residual**2).sum() / 2, residual[:3] ** 2)
            )
        return found

    return at


def test_rows_that_few_frames_measured_are_not_taken_for_exact(linear) -> None:
    one = evaluate(linear)(begin())[0]
    squares = np.array([[0.04, 0.04, 0.0], [0.04, 0.0, 0.0], [0.04, 0.0, 0.0]])  # row 1 in one frame, row 2 in none
    blocks = [one._replace(square=square) for square in squares]
    start = Point(begin().shared, begin().own[:3])
    fit = solve_jointly(lambda at: blocks, start, make_prior(FREE, STD), iterations=0)
    np.testing.assert_allclose(fit.spread, [0.2, 0.2, 0.0])


def begin() -> Point:
    return Point(np.concatenate([[0, 0], LOOK]), np.tile([0, 0, 0, BOUNCE], (FRAMES, 1)))


def dense(linear, fixed: list[int]) -> np.ndarray:
    """The minimum over all numbers at once: shared, then each frame's own."""
    jacobians, constants = linear
    rows, right = [], []
    for k in range(FRAMES):
        block = np.zeros((60, SHARED + OWN * FRAMES))
        block[:, :SHARED], block[:, SHARED + OWN * k : SHARED + OWN * (k + 1)] = (
            jacobians[k][:, OWN:],
            jacobians[k][:, :OWN],
        )
        rows.append(block)
        right.append(-constants[k])
        bounce = np.zeros(SHARED + OWN * FRAMES)
        bounce[SHARED + OWN * k + OWN - 1] = 1 / BOUNCE_STD
        rows.append(bounce[None])
        right.append(np.array([BOUNCE / BOUNCE_STD]))
    rows.append(np.diag(1 / np.concatenate([STD, LOOK_STD, np.full(OWN * FRAMES, np.inf)])))
    right.append(np.zeros(SHARED + OWN * FRAMES))
    system = np.concatenate(rows)
    free = np.delete(np.arange(system.shape[1]), fixed)
    found = np.zeros(system.shape[1])
    found[free] = np.linalg.lstsq(system[:, free], np.concatenate(right), rcond=None)[0]
    return found


@pytest.mark.parametrize("fixed", [(), ("height",)])
def test_blocks_give_the_dense_solution(linear, fixed) -> None:
    fit = solve_jointly(evaluate(linear), begin(), make_prior(FREE, STD, fixed), iterations=60)
    wanted = dense(linear, [FREE.index(name) for name in fixed])
    assert fit.converged
    np.testing.assert_allclose(fit.point.shared - np.concatenate([[0, 0], LOOK]), wanted[:SHARED], atol=2e-4)
    np.testing.assert_allclose(fit.point.own.reshape(-1), wanted[SHARED:], atol=2e-4)


def without_numbers(evaluate, where):
    """As `evaluate`, but without finite derivatives of the last frame at points for which `where` is true."""

    def at(point: Point) -> list[Blocks]:
        *others, last = evaluate(point)
        return [*others, last._replace(hessian=last.hessian * (np.nan if where(point) else 1.0))]

    return at


def test_a_step_to_where_nothing_is_finite_is_taken_back(linear) -> None:
    usual = solve_jointly(evaluate(linear), begin(), make_prior(FREE, STD), iterations=60)
    reached = usual.point.shared[0]
    beyond = without_numbers(evaluate(linear), lambda point: abs(point.shared[0]) > 0.5 * abs(reached))
    fit = solve_jointly(beyond, begin(), make_prior(FREE, STD), iterations=60)
    assert np.isfinite(fit.information).all() and 0 < abs(fit.point.shared[0]) <= 0.5 * abs(reached)


def test_a_frame_without_numbers_at_the_start_is_one_line(linear) -> None:
    with pytest.raises(SonarjaxError, match=f"^calibrate: frame {FRAMES - 1} of those fitted has no finite"):
        solve_jointly(without_numbers(evaluate(linear), lambda _: True), begin(), make_prior(FREE, STD), iterations=3)


def test_a_curved_valley_is_followed_to_its_end() -> None:
    """Rosenbrock's function (Computer J. 3, 1960) of the free numbers, in units of trust from (−3, 9) to (1, 1)."""
    prior = make_prior(FREE, np.array([10.0, 10.0]))
    slopes = np.zeros((2, OWN + SHARED))

    def at(point: Point) -> list[Blocks]:
        x, y = point.shared[:2] / prior.trust[:2]
        residual = 30 * np.array([10 * (y - x**2), 1 - x])
        slopes[:, OWN : OWN + 2] = 30 * np.array([[-20 * x, 10.0], [-1.0, 0.0]]) / prior.trust[:2]
        return [Blocks(slopes.T @ slopes, slopes.T @ residual, (residual**2).sum() / 2, residual**2)]

    away = Point(begin().shared + [*(prior.trust[:2] * [-3.0, 9.0]), *[0] * LOOKS], begin().own[:1])
    fit = solve_jointly(at, away, prior, iterations=40)
    assert fit.converged
    np.testing.assert_allclose(fit.point.shared[:2] / prior.trust[:2], 1.0, atol=0.02)


def test_information_is_the_schur_complement(linear) -> None:
    """The shared block of the inverse of all frames' normal equations, inverted again."""
    fit = solve_jointly(evaluate(linear), begin(), make_prior(FREE, STD), iterations=3)
    whole = np.zeros((SHARED + OWN * FRAMES,) * 2)
    for k, jacobian in enumerate(linear[0]):
        where = np.concatenate([SHARED + OWN * k + np.arange(OWN), np.arange(SHARED)])
        whole[np.ix_(where, where)] += jacobian.T @ jacobian
        whole[SHARED + OWN * k + OWN - 1, SHARED + OWN * k + OWN - 1] += 1 / BOUNCE_STD**2
    np.testing.assert_allclose(
        np.linalg.inv(np.linalg.inv(whole)[:SHARED, :SHARED]), fit.information, rtol=1e-5, atol=1e-5
    )


def agreeing(information: np.ndarray) -> np.ndarray:
    """Scores (frame, shared) of frames that differ as much as the `information` says."""
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    frames = 2 * SHARED
    return np.concatenate([root, -root]) * np.sqrt((frames - 1) / (2 * frames))


def test_covariance_of_independent_numbers() -> None:
    information = np.diag([4 / STD[0] ** 2, 0.01 / STD[1] ** 2, *np.ones(LOOKS)])
    known = certainty(information, agreeing(information), STD, FREE)
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)) / STD, [5**-0.5, 1.01**-0.5])
    np.testing.assert_allclose(known.bound / STD, [5**-0.5, 1.01**-0.5])
    assert known.determined == {"tilt": True, "height": False}
    np.testing.assert_allclose(known.singular_values, [2.0, 0.1])
    assert abs(known.weakest["height"]) == pytest.approx(1.0)


def test_numbers_that_only_a_sum_determines_are_not_determined() -> None:
    along = np.array([1 / STD[0], 1 / STD[1]])
    information = np.zeros((SHARED, SHARED))
    information[:2, :2] = 1e4 * np.outer(along, along)
    known = certainty(information, agreeing(information), STD, FREE)
    assert known.determined == {"tilt": False, "height": False}
    assert known.weakest["tilt"] == pytest.approx(-known.weakest["height"], rel=1e-6)


def test_errors_that_all_frames_share_widen_what_the_frames_say_and_not_the_prior() -> None:
    information = np.diag([1e6 / STD[0] ** 2, 1e-6 / STD[1] ** 2, *np.ones(LOOKS)])
    known, wider = (certainty(information, agreeing(information), STD, FREE, factor) for factor in (1.0, 2.0))
    ratio = np.sqrt(np.diag(wider.covariance) / np.diag(known.covariance))
    np.testing.assert_allclose(ratio, [2.0, 1.0], rtol=1e-4)
    np.testing.assert_allclose(wider.bound, known.bound)


def test_a_number_that_was_put_back_has_the_error_of_its_prior_and_passes_it_on() -> None:
    """A linear model: 4000 times, the tilt and the look are fitted with the height at its nominal value."""
    rng = np.random.default_rng(4)
    slope = rng.normal(size=(60, SHARED)) / np.concatenate([STD, np.ones(LOOKS)])
    slope[:, 0] += 0.7 * STD[1] / STD[0] * slope[:, 1]
    truth = rng.normal(size=(4000, SHARED)) * np.concatenate([STD, LOOK_STD])
    noise = 5.0 * rng.normal(size=(4000, 60))
    information, fitted = slope.T @ slope / 25, np.arange(SHARED) != 1
    inside = (information + np.diag(1 / np.concatenate([STD, LOOK_STD]) ** 2))[np.ix_(fitted, fitted)]
    seen = (truth @ slope.T + noise) @ slope[:, fitted] / 25
    errors = np.stack([np.linalg.solve(inside, seen.T)[0] - truth[:, 0], -truth[:, 1]])
    scores = agreeing(information)
    said = error_covariance(information, scores, STD, put_back=np.array([False, True]))
    np.testing.assert_allclose(said / np.outer(STD, STD), np.cov(errors) / np.outer(STD, STD), atol=0.03)
    # Errors that all frames share widen what the frames say, not what is passed on.
    wider = error_covariance(information, scores, STD, 2.0, np.array([False, True]))
    np.testing.assert_allclose(wider[1], said[1])
    own = np.linalg.inv(inside) @ information[np.ix_(fitted, fitted)] @ np.linalg.inv(inside)
    assert wider[0, 0] - said[0, 0] == pytest.approx(3 * own[0, 0])


def test_one_frame_does_not_disagree_and_is_not_the_surer_for_it() -> None:
    information = np.diag([4 / STD[0] ** 2, 9 / STD[1] ** 2, *np.ones(LOOKS)])
    known = certainty(information, np.ones((1, SHARED)), STD, FREE)
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)), known.bound)


def test_frames_that_disagree_widen_the_covariance() -> None:
    """With many frames and a wide prior, the covariance is that of each frame's own estimate over their number."""
    rng = np.random.default_rng(3)
    frames, information = 5000, np.diag([2.0, 5.0, *np.ones(LOOKS)])
    own = rng.normal(size=(frames, SHARED)) * np.array([3.0, 0.5, *np.ones(LOOKS)])
    known = certainty(frames * information, own @ information, np.array([1e3, 1e3]), FREE)
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance) * frames), [3.0, 0.5], rtol=0.05)
    np.testing.assert_allclose(known.bound * np.sqrt(frames), [2**-0.5, 5**-0.5], rtol=1e-3)  # whatever they disagree


def test_pixels_that_err_together_are_counted_once() -> None:
    """Each frame's residuals repeated nine times: nine times the information, 81 times the scores' squares."""
    rng = np.random.default_rng(2)
    scores = rng.normal(size=(4000, SHARED)) * 3
    information = 4000 * np.eye(SHARED) * 9
    assert overcounted(information, scores, STD) == pytest.approx(1.0, abs=0.05)
    assert overcounted(9 * information, 9 * scores, STD) == pytest.approx(9.0, rel=0.05)
