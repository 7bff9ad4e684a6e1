"""All segmenters by name: the shipped pix2pix network and the classical baselines."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.classical import CLASSICAL, from_grey, threshold_labels, to_grey
from sonarjax.segment.weights import load_generator
from sonarjax.segment.whole import segment_frame

SEGMENTERS = ("pix2pix", *CLASSICAL)
"""Names that `segment` and `semantic_map` know."""
DEFAULT_SEGMENTER = "pix2pix"
"""What `recognize` and the command line use unless told otherwise."""


def segment(
    image: Float[np.ndarray, "range beam"], name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> UInt8[np.ndarray, "range beam"]:
    """Labels (range, beam) of a grey frame: 0 background, 1 highlight, 2 shadow; pixels outside `mask` are background.

    `pix2pix` is the shipped network, the others are thresholds; `help(sonarjax.segment)` says what each name stands
    for. Raises SonarjaxError for an unknown name, or a network that cannot be loaded.
    """
    check_segmenter(name)
    if name != "pix2pix":
        return threshold_labels(image, name, mask)
    return from_grey(segment_frame(load_generator(), image, mask))


def semantic_map(
    image: Float[np.ndarray, "range beam"], name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> Float[np.ndarray, "range beam"]:
    """What is matched (range, beam): shadow 0, background 0.5, highlight 1; a network's doubts lie between them.

    `none` gives the grey frame itself. Raises SonarjaxError as `segment` does.
    """
    check_segmenter(name)
    if name == "none":
        return image
    return segment_frame(load_generator(), image, mask) if name == "pix2pix" else to_grey(segment(image, name, mask))


def check_segmenter(name: str) -> None:
    """Raises SonarjaxError when there is no segmenter of that name."""
    if name not in SEGMENTERS:
        raise SonarjaxError(f"segmenter: expected one of {', '.join(SEGMENTERS)}, got {name!r}")
