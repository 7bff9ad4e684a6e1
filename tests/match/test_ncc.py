"""Eq. 4 against scikit-image, OpenCV and its own invariances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from skimage.feature import match_template

from sonarjax.io.errors import SonarjaxError
from sonarjax.match import correlation_maps, match_bank, match_positions, prepare_bank, template_spectra
from sonarjax.match.spectra import check_shapes
from sonarjax.match.windows import window_moments

TOLERANCE = 1e-4  # the bar of the package for eq. 4, in float32


def window_deviation(image: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Standard deviation of every window (row, col), float64."""
    return np.lib.stride_tricks.sliding_window_view(image.astype(float), window).std(axis=(2, 3))


def references(image: np.ndarray, templates: np.ndarray) -> np.ndarray:
    """scikit-image's maps (yaw, row, col), computed in float64."""
    return np.stack([match_template(image.astype(float), t.astype(float)) for t in templates])


@pytest.mark.parametrize(
    ("image_shape", "templates_shape"),
    [
        ((64, 48), (5, 16, 9)),
        ((101, 37), (3, 50, 37)),
        ((40, 40), (1, 40, 40)),
        ((97, 61), (13, 7, 1)),
        ((30, 7), (2, 1, 5)),
    ],
)
def test_equals_scikit_image_on_random_images(image_shape: tuple[int, int], templates_shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    image, templates = rng.random(image_shape, np.float32), rng.random(templates_shape, np.float32)
    maps = correlation_maps(image, templates)
    np.testing.assert_allclose(maps, references(image, templates), atol=TOLERANCE)
    np.testing.assert_allclose(match_bank(image, templates), maps.max(axis=(1, 2)), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_equals_opencv_where_windows_vary(seed: int, semantic_image: Callable[..., np.ndarray]) -> None:
    cv2 = pytest.importorskip("cv2")
    image = semantic_image(seed)
    templates = np.stack([image[20:60, 10:30], image[60:100, 30:50], semantic_image(seed + 9)[:40, :20]])
    templates = templates + np.random.default_rng(seed).normal(0, 0.05, templates.shape).astype(np.float32)
    expected = np.stack([cv2.matchTemplate(image, t, cv2.TM_CCOEFF_NORMED) for t in templates])
    varies = window_deviation(image, (40, 20)) > 5e-3  # one odd pixel of 800 deviates by 0.018
    maps = np.asarray(correlation_maps(image, templates))
    np.testing.assert_allclose(maps[:, varies], expected[:, varies], atol=TOLERANCE)
    assert np.all(maps[:, ~varies] == 0)


@pytest.mark.parametrize(("patch", "tolerance"), [(2.0, 1e-4), (10.0, 5e-4), (300.0, 5e-4)])
def test_keeps_its_digits_beside_a_bright_patch(patch: float, tolerance: float) -> None:
    rng = np.random.default_rng(2)
    image = rng.normal(0.5, 0.05, (256, 96)).astype(np.float32)
    image[20:60, 10:40] += patch
    templates = rng.random((4, 32, 16), np.float32)
    templates[0] = image[150:182, 60:76]
    maps = np.asarray(correlation_maps(image, templates))
    expected = references(image, templates)
    kept = maps[0] != 0
    np.testing.assert_allclose(maps[:, kept], expected[:, kept], atol=tolerance)
    if patch < 100:  # beside 300 a deviation of 0.05 counts as constant
        assert kept.all()


def test_window_moments_equal_numpy() -> None:
    rng = np.random.default_rng(3)
    image = (1000 + rng.normal(0, 0.1, (37, 29))).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(image.astype(float), (13, 7))
    moments = window_moments(jnp.asarray(image), (13, 7))
    assert moments.pixels == 13 * 7
    np.testing.assert_allclose(moments.mean, windows.mean(axis=(2, 3)), rtol=1e-6)
    np.testing.assert_allclose(moments.energy, windows.var(axis=(2, 3)) * 91, rtol=1e-3)  # integral images: 100 % off
    assert np.all(window_moments(jnp.full((20, 9), 0.1), (7, 5)).energy == 0)


def test_scale_and_offset_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    image, templates = rng.random((80, 40), np.float32), rng.random((3, 20, 10), np.float32)
    plain = correlation_maps(image, templates)
    np.testing.assert_allclose(correlation_maps(7 * image + 30, templates), plain, atol=TOLERANCE)
    np.testing.assert_allclose(correlation_maps(image, 0.1 * templates - 5), plain, atol=TOLERANCE)
    np.testing.assert_allclose(correlation_maps(-image, templates), -plain, atol=TOLERANCE)


def test_finds_a_planted_template_with_score_one() -> None:
    rng = np.random.default_rng(5)
    image, templates = rng.random((120, 50), np.float32), rng.random((37, 24, 12), np.float32)
    image[71:95, 8:20] = 0.2 + 0.5 * templates[30]
    found = match_positions(image, SimpleNamespace(templates=templates))
    assert int(jnp.argmax(found.scores)) == 30
    assert (int(found.row[30]), int(found.col[30])) == (71, 8)
    assert found.scores[30] == pytest.approx(1, abs=1e-5)
    expected = references(image, templates)
    corners = [np.unravel_index(np.argmax(m), m.shape) for m in expected]
    np.testing.assert_array_equal(np.stack([found.row, found.col], axis=1), corners)


def test_constant_windows_and_templates_score_zero() -> None:
    rng = np.random.default_rng(6)
    templates = rng.random((3, 16, 8), np.float32)
    assert np.all(match_bank(np.full((64, 32), 0.3, np.float32), templates) == 0)
    templates[1] = 0.1
    scores = np.asarray(match_bank(rng.random((64, 32), np.float32), templates))
    assert abs(scores[1]) < 1e-6
    assert np.all(scores[[0, 2]] > 0.1)


@pytest.mark.parametrize("level", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("masked", [False, True])
def test_a_frame_that_is_constant_up_to_rounding_scores_zero(level: float, masked: bool) -> None:
    rng = np.random.default_rng(8)
    image = (level + rng.choice([-3e-8, 0.0, 3e-8], (64, 32))).astype(np.float32)
    mask = None
    if masked:  # what was not measured varies
        mask = np.ones((64, 32), bool)
        mask[:, :8] = False
        image[:, :8] = rng.random((64, 8))
    assert np.all(np.asarray(match_bank(image, rng.random((3, 16, 8), np.float32), mask=mask)) == 0)


def test_kept_spectra_change_nothing() -> None:
    rng = np.random.default_rng(7)
    image, templates = rng.random((96, 64), np.float32), rng.random((101, 30, 20), np.float32)
    bank = prepare_bank(templates, (96, 64))
    np.testing.assert_array_equal(match_bank(image, bank), match_bank(image, templates))
    np.testing.assert_allclose(match_bank(image[:80], bank), match_bank(image[:80], templates), atol=1e-6)
    assert template_spectra(jnp.asarray(templates), (96, 64)).map_shape == (67, 45)


def test_spectra_of_other_templates_are_refused() -> None:
    templates = np.random.default_rng(0).random((5, 8, 6))
    bank = replace(prepare_bank(templates, (20, 20)), templates=jnp.asarray(templates[:4]))
    with pytest.raises(SonarjaxError, match="its spectra are of other templates"):
        match_bank(np.ones((20, 20)), bank)


def test_many_chunks_equal_one_template_at_a_time() -> None:
    rng = np.random.default_rng(8)
    image, templates = rng.random((512, 96), np.float32), rng.random((37, 96, 32), np.float32)
    assert template_spectra(jnp.asarray(templates), (512, 96)).planes.ndim == 4
    single = np.concatenate([np.asarray(match_bank(image, templates[k : k + 1])) for k in (0, 17, 36)])
    np.testing.assert_allclose(np.asarray(match_bank(image, templates))[[0, 17, 36]], single, atol=1e-6)


@pytest.mark.parametrize(
    ("image_shape", "templates_shape"),
    [((20, 20), (2, 21, 5)), ((20, 20), (2, 5, 21)), ((20,), (2, 5, 5)), ((20, 20), (5, 5))],
)
def test_wrong_shapes_are_one_clear_error(image_shape: tuple[int, ...], templates_shape: tuple[int, ...]) -> None:
    with pytest.raises(SonarjaxError, match=r"expected|larger"):
        check_shapes(templates_shape, image_shape)
    with pytest.raises((SonarjaxError, TypeError)):  # TypeError: where annotations are checked, they speak first
        match_bank(jnp.zeros(image_shape), jnp.zeros(templates_shape))


def test_jit_vmap_and_finite_gradients(semantic_image: Callable[..., np.ndarray]) -> None:
    rng = np.random.default_rng(9)
    frames, templates = rng.random((3, 60, 30), np.float32), rng.random((5, 20, 10), np.float32)
    bank = prepare_bank(templates, (60, 30))
    batch = jax.jit(jax.vmap(lambda frame: match_bank(frame, bank)))(frames)
    np.testing.assert_allclose(batch, np.stack([match_bank(f, bank) for f in frames]), atol=1e-6)
    for image in (jnp.asarray(frames[0]), jnp.full((60, 30), 0.5), jnp.asarray(semantic_image(1, (60, 30)))):
        for gradient in jax.grad(lambda i, t: match_bank(i, t).sum(), argnums=(0, 1))(image, jnp.asarray(templates)):
            assert bool(jnp.all(jnp.isfinite(gradient)))


def test_gradient_equals_finite_differences() -> None:
    rng = np.random.default_rng(10)
    image, templates = rng.random((40, 20), np.float32), rng.random((2, 12, 8), np.float32)
    image[5:17, 3:11] = 0.5 * image[5:17, 3:11] + 0.5 * templates[0]  # one clear best window
    direction = rng.normal(size=templates.shape).astype(np.float32)

    def best(templates: Array) -> Array:
        return match_bank(image, templates)[0]

    slope = jnp.vdot(jax.grad(best)(jnp.asarray(templates)), direction)
    step = 1e-2  # the score's rounding of 1e-7 then weighs 1e-5 in the slope
    difference = (best(templates + step * direction) - best(templates - step * direction)) / (2 * step)
    assert abs(float(slope)) > 1e-2
    assert float(slope) == pytest.approx(float(difference), rel=2e-2)


def test_equals_scikit_image_on_a_real_frame(real_frame: tuple[np.ndarray, np.ndarray]) -> None:
    image = real_frame[0]
    height, width = min(80, image.shape[0] // 2), min(24, image.shape[1] // 2)
    rows = np.linspace(0, image.shape[0] - height, 4).astype(int)
    templates = np.stack([image[r : r + height, 3 : 3 + width] for r in rows])
    templates = np.concatenate([templates, np.random.default_rng(11).random((2, height, width), np.float32)])
    templates[:4] += np.float32(image.std()) * templates[4]  # blank corners give no template
    varies = window_deviation(image, (height, width)) > 0.01 * image.std()
    maps = np.asarray(correlation_maps(image, templates))
    np.testing.assert_allclose(maps[:, varies], references(image, templates)[:, varies], atol=TOLERANCE)
