"""Images and reference matchers for these tests, written without the package; fixtures that return functions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def real_frame() -> tuple[np.ndarray, np.ndarray]:
    """Image and mask (range, beam) of a real turntable frame; skips where the shared data is absent."""
    shared = Path(__file__).resolve().parents[2].parent / "shared"
    path = shared / "real" / "pipe" / "frames" / "frame_000.npz"
    if not path.exists():
        pytest.skip("real frames are not here")
    with np.load(path) as frame:
        return frame["image"].astype(np.float32), frame["mask"].astype(bool)


@pytest.fixture
def semantic_image() -> Callable[..., np.ndarray]:
    """Background 0.5 with rectangles of highlight (1) and shadow (0); large parts stay constant."""

    def make(seed: int, shape: tuple[int, int] = (160, 64)) -> np.ndarray:
        rng = np.random.default_rng(seed)
        image = np.full(shape, 0.5, np.float32)
        for level in (1.0, 0.0, 1.0, 0.0):
            top, left = rng.integers(0, shape[0] - 20), rng.integers(0, shape[1] - 12)
            image[top : top + rng.integers(4, 20), left : left + rng.integers(3, 12)] = level
        return image

    return make


@pytest.fixture
def brute_force() -> Callable[..., np.ndarray]:
    """Masked eq. 4 in float64, window by window (row, col)."""

    def maps(
        image: np.ndarray, template: np.ndarray, mask: np.ndarray, template_mask: np.ndarray | None = None
    ) -> np.ndarray:
        height, width = template.shape
        weight = np.ones(template.shape, bool) if template_mask is None else template_mask
        scores = np.zeros((image.shape[0] - height + 1, image.shape[1] - width + 1))
        for row, col in np.ndindex(*scores.shape):
            use = mask[row : row + height, col : col + width] & weight
            if use.sum() < max(0.3 * weight.sum(), 1):  # 0.3 is the package's default
                continue
            window = image[row : row + height, col : col + width][use].astype(float)
            pixels = template[use].astype(float)
            window, pixels = window - window.mean(), pixels - pixels.mean()
            norm = np.sqrt((window**2).sum() * (pixels**2).sum())
            scores[row, col] = (window * pixels).sum() / norm if norm > 1e-5 else 0.0
        return scores

    return maps
