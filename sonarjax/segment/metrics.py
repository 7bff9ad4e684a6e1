"""Quality of a semantic map: confusion counts, intersection over union and PSNR, each by its textbook definition."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt8

from sonarjax.segment.loss import N_CLASSES

LEAST_ERROR = 1e-10
"""Smaller mean squared errors count as this one, so PSNR stops at 100 dB."""


def confusion(
    predicted: UInt8[Array, "*batch range beam"], truth: UInt8[Array, "*batch range beam"]
) -> Int[Array, "truth predicted"]:
    """Number of pixels (truth, predicted) for each pair of true and predicted label, over maps (..., range, beam)."""
    pairs = truth.astype(jnp.int32) * N_CLASSES + predicted
    return jnp.bincount(pairs.ravel(), length=N_CLASSES**2).reshape(N_CLASSES, N_CLASSES)


def iou(counts: Int[Array, "truth predicted"]) -> Float[Array, "label"]:
    """Intersection over union (label,), the Jaccard index, from `confusion` (truth, predicted) of all pixels together.

    It is 1 for a label that is neither present nor predicted.
    """
    both = jnp.diagonal(counts)
    either = counts.sum(axis=0) + counts.sum(axis=1) - both
    return jnp.where(either > 0, both / jnp.maximum(either, 1), 1.0)


def psnr(image: Float[Array, "*batch range beam"], truth: Float[Array, "*batch range beam"]) -> Float[Array, "*batch"]:
    """Peak signal-to-noise ratio [dB] of each image (range, beam) in [0, 1] against the true one: −10 log₁₀ MSE."""
    error = jnp.square(image - truth).mean(axis=(-2, -1))
    return -10 * jnp.log10(jnp.maximum(error, LEAST_ERROR))
