"""What refinement minimises: 1 − NCC between the rendered window and the image, as least-squares residuals.

If both images are blurred, brought to mean 0 and scaled to unit norm, the sum of squared differences is 2·(1 − NCC). So
eq. 4 becomes a least-squares problem, for any grey image.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.exact import full_precision
from sonarjax.refine.template import Subject, draw

SMALL = 1e-9
BEAMS_PER_BIN = 0.4  # a beam is about 2.5 bins wide at the ranges of §4.1, which makes the blur round on the floor
ROW_STRIDE = 2  # every second row of a blurred image holds all its information


class Problem(NamedTuple):
    """One frame's refinement: the image, and what is rendered to fit it."""

    image: Float[Array, "range beam"]
    """The window of the frame, any grey scale."""
    weight: Float[Array, "range beam"]
    """1 where the pixel was measured, else 0."""
    subject: Subject
    """What is rendered."""
    margin: Int[Array, "2"]
    """Bins and beams around the start's template that count; larger than the window if all of it counts."""


class Blur(NamedTuple):
    """A Gaussian blur as two matrices, whose rows sum to 1."""

    along: Float[Array, "row range"]
    """Blur along range, with a row for every ROW_STRIDE-th range bin."""
    across: Float[Array, "beam beam"]
    """Blur along azimuth."""

    @full_precision
    def __call__(self, image: Float[Array, "*batch range beam"]) -> Float[Array, "*batch row beam"]:
        """Blur `image` (range, beam); give every ROW_STRIDE-th row (row, beam)."""
        return self.along @ image @ self.across.T


def make_blur(
    shape: tuple[int, int], sigma: Float[Array, ""] | float, shift: tuple[Any, Any] | Float[Array, "2"] = (0.0, 0.0)
) -> Blur:
    """The blur of a window of `shape` (range, beam) by `sigma` [range bins], round on the floor.

    It also moves what it blurs by `shift`, in range bins and beams.
    """
    rows, columns = shape

    def kernel(at: Array, size: int, sigma: Array) -> Array:
        weights = jnp.exp(-0.5 * ((at[:, None] - jnp.arange(size)) / sigma) ** 2)
        return weights / weights.sum(axis=1, keepdims=True)

    sigma = jnp.asarray(sigma, jnp.float32)
    along = kernel(jnp.arange(0, rows, ROW_STRIDE) - shift[0], rows, sigma)
    return Blur(along, kernel(jnp.arange(columns) - shift[1], columns, sigma * BEAMS_PER_BIN))


def normalised(image: Float[Array, "range beam"], weight: Float[Array, "range beam"]) -> Float[Array, "range beam"]:
    """`image` with its weighted mean removed, scaled to unit weighted norm; zero if it is constant."""
    total = jnp.maximum(weight.sum(), SMALL)
    centred = (image - (image * weight).sum() / total) * weight
    return centred / jnp.sqrt((centred**2).sum() + SMALL)


def levelled(image: Any, weight: Any, array: Any) -> Any:
    """`image` (..., range, beam) less its mean where `weight` is above 0, and 0 elsewhere, by NumPy or jax.numpy.

    A template is 0 on bare floor. Where the image is far from 0, the edge of a mask would be a step that no template
    has. What was not measured may be NaN.
    """
    measured = weight > 0
    known = array.where(measured, image, np.float32(0))
    count = array.maximum(measured.sum((-2, -1), keepdims=True), 1).astype(np.float32)
    return array.where(measured, known - known.sum((-2, -1), keepdims=True) / count, np.float32(0))


def compare(
    image: Float[Array, "range beam"], drawn: Float[Array, "range beam"], weight: Float[Array, "range beam"], blur: Blur
) -> Float[Array, " pixel"]:
    """Residuals whose squares sum to 2·(1 − NCC) of a template and the image, both blurred, where `weight` is 1."""
    rows = weight[::ROW_STRIDE]
    seen = normalised(blur(image * weight), rows)
    return (normalised(blur(drawn * weight), rows) - seen).reshape(-1)


def misfit(problem: Problem, blur: Blur, step: Float[Array, "step"], reverse: bool = False) -> Float[Array, ""]:
    """1 − NCC of the blurred images at `step` [rad, m, 1] from the start: what refinement minimises.

    With `reverse`, reverse-mode differentiation works too (see `draw`).
    """
    drawn = draw(problem.subject, step, reverse)
    return (compare(problem.image, drawn, problem.weight, blur) ** 2).sum() / 2


def crop_score(
    image: Float[Array, "range beam"],
    drawn: Float[Array, "range beam"],
    weight: Float[Array, "range beam"],
    margin: tuple[int, int] | Int[Array, "2"],
) -> Float[Array, ""]:
    """NCC (eq. 4) of a rendered template with the image, over the template's own box and a `margin` (bins, beams)."""
    inside = weight * box_around(drawn, margin)
    return (normalised(image, inside) * normalised(drawn, inside)).sum()


def box_around(
    drawn: Float[Array, "range beam"], margin: tuple[int, int] | Int[Array, "2"]
) -> Bool[Array, "range beam"]:
    """True (range, beam) in the box of what a template from `draw` shows, with a `margin` (bins, beams) around it."""
    touched = jnp.abs(drawn) > 0.01
    return _extent(touched.any(axis=1), margin[0])[:, None] & _extent(touched.any(axis=0), margin[1])


def _extent(touched: Bool[Array, "size"], margin: int | Int[Array, ""]) -> Bool[Array, "size"]:
    index = jnp.arange(len(touched))
    first = jnp.where(touched, index, len(touched)).min() - margin
    last = jnp.where(touched, index, -1).max() + margin
    return (index >= first) & (index <= last)
