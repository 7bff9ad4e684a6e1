"""Spectra of a template bank, kept so that many frames can be matched with it.

Takes templates (yaw, h, w) and returns `TemplateSpectra`. Two real templates share one complex transform: their
correlations are its real and its imaginary part. A few pairs form a chunk that stays in the processor's cache. On two
CPU cores both together are up to twice as fast as one batched real transform of the complete bank.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.records import record, static
from sonarjax.render.frame import BACKGROUND

CHUNK_BYTES = {"cpu": 5 << 19, "gpu": 1 << 28, "tpu": 1 << 28}
"""Size of the spectra that are processed at once [bytes]: about the second-level caches of two cores, or enough
for an accelerator.
"""
CONSTANT_TEMPLATE = 1e-10
"""A template whose variance is below this share of its mean square counts as constant and scores 0."""
ROUNDING = 8 * float(jnp.finfo(jnp.float32).eps)
"""A frame whose grey values differ by no more than this share of their mean is constant: the rest is rounding."""


@record
class TemplateSpectra:
    """Spectra of a bank's templates, centred and scaled to unit norm, in chunks of packed pairs."""

    planes: Complex[Array, "*batch chunk pair range beam"]
    """Conjugate spectra of templates 2p, plus i times those of 2p + 1, zero-padded to the size of the transform."""
    squares: Complex[Array, "*batch chunk pair range beam"] | None
    """The same for the squared templates, needed to match with a mask; None if that was not asked for."""
    highlights: Complex[Array, "*batch chunk pair range beam"] | None
    """The same for their highlight alone, scaled to sum 1; None if `squares` is."""
    yaw_count: int = static()
    """Number of templates; the planes may hold a few empty ones in addition."""
    template_shape: tuple[int, int] = static()
    """Height and width of a template [range bins, beams]."""
    image_shape: tuple[int, int] = static()
    """Shape of the frames for which they are made [range bins, beams]."""

    @property
    def map_shape(self) -> tuple[int, int]:
        """Number of window positions along range and beam."""
        (height, width), (ranges, beams) = self.template_shape, self.image_shape
        return ranges - height + 1, beams - width + 1


def template_spectra(
    templates: Float[Array, "yaw h w"], image_shape: tuple[int, int], *, masked: bool = False
) -> TemplateSpectra:
    """Compute the spectra of templates for frames of one shape, to be kept with the bank.

    Args:
        templates: The templates (yaw, h, w).
        image_shape: Shape (range, beam) of the frames to match.
        masked: Add what matching with a mask needs.

    Returns:
        The spectra, to be given as `.spectra` of a bank to `match_bank` and the like.

    Raises:
        SonarjaxError: A template is larger than the frame.
    """
    check_shapes(templates.shape, image_shape)
    unit = unit_templates(templates)
    planes = pack(unit, image_shape)
    squares = pack(jnp.square(unit), image_shape) if masked else None
    highlights = pack(_highlight_shares(templates), image_shape) if masked else None
    sizes = (templates.shape[1], templates.shape[2]), (image_shape[0], image_shape[1])
    return TemplateSpectra(planes, squares, highlights, templates.shape[0], *sizes)


def centred_frame(
    image: Float[Array, "range beam"], mask: Bool[Array, "range beam"] | None = None
) -> Float[Array, "range beam"]:
    """`image` minus the mean of its measured pixels, and 0 elsewhere; unmeasured pixels may be NaN.

    The mean cancels in eq. 4, but a large one would cost float32 digits. A constant frame becomes 0, without the noise
    of rounding, which would correlate with a template by chance.
    """
    measured = jnp.ones(image.shape, bool) if mask is None else mask
    mean = jnp.sum(jnp.where(measured, image, 0.0)) / jnp.maximum(jnp.sum(measured), 1)
    spread = jnp.max(jnp.where(measured, image, -jnp.inf)) - jnp.min(jnp.where(measured, image, jnp.inf))
    return jnp.where(measured & (spread > ROUNDING * jnp.abs(mean)), image - mean, 0.0)


def _highlight_shares(templates: Float[Array, "yaw h w"]) -> Float[Array, "yaw h w"]:
    """Each pixel's share of its template's highlight, the grey above the background's; equal if there is none."""
    bright = jnp.maximum(templates - BACKGROUND, 0.0)
    total = jnp.sum(bright, axis=(1, 2), keepdims=True)
    return jnp.where(total > 0, bright / jnp.where(total > 0, total, 1.0), 1.0 / templates[0].size)


def check_shapes(templates: tuple[int, ...], image: tuple[int, ...]) -> None:
    """Raise a SonarjaxError unless `templates` is (yaw, h, w), not empty, and fits into `image` (range, beam)."""
    if len(image) != 2 or 0 in image:
        raise SonarjaxError(f"image: expected shape (range, beam), got {tuple(image)}")
    if len(templates) != 3 or 0 in templates:
        raise SonarjaxError(f"templates: expected shape (yaw, h, w) without zeros, got {tuple(templates)}")
    if templates[1] > image[0] or templates[2] > image[1]:
        raise SonarjaxError(
            f"templates: {templates[1]} x {templates[2]} pixels are larger than the image, {image[0]} x {image[1]}"
        )


def unit_templates(
    templates: Float[Array, "yaw h w"], weight: Float[Array, "yaw h w"] | None = None
) -> Float[Array, "yaw h w"]:
    """Templates (yaw, h, w) with mean 0 and norm 1: T − T̄ and the second root of eq. 4. Constant templates become 0.

    `weight` (yaw, h, w), 0 or 1, says which pixels of each template count; the others become 0.
    """
    if weight is None:
        mean = jnp.mean(templates, axis=(1, 2), keepdims=True)
        centred = templates - mean
    else:
        pixels = jnp.maximum(jnp.sum(weight, axis=(1, 2), keepdims=True), 1.0)
        mean = jnp.sum(weight * templates, axis=(1, 2), keepdims=True) / pixels
        centred = weight * (templates - mean)
    energy = jnp.sum(jnp.square(centred), axis=(1, 2), keepdims=True)
    total = energy + jnp.square(mean) * (templates[0].size if weight is None else pixels)
    return centred * inverse_root(energy, CONSTANT_TEMPLATE * total)


def inverse_root(energy: Array, floor: Any) -> Array:
    """1/√energy where `energy` exceeds `floor`, else 0. It is guarded before the root, so that no gradient is NaN."""
    enough = energy > floor
    return jnp.where(enough, jax.lax.rsqrt(jnp.where(enough, energy, 1.0)), 0.0)


def pack(templates: Float[Array, "yaw h w"], image_shape: tuple[int, int]) -> Complex[Array, "chunk pair range beam"]:
    """Conjugate spectra of `templates` (yaw, h, w) in chunks of pairs, padded to the transform of `image_shape`."""
    size = transform_size(image_shape)
    pairs = -(-templates.shape[0] // 2)
    budget = CHUNK_BYTES.get(jax.default_backend(), CHUNK_BYTES["gpu"])
    chunks = -(-pairs // max(1, budget // (8 * size[0] * size[1])))
    per_chunk = -(-pairs // chunks)
    padded = jnp.pad(templates, ((0, 2 * chunks * per_chunk - templates.shape[0]), (0, 0), (0, 0)))
    padded = padded.reshape(chunks, per_chunk, 2, *templates.shape[1:])
    packed = jax.lax.complex(padded[:, :, 0], -padded[:, :, 1])  # conj of (A − iB) is conj A + i conj B
    return over_chunks(lambda pair: jnp.conj(jnp.fft.fft2(pair, s=size)), packed)


def transform_size(image_shape: tuple[int, int]) -> tuple[int, int]:
    """Smallest sizes with factors 2, 3 and 5 that hold the frame; wrapped-around values reach no valid position."""

    def smooth(length: int) -> int:
        rest = length
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        return length if rest == 1 else smooth(length + 1)

    return smooth(image_shape[0]), smooth(image_shape[1])


def frame_spectrum(image: Float[Array, "range beam"]) -> Complex[Array, "padded_range padded_beam"]:
    """Spectrum of a frame (range, beam), zero-padded to the transform's size."""
    return jnp.fft.fft2(image.astype(jnp.complex64), s=transform_size((image.shape[0], image.shape[1])))


def correlate(
    frame: Complex[Array, "range beam"], planes: Complex[Array, "pair range beam"], map_shape: tuple[int, int]
) -> Float[Array, "pair two row col"]:
    """Correlations Σ S(m+i, n+j) T(i, j) at all window positions, for both templates of each pair."""
    both = jnp.fft.ifft2(frame * planes)[:, : map_shape[0], : map_shape[1]]
    return jnp.stack([both.real, both.imag], axis=1)


def over_chunks(function: Callable[[Any], Any], chunks: Any) -> Any:
    """Apply `function` to each chunk (leading axis of the pytree `chunks`), one after the other; stack the results."""
    if jax.tree_util.tree_leaves(chunks)[0].shape[0] == 1:  # even a loop over one chunk has a cost
        only = function(jax.tree_util.tree_map(lambda x: x[0], chunks))
        return jax.tree_util.tree_map(lambda x: x[None], only)
    return jax.lax.map(function, chunks)
