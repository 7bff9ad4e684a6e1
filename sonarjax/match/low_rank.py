"""NCC (eq. 4) for banks of many templates: a bank over all yaws has low rank, so a few components represent it.

`low_rank_bank` turns a bank (template, h, w) into a `LowRankBank`. `match_low_rank` correlates a frame with the
components only, and combines these maps into those of the templates. `scores_at` then computes eq. 4 exactly at each
template's best position. All this is optional and only for speed; `match_bank` does without it.

The components are a truncated SVD of the unit templates (Eckart & Young 1936). It is computed by subspace iteration
(Halko, Martinsson & Tropp 2011) that starts from evenly chosen templates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import image_array
from sonarjax.match.masked import NEAR_CONSTANT
from sonarjax.match.ncc import AnyArray, MatchPositions, PreparedBank, correlation_maps, prepare_bank
from sonarjax.match.spectra import centred_frame, check_shapes, inverse_root, unit_templates
from sonarjax.records import record
from sonarjax.sonar.image import check_finite

PASSES, SPARE = 3, 8
"""Number of subspace iterations, and number of extra directions that they use beyond those that are kept."""
CHUNK = 36
"""Number of templates whose maps are combined at once, small enough for the processor's cache."""


@record
class LowRankBank:
    """A bank whose templates are linear combinations of a few components."""

    components: PreparedBank
    """Orthonormal templates (component, h, w) of mean 0, with their spectra."""
    coefficients: Float[Array, "*batch template component"]
    """Coefficient of each component in each unit template."""
    residual: Float[Array, "*batch template"]
    """Norm of what the components leave of each unit template; no correlation has a larger error."""


def low_rank_bank(bank: Any, image_shape: tuple[int, int], rank: int) -> LowRankBank:
    """Approximate a bank by a few components.

    Args:
        bank: Templates (template, h, w), or a record with `.templates`.
        image_shape: Shape (range, beam) of the frames to match.
        rank: Number of components; fewer are made if there are fewer templates or pixels than that.

    Returns:
        The `components` with their spectra, the `coefficients` (template, component) that combine them into unit
        templates, and the norm `residual` (template,) of what they leave of each template.

    Raises:
        SonarjaxError: `rank` is below 1, or the templates are larger than the frame.
    """
    templates = jnp.asarray(getattr(bank, "templates", bank), jnp.float32)
    check_shapes(templates.shape, image_shape)
    found = factors(np.asarray(unit_templates(templates)), rank)
    components = prepare_bank(found.components, image_shape)
    return LowRankBank(components, jnp.asarray(found.coefficients), jnp.asarray(found.residual))


class Factors(NamedTuple):
    """Unit templates as linear combinations of a few components."""

    components: Float[np.ndarray, "component h w"]
    """Orthonormal components."""
    coefficients: Float[np.ndarray, "template component"]
    """Coefficient of each component in each template."""
    residual: Float[np.ndarray, " template"]
    """Norm of what the components leave of each template."""


def factors(unit: Float[np.ndarray, "template h w"], rank: int) -> Factors:
    """Factor unit templates into `rank` components, or fewer if there are fewer templates or pixels than that.

    Args:
        unit: Templates (template, h, w) of norm 1.
        rank: Number of components.

    Raises:
        SonarjaxError: `rank` is below 1.
    """
    if rank < 1:
        raise SonarjaxError(f"rank: expected 1 or more components, got {rank}")
    flat = unit.reshape(len(unit), -1)
    basis = _leading(flat, min(rank, *flat.shape))
    coefficients = flat @ basis.T
    # The residual's norm follows from Pythagoras, as the components are orthonormal. This avoids another large array.
    left = np.einsum("ij,ij->i", flat, flat) - np.einsum("ij,ij->i", coefficients, coefficients)
    return Factors(basis.reshape(-1, *unit.shape[1:]), coefficients, np.sqrt(np.maximum(left, 0)))


def _leading(unit: np.ndarray, rank: int) -> np.ndarray:
    """The leading right singular vectors (rank, pixel) of `unit` (template, pixel)."""
    first = np.linspace(0, len(unit) - 1, min(rank + SPARE, *unit.shape)).astype(int)
    basis = np.linalg.qr(unit[first].T)[0]
    for _ in range(PASSES):
        basis = np.linalg.qr(unit.T @ (unit @ basis))[0]
    turned = np.linalg.svd(unit @ basis, full_matrices=False)[2]
    return np.ascontiguousarray((basis @ turned[:rank].T).T)


def match_low_rank(image: Float[AnyArray, "range beam"], low_rank: LowRankBank) -> MatchPositions:
    """Approximate eq. 4 for all templates of a low-rank bank.

    The error of a score is at most the template's `residual`. This follows from the Cauchy-Schwarz inequality, because
    windows have norm 1 in eq. 4.

    Args:
        image: The frame (range, beam).
        low_rank: The bank, from `low_rank_bank`.

    Returns:
        The best score of each template, `scores` (template,), and the corner of its best window: `row` (template,) and
        `col` (template,).

    Raises:
        SonarjaxError: The shapes do not fit, or the image is not finite numbers.
    """
    image = _numbers(image)
    check_shapes(low_rank.components.templates.shape, image.shape)
    return _match(image, low_rank)


def _numbers(image: Any) -> Array:
    """An image (range, beam) as float32. Raises SonarjaxError unless it is finite numbers."""
    given = jnp.asarray(image if isinstance(image, jax.Array) else image_array(image, "image"), jnp.float32)
    check_finite(given, None, "image")
    return given


@jax.jit
def _match(image: Array, low_rank: LowRankBank) -> MatchPositions:
    return combined(correlation_maps(image, low_rank.components), low_rank.coefficients)


@full_precision
def combined(
    maps: Float[Array, "component row col"], coefficients: Float[Array, "template component"]
) -> MatchPositions:
    """Find the best window of each template.

    Args:
        maps: Correlation maps of the components (component, row, col).
        coefficients: Coefficients (template, component) that combine these maps into those of the templates.
    """
    count, (rows, columns) = coefficients.shape[0], maps.shape[1:]
    chunks = -(-count // CHUNK)
    padded = jnp.pad(coefficients, ((0, chunks * CHUNK - count), (0, 0))).reshape(chunks, CHUNK, -1)

    def chunk(coefficients: Array) -> MatchPositions:
        scores = (coefficients @ maps.reshape(len(maps), -1)).reshape(CHUNK, rows, columns)
        by_column = jnp.max(scores, axis=1)
        column = jnp.argmax(by_column, axis=1)
        best = jnp.take_along_axis(scores, column[:, None, None], axis=2)[..., 0]
        return MatchPositions(jnp.max(by_column, axis=1), jnp.argmax(best, axis=1), column)

    found = jax.lax.map(chunk, padded)
    return MatchPositions(*(values.reshape(-1)[:count] for values in found))


def scores_at(image: Float[AnyArray, "range beam"], bank: Any, places: MatchPositions) -> Float[Array, "template"]:
    """Compute eq. 4 exactly for each template, in one given window of the frame.

    To be used after `match_low_rank`. A template's true highest score lies between this score and the approximate score
    plus the template's `residual`.

    Args:
        image: The frame (range, beam).
        bank: Templates (template, h, w), or a record with `.templates`.
        places: The window of each template, as `match_low_rank` returns them.

    Returns:
        The scores (template,).

    Raises:
        SonarjaxError: The shapes do not fit, or the image is not finite numbers.
    """
    image, templates = _numbers(image), jnp.asarray(getattr(bank, "templates", bank), jnp.float32)
    check_shapes(templates.shape, image.shape)
    if places.row.shape != templates.shape[:1]:
        raise SonarjaxError(f"places: expected one for each of {len(templates)} templates, got {places.row.shape}")
    return _scores_at(image, templates, places)


@jax.jit
def _scores_at(image: Array, templates: Array, places: MatchPositions) -> Array:
    centred = centred_frame(image)
    floor = NEAR_CONSTANT * jnp.sum(jnp.square(centred))

    def one(item: tuple[Array, Array, Array]) -> Array:
        unit, row, column = item
        window = jax.lax.dynamic_slice(centred, (row, column), unit.shape)
        window = window - jnp.mean(window)
        return jnp.sum(unit * window) * inverse_root(jnp.sum(jnp.square(window)), floor)

    return jax.lax.map(one, (unit_templates(templates), places.row, places.col))
