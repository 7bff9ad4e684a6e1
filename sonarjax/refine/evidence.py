"""How well a refined template explains a frame: evidence for identification, besides the peak's height (eq. 5).

A threshold on a single correlation does not carry over from one device to another, because noise lowers the target's
score as much as another object does. What does carry over is whether map and frame agree on something that the template
lacks.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.records import record
from sonarjax.refine.objective import ROW_STRIDE, Blur, box_around, make_blur, normalised
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS

FINE, COARSE = 1.0, 4.0
"""Blurs [range bins] at which template and frame are compared."""
CONSTANT = 1e-6
"""A frame brought to norm 1 that varies less than this is constant up to rounding [1]."""


@record
class Evidence:
    """Numbers for or against the template. Each is a correlation or a share."""

    map_fit: Float[Array, "*batch"]
    """NCC (eq. 4) of the semantic template with the semantic map."""
    frame_fit: Float[Array, "*batch"]
    """NCC of the fitted template with the frame, both blurred by `FINE`."""
    coarse_fit: Float[Array, "*batch"]
    """The same blurred by `COARSE`, where speckle matters less."""
    unexplained: Float[Array, "*batch"]
    """Correlation between what the map shows beyond the semantic template and what the frame shows beyond the fitted
    one.

    It is near 0 for the target, whose residuals are noise, and positive if both show another object.
    """
    left_over: Float[Array, "*batch"]
    """Share of the frame's standard deviation, blurred by `COARSE`, that the template does not explain; 1 for a
    constant frame.
    """


@jax.jit
def gather_evidence(
    frame: Float[Array, "range beam"], semantic: Float[Array, "range beam"], measured: Float[Array, "range beam"],
    template: Float[Array, "range beam"], labels: Float[Array, "range beam"],
) -> Evidence:  # fmt: skip
    """Measure how well a template that was fitted to a frame explains it.

    All arguments are windows (range, beam) of one place. Only the box of `labels`, with the bank's margin, counts.

    Args:
        frame: The frame (range, beam).
        semantic: Its semantic map (range, beam).
        measured: 1 where a pixel was measured, else 0 (range, beam).
        template: The fitted template (range, beam).
        labels: The semantic template, minus the background's 0.5 (range, beam).

    Returns:
        The evidence [1], one number for each field.
    """
    inside = measured * box_around(labels, (MARGIN_BINS, MARGIN_BEAMS))
    seen, drawn = normalised(frame, inside), normalised(template, inside)
    residual = seen - (seen * drawn).sum() * drawn
    beyond = normalised(semantic - labels, inside)
    fine, coarse = (make_blur((frame.shape[0], frame.shape[1]), sigma) for sigma in (FINE, COARSE))
    varies, left = (_spread(image, inside, coarse) for image in (seen, residual))
    return Evidence(
        map_fit=(normalised(semantic, inside) * normalised(labels, inside)).sum(),
        frame_fit=_blurred_fit(seen, drawn, inside, fine),
        coarse_fit=_blurred_fit(seen, drawn, inside, coarse),
        unexplained=(beyond * normalised(residual, inside)).sum(),
        left_over=jnp.where(varies > CONSTANT, left / jnp.maximum(varies, CONSTANT), 1.0),
    )


def _blurred_fit(seen: Array, drawn: Array, inside: Array, blur: Blur) -> Float[Array, ""]:
    """NCC, after blurring, of a frame and a template of mean 0 that are 0 outside the box, so that its edge
    does not show.
    """
    rows = inside[::ROW_STRIDE]
    return (normalised(blur(seen), rows) * normalised(blur(drawn), rows)).sum()


def _spread(image: Array, inside: Array, blur: Blur) -> Float[Array, ""]:
    """Standard deviation inside the box of a blurred image that is 0 outside."""
    rows = inside[::ROW_STRIDE]
    total = jnp.maximum(rows.sum(), 1.0)
    blurred = blur(image) * rows
    centred = (blurred - blurred.sum() / total) * rows
    return jnp.sqrt((centred**2).sum() / total)
