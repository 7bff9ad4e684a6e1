"""Banks by a few components: against eq. 4 itself, its bound, and NumPy's SVD."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.match import low_rank_bank, match_bank, match_low_rank, match_positions, scores_at
from sonarjax.match.spectra import unit_templates

SHAPE = (96, 40)


@pytest.fixture
def bank() -> np.ndarray:
    """48 templates (yaw, 24, 12): a bright bar that turns, a dark one behind it."""
    y, x = np.mgrid[-11.5:12.5, -5.5:6.5]
    templates = []
    for yaw in np.arange(48) * (2 * np.pi / 48):
        u, v = np.cos(yaw) * y + np.sin(yaw) * x, np.cos(yaw) * x - np.sin(yaw) * y
        bar = np.clip(2.5 - abs(v), 0, 1) * np.clip(8 - abs(u - 2), 0, 1)
        templates.append(0.5 + 0.5 * bar - 0.5 * np.roll(bar, 6, axis=0) * (1 - bar))
    return np.array(templates, np.float32)


@pytest.fixture
def frame(bank: np.ndarray) -> np.ndarray:
    """A noisy frame (range, beam) with template 7 at row 30, column 9."""
    image = np.full(SHAPE, 0.5, np.float32)
    image[30:54, 9:21] = bank[7]
    return image + np.random.default_rng(0).normal(0, 0.1, SHAPE).astype(np.float32)


@pytest.mark.parametrize("rank", [1, 4, 12, 30])
def test_error_is_within_the_residual_that_is_stated(bank: np.ndarray, frame: np.ndarray, rank: int) -> None:
    low_rank = low_rank_bank(bank, SHAPE, rank)
    exact, residual = np.asarray(match_bank(frame, bank)), np.asarray(low_rank.residual)
    error = abs(np.asarray(match_low_rank(frame, low_rank).scores) - exact)
    assert (error <= residual + 1e-4).all()
    assert error.max() > 1e-3 or rank == 30  # the bound is tried: a few components are not exact


def test_components_are_those_of_the_singular_value_decomposition(bank: np.ndarray) -> None:
    unit = np.asarray(unit_templates(jnp.asarray(bank)), float).reshape(len(bank), -1)
    left = np.linalg.svd(unit, compute_uv=False)[8:]
    residual = np.asarray(low_rank_bank(bank, SHAPE, 8).residual, float)
    assert np.sum(residual**2) == pytest.approx(np.sum(left**2), rel=0.02)


def test_all_components_are_exact(bank: np.ndarray, frame: np.ndarray) -> None:
    low_rank = low_rank_bank(bank, SHAPE, 48)
    found, exact = match_low_rank(frame, low_rank), match_positions(frame, bank)
    np.testing.assert_allclose(found.scores, exact.scores, atol=2e-4)
    assert (int(found.row[7]), int(found.col[7])) == (30, 9)


@pytest.mark.parametrize("rank", [2, 12])
def test_scores_at_the_places_found_are_exact_and_bound_the_largest(
    bank: np.ndarray, frame: np.ndarray, rank: int
) -> None:
    low_rank = low_rank_bank(bank, SHAPE, rank)
    found = match_low_rank(frame, low_rank)
    scores, largest = np.asarray(scores_at(frame, bank, found)), np.asarray(match_bank(frame, bank))
    maps = cv2_maps(frame, bank)
    there = maps[np.arange(len(bank)), np.asarray(found.row), np.asarray(found.col)]
    np.testing.assert_allclose(scores, there, atol=2e-4)
    assert (scores <= largest + 2e-4).all()
    assert (largest <= np.asarray(found.scores + low_rank.residual) + 2e-4).all()


def cv2_maps(frame: np.ndarray, bank: np.ndarray) -> np.ndarray:
    """Eq. 4 by OpenCV at all positions (template, row, column)."""
    cv2 = pytest.importorskip("cv2")
    return np.stack([cv2.matchTemplate(frame, template, cv2.TM_CCOEFF_NORMED) for template in bank])


def test_constant_templates_score_nothing(frame: np.ndarray) -> None:
    low_rank = low_rank_bank(np.full((3, 8, 8), 0.5, np.float32), SHAPE, 2)
    np.testing.assert_allclose(match_low_rank(frame, low_rank).scores, 0, atol=1e-5)


def test_bad_input_is_named(bank: np.ndarray, semantic_image: Callable[..., np.ndarray]) -> None:
    with pytest.raises(SonarjaxError, match="rank: expected 1 or more"):
        low_rank_bank(bank, SHAPE, 0)
    with pytest.raises(SonarjaxError, match="larger than the image"):
        low_rank_bank(bank, (20, 40), 4)
    with pytest.raises(SonarjaxError, match="larger than the image"):
        match_low_rank(semantic_image(0)[:20], low_rank_bank(bank, SHAPE, 4))
    places = match_low_rank(np.zeros(SHAPE), low_rank_bank(bank, SHAPE, 4))
    with pytest.raises(SonarjaxError, match="places: expected one for each of 5 templates"):
        scores_at(np.zeros(SHAPE), bank[:5], places)
    with pytest.raises(SonarjaxError, match="image: holds NaN or infinite"):
        match_low_rank(np.full(SHAPE, np.nan), low_rank_bank(bank, SHAPE, 4))
    with pytest.raises(SonarjaxError, match="image: holds NaN or infinite"):
        scores_at(np.full(SHAPE, np.inf), bank, places)
