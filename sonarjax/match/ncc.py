"""Eq. 4: zero-mean normalised cross-correlation of a frame with every template of a bank over yaw.

Takes a frame (range, beam) and a bank (`.templates` (yaw, h, w), or a plain array). Returns scores (yaw,) from -1 to 1,
the corner of the best window, or complete maps (yaw, row, col). Nearly constant windows and templates score 0. Frames
must be finite where they were measured. For a batch of frames use `jax.vmap`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import image_array, number_array
from sonarjax.match.masked import MIN_VALID, NEAR_CONSTANT, masked_frame, masked_maps, weighted_frame, weighted_maps
from sonarjax.match.spectra import (
    TemplateSpectra,
    centred_frame,
    check_shapes,
    correlate,
    frame_spectrum,
    inverse_root,
    over_chunks,
    pack,
    template_spectra,
    unit_templates,
)
from sonarjax.match.windows import window_moments
from sonarjax.records import record
from sonarjax.sonar.image import check_finite

AnyArray = Array | np.ndarray


class MatchPositions(NamedTuple):
    """Where each template of a bank fits best."""

    scores: Float[Array, " yaw"]
    """Largest correlation over all window positions (eq. 4), -1 to 1."""
    row: Int[Array, " yaw"]
    """Range bin of the best window's first row."""
    col: Int[Array, " yaw"]
    """Beam of the best window's first column."""


@record
class PreparedBank:
    """A bank together with its spectra, which halves the cost of matching it with many frames."""

    templates: Float[Array, "*batch yaw h w"]
    """The bank's templates."""
    spectra: TemplateSpectra
    """Their spectra for one frame shape. Matching uses these alone: for other templates call `prepare_bank` again."""


def prepare_bank(bank: Any, image_shape: tuple[int, int], *, masked: bool = False) -> PreparedBank:
    """Compute the spectra of a bank once, which halves the cost of matching it with many frames.

    Args:
        bank: Templates (yaw, h, w), or a record with `.templates`.
        image_shape: Shape (range, beam) of the frames to match.
        masked: Keep also what matching with a mask needs.

    Returns:
        The bank's `templates` (yaw, h, w) and their `spectra`, to be given to `match_bank` and the like.

    Raises:
        SonarjaxError: A template is larger than the frame.
    """
    templates = _templates(bank)
    check_shapes(templates.shape, image_shape)
    return PreparedBank(templates, _spectra(templates, (image_shape[0], image_shape[1]), masked))


def match_bank(
    image: Float[AnyArray, "range beam"],
    bank: Any,
    mask: Bool[AnyArray, "range beam"] | None = None,
    *,
    min_valid: float = MIN_VALID,
    template_mask: Bool[AnyArray, "yaw h w"] | None = None,
) -> Float[Array, " yaw"]:
    """Return the largest correlation of each template with a frame, over all positions (eq. 4).

    Args:
        image: The frame (range, beam), finite where measured.
        bank: Templates (yaw, h, w), or a record with `.templates` and optionally `.spectra` (see `prepare_bank`).
        mask: True for the pixels that count (range, beam); None for all.
        min_valid: A window scores 0 if less than this share of the template's pixels was measured.
        template_mask: True for the pixels of each template that count (yaw, h, w); None for all.

    Returns:
        Scores (yaw,) from -1 to 1.

    Raises:
        SonarjaxError: Shapes do not fit, a measured pixel is not finite, or something else than numbers is given.
    """
    return _match(image, bank, mask, template_mask, min_valid, _best_score)


def match_positions(
    image: Float[AnyArray, "range beam"],
    bank: Any,
    mask: Bool[AnyArray, "range beam"] | None = None,
    *,
    min_valid: float = MIN_VALID,
    template_mask: Bool[AnyArray, "yaw h w"] | None = None,
    penalise_unmeasured: bool = False,
) -> MatchPositions:
    """Return the scores of `match_bank`, and the window where each is reached (eq. 4).

    Args:
        image: The frame (range, beam), finite where measured.
        bank: As in `match_bank`.
        mask: True for the pixels that count (range, beam); None for all.
        min_valid: As in `match_bank`.
        template_mask: True for the pixels of each template that count (yaw, h, w); None for all.
        penalise_unmeasured: Count the part of a template over pixels outside `mask` as unmatched, and require that half
            of its highlight was measured. Then no template fits merely because most of it was not measured. This has no
            effect without `mask`, or with `template_mask`.

    Returns:
        `scores` (yaw,) from -1 to 1, and the top-left corner of each best window: `row` (yaw,) and `col` (yaw,).

    Raises:
        SonarjaxError: Shapes do not fit, a measured pixel is not finite, or something else than numbers is given.
    """
    return _match(image, bank, mask, template_mask, min_valid, best_position, penalise_unmeasured)


def correlation_maps(
    image: Float[AnyArray, "range beam"],
    bank: Any,
    mask: Bool[AnyArray, "range beam"] | None = None,
    *,
    min_valid: float = MIN_VALID,
    template_mask: Bool[AnyArray, "yaw h w"] | None = None,
) -> Float[Array, "yaw row col"]:
    """Return eq. 4 for each template at every window position of a frame.

    Args:
        image: The frame (range, beam), finite where measured.
        bank: As in `match_bank`.
        mask: True for the pixels that count (range, beam); None for all.
        min_valid: As in `match_bank`.
        template_mask: True for the pixels of each template that count (yaw, h, w); None for all.

    Returns:
        Correlations (yaw, row, col) from -1 to 1, at range − h + 1 by beam − w + 1 positions.

    Raises:
        SonarjaxError: Shapes do not fit, a measured pixel is not finite, or something else than numbers is given.
    """
    return _match(image, bank, mask, template_mask, min_valid, _complete_map)


def _match(
    image: Any,
    bank: Any,
    mask: Any,
    template_mask: Any,
    min_valid: float,
    reduce: Callable[..., Any],
    penalise_unmeasured: bool = False,
) -> Any:
    image = image if isinstance(image, jax.Array) else image_array(image, "image")
    image, templates = jnp.asarray(image, jnp.float32), _templates(bank)
    shape = tuple(image.shape)
    check_shapes(templates.shape, shape)
    mask = None if mask is None else _as_mask("mask", mask, shape)
    check_finite(image, mask, "image")
    if template_mask is not None:
        template_mask = _as_mask("template_mask", template_mask, tuple(templates.shape))
        valid = jnp.ones(shape, bool) if mask is None else mask
        return _match_weighted(image, templates, valid, template_mask, min_valid, reduce)
    spectra = getattr(bank, "spectra", None)
    if spectra is not None and (spectra.yaw_count, *spectra.template_shape) != templates.shape[-3:]:
        raise SonarjaxError("bank: its spectra are of other templates: make them anew with `prepare_bank`")
    if spectra is None or spectra.image_shape != shape or (mask is not None and spectra.squares is None):
        spectra = _spectra(templates, shape, mask is not None)
    if mask is None:
        return _match_plain(image, spectra, reduce)
    return _match_masked(image, spectra, mask, min_valid, reduce, penalise_unmeasured)


def _templates(bank: Any) -> Array:
    templates = getattr(bank, "templates", bank)
    templates = templates if isinstance(templates, jax.Array) else number_array(templates, "templates")
    return jnp.asarray(templates, jnp.float32)


def _as_mask(name: str, mask: Any, shape: tuple[int, ...]) -> Array:
    mask = jnp.asarray(mask if isinstance(mask, jax.Array) else number_array(mask, name))
    if mask.shape != shape:
        raise SonarjaxError(f"{name}: expected shape {shape}, got {mask.shape}")
    return mask.astype(bool)


@partial(jax.jit, static_argnums=(1, 2))
def _spectra(templates: Array, image_shape: tuple[int, int], masked: bool) -> TemplateSpectra:
    return template_spectra(templates, image_shape, masked=masked)


@partial(jax.jit, static_argnums=2)
def _match_plain(image: Array, spectra: TemplateSpectra, reduce: Callable[..., Any]) -> Any:
    centred = centred_frame(image)
    energy = window_moments(centred, spectra.template_shape).energy
    scale = inverse_root(energy, NEAR_CONSTANT * jnp.sum(jnp.square(centred)))
    scale = jax.lax.optimization_barrier(scale)  # keeps XLA from fusing it into the loop, anew for each chunk
    frame = frame_spectrum(centred)

    def chunk(planes: Array) -> Any:
        return reduce(correlate(frame, planes, spectra.map_shape) * scale)

    return per_template(over_chunks(chunk, spectra.planes), spectra.yaw_count)


@partial(jax.jit, static_argnums=(4, 5))
def _match_masked(
    image: Array, spectra: TemplateSpectra, mask: Array, min_valid: Any, reduce: Callable, penalise_unmeasured: bool
) -> Any:
    frame = masked_frame(image, mask, spectra.template_shape, min_valid)

    def chunk(planes: tuple[Array, Array, Array]) -> Any:
        return reduce(masked_maps(frame, *planes, penalise_unmeasured))

    return per_template(over_chunks(chunk, (spectra.planes, spectra.squares, spectra.highlights)), spectra.yaw_count)


@partial(jax.jit, static_argnums=5)
def _match_weighted(
    image: Array, templates: Array, mask: Array, template_mask: Array, min_valid: Any, reduce: Callable
) -> Any:
    weight = template_mask.astype(jnp.float32)
    unit = unit_templates(templates, weight)
    shape = (image.shape[0], image.shape[1])
    planes, squares, weights = pack(unit, shape), pack(jnp.square(unit), shape), pack(weight, shape)
    map_shape = (shape[0] - templates.shape[1] + 1, shape[1] - templates.shape[2] + 1)
    frame = weighted_frame(image, mask)
    pixels = jnp.sum(weight, axis=(1, 2))
    room = 2 * planes.shape[0] * planes.shape[1]
    pixels = jnp.pad(pixels, (0, room - pixels.shape[0])).reshape(*planes.shape[:2], 2)

    def chunk(parts: tuple[Array, Array, Array, Array]) -> Any:
        return reduce(weighted_maps(frame, *parts, map_shape, min_valid))

    return per_template(over_chunks(chunk, (planes, squares, weights, pixels)), templates.shape[0])


def per_template(chunks: Any, yaw_count: int) -> Any:
    """Join the leading axes (chunk, pair, two) of each result into one (yaw,), without the padding."""
    return jax.tree_util.tree_map(lambda x: x.reshape(-1, *x.shape[3:])[:yaw_count], chunks)


def _best_score(maps: Float[Array, "pair two row col"]) -> Float[Array, "pair two"]:
    return jnp.max(jnp.max(maps, axis=2), axis=2)  # beams last: the first maximum runs over whole vectors


def best_position(maps: Float[Array, "pair two row col"]) -> MatchPositions:
    """The best window of each template in its map (pair, two, row, col)."""
    by_col = jnp.max(maps, axis=2)
    col = jnp.argmax(by_col, axis=2)  # one axis at a time: over both at once XLA's CPU code is ten times slower
    column = jnp.take_along_axis(maps, col[:, :, None, None], axis=3)[..., 0]
    return MatchPositions(jnp.max(by_col, axis=2), jnp.argmax(column, axis=2), col)


def _complete_map(maps: Float[Array, "pair two row col"]) -> Float[Array, "pair two row col"]:
    return maps
