"""Eq. 4 over the measured pixels only: masked normalised cross-correlation (Padfield 2012).

Mean and norm of window *and* template are taken over the measured pixels of the window, so that unmeasured parts of a
frame (NaN, black corners, a blanked near range) neither help nor hurt.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from sonarjax.match.spectra import centred_frame, correlate, frame_spectrum, inverse_root
from sonarjax.match.windows import window_moments

NEAR_CONSTANT = 1e-6
"""A window with less than this share of the frame's energy counts as constant and scores 0.

Rounding in the transform changes the score of the faintest windows that still count by up to 5e-4. Above 4e-5 of the
frame's energy (one odd pixel in a window of a semantic map) the error stays below 1e-4.
"""
LOST_TEMPLATE = 1e-4
"""A template that keeps less than this share of its energy over the measured pixels scores 0 there."""
MIN_VALID = 0.3
"""Least share of a template's pixels that must be measured under it; otherwise it scores 0."""

MIN_HIGHLIGHT = 0.5
"""Least share of a template's highlight that must be measured, if the option `penalise_unmeasured` is used."""


class MaskedFrame(NamedTuple):
    """What masked matching needs of a frame, whatever the template."""

    signal: Complex[Array, "range beam"]
    """Spectrum of the centred frame, with 0 where it was not measured."""
    valid: Complex[Array, "range beam"]
    """Spectrum of the mask."""
    mean: Float[Array, "row col"]
    """Mean of the measured pixels of each window, relative to the frame's own mean."""
    pixels: Float[Array, "row col"]
    """Number of measured pixels of each window, at least 1."""
    scale: Float[Array, "row col"]
    """1/√energy of each window; 0 if it is nearly constant or has too few measured pixels."""


def masked_frame(
    image: Float[Array, "range beam"],
    mask: Bool[Array, "range beam"],
    window: tuple[int, int],
    min_valid: float | Array,
) -> MaskedFrame:
    """Spectra and window moments of `image` where `mask` is true, for windows (height, width) [pixels]."""
    centred = centred_frame(image, mask)
    moments = window_moments(centred, window, mask)
    enough = moments.pixels >= min_valid * window[0] * window[1]
    scale = jnp.where(enough, inverse_root(moments.energy, NEAR_CONSTANT * jnp.sum(jnp.square(centred))), 0.0)
    count = jnp.maximum(moments.pixels, 1.0)
    return MaskedFrame(frame_spectrum(centred), frame_spectrum(mask.astype(image.dtype)), moments.mean, count, scale)


def masked_maps(
    frame: MaskedFrame,
    planes: Complex[Array, "pair range beam"],
    squares: Complex[Array, "pair range beam"],
    highlights: Complex[Array, "pair range beam"],
    penalise_unmeasured: bool = False,
) -> Float[Array, "pair two row col"]:
    """Masked eq. 4 at all window positions, for pairs of unit templates (`planes`), their squares and `highlights`.

    With `penalise_unmeasured`, a template's norm is taken over all of it, so that the part over unmeasured pixels
    counts as unmatched. A template then also scores 0 unless the share MIN_HIGHLIGHT of its highlight was measured: its
    shadow alone is no match, because it would fit any dark corner at the edge of the measured pixels.
    """
    shape = (frame.mean.shape[0], frame.mean.shape[1])
    total = correlate(frame.valid, planes, shape)  # Σ T over measured pixels
    energy = correlate(frame.valid, squares, shape) - jnp.square(total) / frame.pixels
    product = correlate(frame.signal, planes, shape) - frame.mean * total
    if not penalise_unmeasured:
        return product * frame.scale * inverse_root(energy, LOST_TEMPLATE)
    seen = (energy > LOST_TEMPLATE) & (correlate(frame.valid, highlights, shape) >= MIN_HIGHLIGHT)
    return product * frame.scale * seen


class WeightedFrame(NamedTuple):
    """Spectra of a frame for templates that have their own masks."""

    signal: Complex[Array, "range beam"]
    """Spectrum of the centred frame, with 0 where it was not measured."""
    square: Complex[Array, "range beam"]
    """Spectrum of its square."""
    valid: Complex[Array, "range beam"]
    """Spectrum of the mask."""
    energy: Float[Array, ""]
    """Sum of the squared centred frame."""


def weighted_frame(image: Float[Array, "range beam"], mask: Bool[Array, "range beam"]) -> WeightedFrame:
    """Spectra of `image` where `mask` is true."""
    centred = centred_frame(image, mask)
    square = jnp.square(centred)
    return WeightedFrame(
        frame_spectrum(centred), frame_spectrum(square), frame_spectrum(mask.astype(image.dtype)), jnp.sum(square)
    )


def weighted_maps(
    frame: WeightedFrame,
    planes: Complex[Array, "pair range beam"],
    squares: Complex[Array, "pair range beam"],
    weights: Complex[Array, "pair range beam"],
    pixels: Float[Array, "pair two"],
    map_shape: tuple[int, int],
    min_valid: float | Array,
) -> Float[Array, "pair two row col"]:
    """Masked eq. 4 where each template counts only under its own mask (`weights`, which holds `pixels` pixels).

    The window moments differ from template to template here, so they are correlations too (six in all).
    """
    count = jnp.round(correlate(frame.valid, weights, map_shape))
    safe = jnp.maximum(count, 1.0)
    total = correlate(frame.valid, planes, map_shape)
    template = correlate(frame.valid, squares, map_shape) - jnp.square(total) / safe
    signal = correlate(frame.signal, weights, map_shape)
    window = correlate(frame.square, weights, map_shape) - jnp.square(signal) / safe
    product = correlate(frame.signal, planes, map_shape) - signal * total / safe
    # This energy is a difference of sums, so its tolerance is ten times that of `masked_maps`.
    scores = product * inverse_root(window, 10 * NEAR_CONSTANT * frame.energy) * inverse_root(template, LOST_TEMPLATE)
    wanted = jnp.maximum(min_valid * pixels, 1.0)[..., None, None]
    return jnp.where(count >= wanted, scores, 0.0)
