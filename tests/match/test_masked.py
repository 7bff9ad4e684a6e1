"""Masked eq. 4 against a loop over windows and scikit-image's masked correlation."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.match import correlation_maps, match_bank, match_positions, prepare_bank


def fan_mask(shape: tuple[int, int]) -> np.ndarray:
    """True inside a slanted outline, with a hole: as a blanked near range and a shaded corner."""
    row, col = np.indices(shape)
    return (row > 8) & (row + 2 * col < shape[0] + shape[1]) & ~((row > 30) & (row < 36) & (col > 5))


@pytest.mark.parametrize("kind", ["random", "semantic"])
def test_equals_a_loop_over_windows(
    kind: str, brute_force: Callable[..., np.ndarray], semantic_image: Callable[..., np.ndarray]
) -> None:
    rng = np.random.default_rng(1)
    image = rng.random((70, 40), np.float32) if kind == "random" else semantic_image(3, (70, 40))
    templates = rng.random((5, 22, 11), np.float32)
    mask = fan_mask(image.shape)
    expected = np.stack([brute_force(image, t, mask) for t in templates])
    np.testing.assert_allclose(correlation_maps(image, templates, mask), expected, atol=1e-4)
    np.testing.assert_allclose(match_bank(image, templates, mask), expected.max(axis=(1, 2)), atol=1e-4)
    bank = prepare_bank(templates, image.shape, masked=True)
    np.testing.assert_allclose(match_bank(image, bank, mask), expected.max(axis=(1, 2)), atol=1e-4)


def test_template_mask_equals_a_loop_over_windows(brute_force: Callable[..., np.ndarray]) -> None:
    rng = np.random.default_rng(2)
    image, templates = rng.random((60, 36), np.float32), rng.random((4, 20, 12), np.float32)
    template_mask, mask = rng.random(templates.shape) < 0.6, fan_mask(image.shape)
    expected = np.stack([brute_force(image, t, mask, m) for t, m in zip(templates, template_mask, strict=True)])
    maps = correlation_maps(image, templates, mask, template_mask=template_mask)
    np.testing.assert_allclose(maps, expected, atol=1e-4)
    everywhere = np.stack(
        [brute_force(image, t, np.ones(image.shape, bool), m) for t, m in zip(templates, template_mask, strict=True)]
    )
    np.testing.assert_allclose(correlation_maps(image, templates, template_mask=template_mask), everywhere, atol=1e-4)


def test_equals_scikit_image() -> None:
    masked = pytest.importorskip("skimage.registration._masked_phase_cross_correlation")
    rng = np.random.default_rng(3)
    image, template = rng.random((50, 30)), rng.random((16, 9))
    mask = fan_mask(image.shape)
    full = masked.cross_correlate_masked(
        image, template, mask, np.ones(template.shape, bool), axes=(0, 1), overlap_ratio=0.3
    )
    valid = full[template.shape[0] - 1 : image.shape[0], template.shape[1] - 1 : image.shape[1]]
    ours = np.asarray(correlation_maps(image.astype(np.float32), template[None].astype(np.float32), mask)[0])
    both = (ours != 0) & (valid != 0)  # the two count a share of overlap differently
    assert both.mean() > 0.5
    np.testing.assert_allclose(ours[both], valid[both], atol=1e-4)


def test_a_full_mask_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    image, templates = rng.random((64, 40), np.float32), rng.random((7, 20, 10), np.float32)
    full = np.ones(image.shape, bool)
    np.testing.assert_allclose(correlation_maps(image, templates, full), correlation_maps(image, templates), atol=1e-5)


def test_what_was_not_measured_does_not_count() -> None:
    rng = np.random.default_rng(5)
    image, templates = rng.random((64, 40), np.float32), rng.random((7, 20, 10), np.float32)
    mask = fan_mask(image.shape)
    wrong = np.where(mask, image, np.nan).astype(np.float32)
    np.testing.assert_array_equal(match_bank(wrong, templates, mask), match_bank(image, templates, mask))


def test_a_half_hidden_template_still_scores_one() -> None:
    rng = np.random.default_rng(6)
    image, templates = rng.random((90, 40), np.float32), rng.random((3, 30, 12), np.float32)
    image[40:70, 20:32] = templates[1]
    mask = np.ones(image.shape, bool)
    image[55:], mask[55:] = 0, False
    found = match_positions(image, templates, mask)
    assert found.scores[1] == pytest.approx(1, abs=1e-4)
    assert (int(found.row[1]), int(found.col[1])) == (40, 20)
    assert match_bank(image, templates)[1] < 0.9
    assert match_bank(image, templates, mask, min_valid=0.6)[1] < 0.9


def test_no_pixel_measured_is_zero_and_finite() -> None:
    rng = np.random.default_rng(7)
    image, templates = jnp.asarray(rng.random((40, 20), np.float32)), jnp.asarray(rng.random((3, 12, 8), np.float32))
    nothing = jnp.zeros(image.shape, bool)
    weight = jnp.ones(templates.shape, bool).at[1].set(False)
    assert np.all(match_bank(image, templates, nothing) == 0)
    assert match_bank(image, templates, template_mask=weight)[1] == 0
    some = jnp.asarray(fan_mask((40, 20)))

    @jax.jit
    @jax.grad
    def gradient(image: jax.Array, options: dict[str, jax.Array]) -> jax.Array:
        return match_bank(image, templates, **options).sum()

    for options in ({"mask": nothing}, {"mask": some}, {"mask": some, "template_mask": weight}):
        assert bool(jnp.all(jnp.isfinite(gradient(image, options))))


def test_a_mask_of_another_shape_is_an_error() -> None:
    # TypeError: where annotations are checked, they speak first
    with pytest.raises((SonarjaxError, TypeError)):
        match_bank(jnp.zeros((20, 20)), jnp.zeros((2, 5, 5)), jnp.ones((20, 19), bool))
    with pytest.raises((SonarjaxError, TypeError)):
        match_bank(jnp.zeros((20, 20)), jnp.zeros((2, 5, 5)), template_mask=jnp.ones((2, 5, 4), bool))


def test_equals_a_loop_on_a_real_frame(
    brute_force: Callable[..., np.ndarray], real_frame: tuple[np.ndarray, np.ndarray]
) -> None:
    image, mask = (a[::4, ::2] for a in real_frame)  # the loop is slow
    templates = np.random.default_rng(8).random((2, image.shape[0] // 4, image.shape[1] // 4), np.float32)
    expected = np.stack([brute_force(image, t, mask) for t in templates])
    maps = np.asarray(correlation_maps(image, templates, mask))
    counted = maps != 0
    assert counted.any(axis=(1, 2)).all()
    np.testing.assert_allclose(maps[counted], expected[counted], atol=1e-4)


def test_a_template_cannot_hide_behind_the_mask():
    """The norm of all of the template: eq. 4 by hand, and never more than over the measured part."""
    rng = np.random.default_rng(5)
    image, template = rng.random((20, 12)).astype(np.float32), rng.random((1, 8, 6)).astype(np.float32)
    mask = rng.random(image.shape) < 0.7
    part, penalised = (match_positions(image, template, mask, penalise_unmeasured=w) for w in (False, True))
    row, col = int(penalised.row[0]), int(penalised.col[0])
    here = mask[row : row + 8, col : col + 6]
    seen, drawn = image[row : row + 8, col : col + 6][here], template[0][here]
    norm = np.linalg.norm(template[0] - template[0].mean())
    expected = ((seen - seen.mean()) * drawn).sum() / (np.linalg.norm(seen - seen.mean()) * norm)
    assert float(penalised.scores[0]) == pytest.approx(expected, abs=1e-4)
    assert float(penalised.scores[0]) < float(part.scores[0])
    everywhere = [
        match_positions(image, template, np.ones_like(mask), penalise_unmeasured=w).scores for w in (False, True)
    ]
    np.testing.assert_allclose(*everywhere, atol=1e-5)


def test_a_shadow_alone_is_no_match():
    """A dark corner whose object would lie outside the mask scores 0 although all that was measured fits exactly."""
    template = np.full((1, 12, 8), 0.5, np.float32)
    template[0, :3, 2:6], template[0, 3:, 2:6] = 1.0, 0.0  # an echo and its shadow behind it
    image = 0.5 + 0.01 * np.random.default_rng(6).standard_normal((30, 20)).astype(np.float32)
    image[10:19, 6:10] = 0.0  # the shadow; its echo would be in rows 7 to 9
    mask = np.ones(image.shape, bool)
    mask[:10] = False
    assert match_positions(image, template, mask).scores[0] > 0.9  # the measured part alone fits
    found = match_positions(image, template, mask, penalise_unmeasured=True)
    assert int(found.row[0]) >= 9 and found.scores[0] < 0.6
    image[7:10, 6:10] = 1.0
    mask[:] = True
    found = match_positions(image, template, mask, penalise_unmeasured=True)
    assert (int(found.row[0]), int(found.col[0])) == (7, 4) and found.scores[0] > 0.9
