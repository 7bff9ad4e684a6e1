"""Classical segmentation: Otsu's thresholds on the grey frame (Otsu 1979), by scikit-image."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from skimage.filters import median as median_filter
from skimage.filters import threshold_multiotsu

from sonarjax.io.errors import SonarjaxError

SEGMENTERS = ("none", "otsu")
GREY = np.array([0.5, 1.0, 0.0], np.float32)
"""Grey value of each label: background, highlight, shadow."""


def segment(
    image: Float[np.ndarray, "range beam"], name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> UInt8[np.ndarray, "range beam"]:
    """Labels (range, beam) of a grey frame: 0 background, 1 highlight, 2 shadow; pixels outside `mask` are background.

    `otsu` puts Otsu's two thresholds on the 3 × 3 median of the frame; `none` cuts the frame at 1/4 and 3/4.
    Raises SonarjaxError for an unknown name.
    """
    check_segmenter(name)
    image = np.asarray(image, np.float32)
    measured = np.ones(image.shape, bool) if mask is None else np.asarray(mask, bool)
    low, high = (0.25, 0.75) if name == "none" else (0.0, 1.0)
    if name == "otsu":
        image = median_filter(image, np.ones((3, 3)))
        low, high = _two_thresholds(image[measured])
    labels = np.where(image > high, 1, np.where(image <= low, 2, 0))
    return np.where(measured, labels, 0).astype(np.uint8)


def check_segmenter(name: str) -> None:
    """Raises SonarjaxError when there is no segmenter of that name."""
    if name not in SEGMENTERS:
        raise SonarjaxError(f"segmenter: expected one of {', '.join(SEGMENTERS)}, got {name!r}")


def to_grey(labels: Any) -> Float[np.ndarray, "range beam"]:
    """Labels (range, beam) as one grey image: shadow 0, background 0.5, highlight 1."""
    return GREY[np.asarray(labels)]


def _two_thresholds(values: Float[np.ndarray, " pixel"]) -> tuple[float, float]:
    if len(np.unique(values)) < 3:
        return float(values.min()) - 1.0, float(values.max())
    low, high = threshold_multiotsu(values, classes=3)
    return float(low), float(high)
