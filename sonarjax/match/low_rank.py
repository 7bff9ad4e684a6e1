"""Eq. 4 for banks of many templates: one for all yaws is of low rank, so a few components stand for all of them.

Takes a bank (template, h, w), returns a `LowRankBank`; a frame is then matched with its components, and the templates'
maps are their combinations; `scores_at` then takes eq. 4 itself where each fits best. Optional, for speed: `match_bank`
needs none of it. A truncated SVD of the unit templates
(Eckart & Young 1936) is found by subspace iteration (Halko, Martinsson & Tropp 2011) from evenly chosen templates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.match.masked import NEAR_CONSTANT
from sonarjax.match.ncc import AnyArray, MatchPositions, PreparedBank, correlation_maps, prepare_bank
from sonarjax.match.spectra import check_shapes, inverse_root, unit_templates
from sonarjax.records import record

PASSES, SPARE = 3, 8
"""Subspace iterations, and how many more directions they carry than are kept."""
CHUNK = 36
"""Templates whose maps are combined at once: they stay in the processor's cache."""


@record
class LowRankBank:
    """A bank as combinations of a few components."""

    components: PreparedBank
    """Orthonormal templates (component, h, w) of mean 0, with their spectra."""
    coefficients: Float[Array, "*batch template component"]
    """Each unit template's share of each component."""
    residual: Float[Array, "*batch template"]
    """Norm of what the components leave of each unit template: no correlation is off by more."""


def low_rank_bank(bank: Any, image_shape: tuple[int, int], rank: int) -> LowRankBank:
    """`bank` (its `.templates` (template, h, w)) by `rank` components, for frames of `image_shape` (range, beam).

    Raises SonarjaxError for a rank below 1, or where a template is larger than the frame.
    """
    templates = jnp.asarray(getattr(bank, "templates", bank), jnp.float32)
    check_shapes(templates.shape, image_shape)
    found = factors(np.asarray(unit_templates(templates)), rank)
    components = prepare_bank(found.components, image_shape)
    return LowRankBank(components, jnp.asarray(found.coefficients), jnp.asarray(found.residual))


class Factors(NamedTuple):
    """Unit templates as combinations of a few components."""

    components: Float[np.ndarray, "component h w"]
    """Orthonormal."""
    coefficients: Float[np.ndarray, "template component"]
    """Each template's share of each component."""
    residual: Float[np.ndarray, " template"]
    """Norm of what the components leave of each template."""


def factors(unit: Float[np.ndarray, "template h w"], rank: int) -> Factors:
    """`unit` templates (template, h, w) by `rank` components, or fewer where they are of lower rank.

    Raises SonarjaxError for a rank below 1.
    """
    if rank < 1:
        raise SonarjaxError(f"rank: expected 1 or more components, got {rank}")
    flat = unit.reshape(len(unit), -1)
    basis = _leading(flat, min(rank, *flat.shape))
    coefficients = flat @ basis.T
    # No template is taken out of the large array as a whole: its part in the components is orthogonal to the rest.
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
    """Approximate scores (template,) of eq. 4 of `image` (range, beam), and the corner of each one's best window.

    A score is off by at most the template's `residual`, by Cauchy and Schwarz: a window has norm 1 in eq. 4.
    Raises SonarjaxError where shapes do not fit.
    """
    image = jnp.asarray(image, jnp.float32)
    check_shapes(low_rank.components.templates.shape, image.shape)
    return _match(image, low_rank)


@jax.jit
def _match(image: Array, low_rank: LowRankBank) -> MatchPositions:
    return combined(correlation_maps(image, low_rank.components), low_rank.coefficients)


def combined(
    maps: Float[Array, "component row col"], coefficients: Float[Array, "template component"]
) -> MatchPositions:
    """The best window of each template, whose map combines the components' `maps` (component, row, col)."""
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
    """Eq. 4 itself of each template of `bank` (template, h, w) in its own window of `image` (range, beam).

    After `match_low_rank`: a template's largest score (template,) is no less than this, and no more than what was found
    plus the template's `residual`. Raises SonarjaxError where shapes do not fit.
    """
    image, templates = jnp.asarray(image, jnp.float32), jnp.asarray(getattr(bank, "templates", bank), jnp.float32)
    check_shapes(templates.shape, image.shape)
    if places.row.shape != templates.shape[:1]:
        raise SonarjaxError(f"places: expected one for each of {len(templates)} templates, got {places.row.shape}")
    return _scores_at(image, templates, places)


@jax.jit
def _scores_at(image: Array, templates: Array, places: MatchPositions) -> Array:
    centred = image - jnp.mean(image)
    floor = NEAR_CONSTANT * jnp.sum(jnp.square(centred))

    def one(item: tuple[Array, Array, Array]) -> Array:
        unit, row, column = item
        window = jax.lax.dynamic_slice(centred, (row, column), unit.shape)
        window = window - jnp.mean(window)
        return jnp.sum(unit * window) * inverse_root(jnp.sum(jnp.square(window)), floor)

    return jax.lax.map(one, (unit_templates(templates), places.row, places.col))
