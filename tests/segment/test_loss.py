"""The losses against PyTorch's and closed forms, and at logits where the plain formula overflows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.segment.loss import (
    adversarial_loss,
    cross_entropy,
    discriminator_loss,
    distance_loss,
    labels_of,
    normalise_difference,
)


def logits(rng: np.random.Generator, *shape: int) -> jax.Array:
    return jnp.asarray(rng.normal(size=shape), jnp.float32)


def test_game_is_the_logarithms_of_eq_3(rng: np.random.Generator) -> None:
    real, fake = logits(rng, 2, 3, 3, 1), logits(rng, 2, 3, 3, 1)
    d_real, d_fake = (1 / (1 + np.exp(-np.asarray(v, np.float64))) for v in (real, fake))
    wanted = -np.log(d_real).mean() - np.log(1 - d_fake).mean()
    assert float(discriminator_loss(real, fake)) == pytest.approx(wanted, rel=1e-5)
    assert float(adversarial_loss(fake)) == pytest.approx(-np.log(d_fake).mean(), rel=1e-5)
    assert float(adversarial_loss(fake, saturating=True)) == pytest.approx(np.log(1 - d_fake).mean(), rel=1e-5)


def test_game_is_finite_where_the_discriminator_is_sure() -> None:
    sure = jnp.full((1, 1, 1, 1), 200.0)
    assert float(discriminator_loss(-sure, sure)) == pytest.approx(400.0)
    assert float(adversarial_loss(-sure)) == pytest.approx(200.0)
    slopes = [float(jax.grad(adversarial_loss)(-sure).sum()), float(jax.grad(adversarial_loss)(-sure, True).sum())]
    assert slopes == pytest.approx([-1.0, 0.0], abs=1e-6)  # the printed form does not move the generator here


def test_affine_distance_is_half_of_l1(rng: np.random.Generator) -> None:
    x, y, made = (jnp.tanh(logits(rng, 2, 4, 4, 1)) for _ in range(3))
    assert float(distance_loss(x, y, made)) == pytest.approx(float(np.abs(y - made).mean()) / 2, rel=1e-5)
    assert float(distance_loss(0 * x, y, made)) == pytest.approx(float(distance_loss(x, y, made)), rel=1e-5)


def test_per_image_normaliser_reaches_both_ends_of_each_image(rng: np.random.Generator) -> None:
    difference = logits(rng, 3, 5, 5, 1)
    found = np.asarray(normalise_difference(difference, "per_image"))
    np.testing.assert_allclose(found.min((1, 2, 3)), -1, atol=1e-6)
    np.testing.assert_allclose(found.max((1, 2, 3)), 1, atol=1e-6)
    stretched = normalise_difference(3 * difference + 7, "per_image")  # what min–max forgets
    np.testing.assert_allclose(stretched, found, atol=1e-5)


def test_per_image_distance_depends_on_x_and_is_finite_without_differences(rng: np.random.Generator) -> None:
    x, y, made = (jnp.tanh(logits(rng, 2, 4, 4, 1)) for _ in range(3))
    both = [float(distance_loss(image, y, made, "per_image")) for image in (x, 0 * x)]
    assert abs(both[0] - both[1]) > 1e-3
    slope = jax.grad(lambda made: distance_loss(y, y, made, "per_image"))(y)
    assert bool(jnp.isfinite(slope).all())


def test_labels_of_a_semantic_map() -> None:
    assert labels_of(jnp.asarray([[[[-1.0], [0.0], [1.0]]]])).tolist() == [[[2, 0, 1]]]


@pytest.mark.parametrize("weights", [(1.0, 1.0, 1.0), (0.5, 4.0, 2.0)])
def test_cross_entropy_is_pytorchs(weights: tuple[float, float, float], rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    scores, labels = logits(rng, 2, 4, 5, 3), rng.integers(0, 3, (2, 4, 5)).astype(np.uint8)
    wanted = torch.nn.functional.cross_entropy(
        torch.tensor(np.asarray(scores)).permute(0, 3, 1, 2), torch.tensor(labels).long(), torch.tensor(weights)
    )
    assert float(cross_entropy(scores, jnp.asarray(labels), weights)) == pytest.approx(wanted.item(), rel=1e-5)
