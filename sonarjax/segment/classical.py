"""Classical segmentation: Otsu's thresholds on the grey frame (Otsu 1979), by scikit-image."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from skimage.filters import median as median_filter
from skimage.filters import threshold_multiotsu, threshold_otsu

CLASSICAL = ("none", "otsu", "otsu1", "otsu3", "median-otsu")
"""Names that `threshold_labels` knows."""
MEDIANS = {"otsu": 3, "median-otsu": 5}
"""Side of the median filter before the thresholds [pixel]."""
GREY = np.array([0.5, 1.0, 0.0], np.float32)
"""Grey value of each label: background, highlight, shadow."""


def threshold_labels(
    image: Float[np.ndarray, "range beam"], name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> UInt8[np.ndarray, "range beam"]:
    """Labels (range, beam) of a grey frame: 0 background, 1 highlight, 2 shadow; pixels outside `mask` are background.

    `otsu1` is Otsu's one threshold: highlight above it, no shadow. `otsu3` puts his two thresholds on the frame, `otsu`
    on its 3 × 3 median, `median-otsu` on its 5 × 5 median: highlight above the upper one, shadow at or below the lower.
    `none` cuts the frame at 1/4 and 3/4. Otsu's thresholds are those of the pixels inside `mask`; where these have
    one grey value (for two thresholds: two), all is background.
    """
    image = np.asarray(image, np.float32)
    measured = np.ones(image.shape, bool) if mask is None else np.asarray(mask, bool)
    if name in MEDIANS:
        image = median_filter(image, np.ones((MEDIANS[name], MEDIANS[name])))
    low, high = _thresholds(image[measured], name)
    labels = np.where(image > high, 1, np.where(image <= low, 2, 0))
    return np.where(measured, labels, 0).astype(np.uint8)


def to_grey(labels: Any) -> Float[np.ndarray, "*batch range beam"]:
    """Labels (range, beam), or a stack of such, as grey images: shadow 0, background 0.5, highlight 1."""
    return GREY[np.asarray(labels)]


def from_grey(grey: Any) -> Any:
    """Labels of a grey map of any shape, of NumPy or JAX: highlight above 3/4, shadow below 1/4, else background.

    Where a network doubts between background and another class this is the likelier one; where between highlight and
    shadow, it is background.
    """
    return ((grey > 0.75) + 2 * (grey < 0.25)).astype(np.uint8)


def _thresholds(values: Float[np.ndarray, " pixel"], name: str) -> tuple[float, float]:
    if name == "none":
        return 0.25, 0.75
    return _one_threshold(values) if name == "otsu1" else _two_thresholds(values)


def _one_threshold(values: Float[np.ndarray, " pixel"]) -> tuple[float, float]:
    lowest, highest = float(values.min()), float(values.max())
    return lowest - 1.0, float(threshold_otsu(values)) if highest > lowest else highest


def _two_thresholds(values: Float[np.ndarray, " pixel"]) -> tuple[float, float]:
    if len(np.unique(values)) < 3:
        return float(values.min()) - 1.0, float(values.max())
    low, high = threshold_multiotsu(values, classes=3)
    return float(low), float(high)
