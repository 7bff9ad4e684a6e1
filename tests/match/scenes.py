"""Images and reference matchers for these tests, written without the package."""

from __future__ import annotations

import numpy as np


def semantic_image(seed: int, shape: tuple[int, int] = (160, 64)) -> np.ndarray:
    """Background 0.5 with rectangles of highlight (1) and shadow (0); large parts stay constant."""
    rng = np.random.default_rng(seed)
    image = np.full(shape, 0.5, np.float32)
    for level in (1.0, 0.0, 1.0, 0.0):
        top, left = rng.integers(0, shape[0] - 20), rng.integers(0, shape[1] - 12)
        image[top : top + rng.integers(4, 20), left : left + rng.integers(3, 12)] = level
    return image


def brute_force(
    image: np.ndarray,
    template: np.ndarray,
    mask: np.ndarray,
    template_mask: np.ndarray | None = None,
    min_valid: float = 0.3,
) -> np.ndarray:
    """Masked eq. 4 in float64, window by window (row, col)."""
    height, width = template.shape
    weight = np.ones(template.shape, bool) if template_mask is None else template_mask
    scores = np.zeros((image.shape[0] - height + 1, image.shape[1] - width + 1))
    for row, col in np.ndindex(*scores.shape):
        use = mask[row : row + height, col : col + width] & weight
        if use.sum() < max(min_valid * weight.sum(), 1):
            continue
        window = image[row : row + height, col : col + width][use].astype(float)
        pixels = template[use].astype(float)
        window, pixels = window - window.mean(), pixels - pixels.mean()
        norm = np.sqrt((window**2).sum() * (pixels**2).sum())
        scores[row, col] = (window * pixels).sum() / norm if norm > 1e-5 else 0.0
    return scores


def window_deviation(image: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Standard deviation of every window (row, col), float64."""
    return np.lib.stride_tricks.sliding_window_view(image.astype(float), window).std(axis=(2, 3))
