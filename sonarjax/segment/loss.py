"""The losses of segmentation: eq. 3 of the paper for pix2pix, cross-entropy for the 'discriminative model'.

The paper prints E[1 − log D] as the second term of eq. 3. The GAN loss is E[log(1 − D)], and that is used here. The
last term is λ E|N(y − x) − N(G(x, z) − x)|₁, where N maps to [−1, 1]. All functions take the logits of D, never D
itself.
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt8

Normaliser = Literal["affine", "per_image"]
N_CLASSES = 3


def discriminator_loss(
    real: Float[Array, "batch patchrow patchcolumn 1"], fake: Float[Array, "batch patchrow patchcolumn 1"]
) -> Float[Array, ""]:
    """What D minimises: −E[log D(x, y)] − E[log(1 − D(x, G))], from logits (batch, patchrow, patchcolumn, 1)."""
    return jax.nn.softplus(-real).mean() + jax.nn.softplus(fake).mean()


def adversarial_loss(fake: Float[Array, "batch patchrow patchcolumn 1"], saturating: bool = False) -> Float[Array, ""]:
    """The adversarial part of what G minimises, from the logits (batch, patchrow, patchcolumn, 1) of its maps.

    It is −E[log D(x, G)]. With `saturating` it is E[log(1 − D(x, G))] as in eq. 3, whose gradient vanishes where D is
    sure.
    """
    return -jax.nn.softplus(fake).mean() if saturating else jax.nn.softplus(-fake).mean()


def normalise_difference(
    difference: Float[Array, "batch height width 1"], normaliser: Normaliser
) -> Float[Array, "batch height width 1"]:
    """N of eq. 3: map differences (batch, height, width, 1) of images in [−1, 1] to [−1, 1].

    `affine` is the fixed map d / 2. `per_image` maps each image's smallest difference to −1 and its largest to 1; an
    image without differences stays 0.
    """
    if normaliser == "affine":
        return difference / 2
    low, high = (f(difference, (1, 2, 3), keepdims=True) for f in (jnp.min, jnp.max))
    flat = high - low < 1e-6
    return jnp.where(flat, 0.0, 2 * (difference - low) / jnp.where(flat, 1.0, high - low) - 1)


def distance_loss(
    x: Float[Array, "batch height width 1"],
    y: Float[Array, "batch height width 1"],
    made: Float[Array, "batch height width 1"],
    normaliser: Normaliser = "affine",
) -> Float[Array, ""]:
    """E|N(y − x) − N(G − x)|₁ of eq. 3, the mean over pixels; image, truth and `made` are (batch, height, width, 1).

    With `affine`, x cancels and this is half the mean absolute error. With `per_image` it does not cancel.
    """
    wanted, found = (normalise_difference(image - x, normaliser) for image in (y, made))
    return jnp.abs(wanted - found).mean()


def labels_of(y: Float[Array, "batch height width 1"]) -> Int[Array, "batch height width"]:
    """Labels (batch, height, width) of semantic maps (batch, height, width, 1): shadow where −1, highlight where 1."""
    rounded = jnp.rint(y[..., 0]).astype(jnp.int32)
    return jnp.where(rounded < 0, 2, rounded)


def cross_entropy(
    logits: Float[Array, "batch height width 3"],
    labels: Int[Array, "batch height width"] | UInt8[Array, "batch height width"],
    weights: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Float[Array, ""]:
    """Mean over pixels of −weight · log p(label), divided by the mean weight.

    Args:
        logits: Logits (batch, height, width, 3).
        labels: True labels (batch, height, width).
        weights: Weights of background, highlight and shadow. They strengthen rare classes: highlight is a few per cent
            of the pixels.
    """
    chosen = jax.nn.one_hot(labels, N_CLASSES, dtype=logits.dtype)
    each = -(chosen * jax.nn.log_softmax(logits, -1)).sum(-1)
    weight = (chosen * jnp.asarray(weights, logits.dtype)).sum(-1)
    return (weight * each).sum() / weight.sum()
