"""Random crops of training frames, and the labels of what is in them."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from sonarjax.crops import LEAST, PATCH, Box, cut_box
from sonarjax.data.draws import Stream

CROP_SHARES = (0.7, 0.1, 0.08, 0.12)
"""Probability that a crop holds object and shadow with a margin, cuts off their far part, lies anywhere, or is
the complete frame.
"""
MARGIN, MARGIN_OF_FRAME = (0.0, 0.6), (0.0, 0.06)
"""Least and largest margin on each side of the object: `MARGIN` times the object's extent plus
`MARGIN_OF_FRAME` times the frame's.
"""


def cut_labels(
    highlight: Float[Array, "range beam"], shadow: Float[Array, "range beam"], box: Box, shape: tuple[int, int] = PATCH
) -> UInt8[Array, "patch_range patch_beam"]:
    """Cut the labels of a crop out of a rendered frame.

    The shares of the classes are resampled, and each pixel gets the class with the largest share. Thin highlights
    survive that nearest-neighbour sampling would skip, and edges stay smooth where pixels are stretched.

    Args:
        highlight: Highlight's share of each pixel (range, beam), as in `SonarFrame`.
        shadow: Shadow's share of each pixel's floor (range, beam), as in `SonarFrame`.
        box: The part to cut out.
        shape: Number of range bins and beams of the crop.

    Returns:
        Labels (patch_range, patch_beam): 0 background, 1 highlight, 2 shadow.
    """
    hidden = cut_box(shadow * (1 - highlight), box, shape)
    lit = cut_box(highlight, box, shape)
    return jnp.argmax(jnp.stack([1 - lit - hidden, lit, hidden]), axis=0).astype(jnp.uint8)


def touched_span(touched: Bool[Array, "pixel"]) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """First, and one past the last, of the pixels (pixel,) that are true; the full span if there are none."""
    count = len(touched)
    last = count - jnp.argmax(touched[::-1])
    return jnp.where(touched.any(), jnp.argmax(touched), 0), jnp.where(touched.any(), last, count)


def draw_box(labels: UInt8[Array, "range beam"], *, key: Array) -> Box:
    """Draw the random box of a training crop, mostly around the object in a frame.

    Most boxes hold object and shadow with a margin, some cut off their far part, lie anywhere, or are the complete
    frame (`CROP_SHARES`).

    Args:
        labels: Labels of the frame (range, beam): 0 background, 1 highlight, 2 shadow.
        key: Source of all random numbers.

    Returns:
        The box [range bins, beams].
    """
    stream = Stream(16, key=key)
    kind = stream.pick(CROP_SHARES)
    top, height = _draw_span((labels > 0).any(axis=1), LEAST[0], kind, stream)
    left, width = _draw_span((labels > 0).any(axis=0), LEAST[1], kind, stream)
    # Kind 1 cuts off part of the shadow, and sometimes part of the object.
    least = min(LEAST[0], labels.shape[0])
    shorter = jnp.maximum(height * stream.between(0.35, 0.8), least)
    return Box(top, left, jnp.where(kind == 1, shorter, height), width)


def _draw_span(touched: Bool[Array, "pixel"], least: int, kind: Array, stream: Stream) -> tuple[Array, Array]:
    """Start and length [pixels] along one axis, given the pixels on it that the object touches."""
    count = len(touched)
    first, stop = touched_span(touched)
    before, after = (
        (stop - first) * stream.between(*MARGIN) + count * stream.between(*MARGIN_OF_FRAME) for _ in range(2)
    )
    around = jnp.maximum(first - before, 0.0)
    length = stream.between(0.35, 0.9) * count
    anywhere = stream.uniform() * (count - length)
    start = jnp.stack([around, around, anywhere, jnp.zeros(())])[kind]
    ends = jnp.minimum(stop + after, count)
    length = jnp.clip(jnp.stack([ends - around, ends - around, length, jnp.full((), float(count))])[kind], least, count)
    return jnp.clip(start, 0.0, count - length), length
