"""Classical segmentation: Otsu's thresholds on the grey frame (Otsu 1979), by scikit-image."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from skimage.filters import median as median_filter
from skimage.filters import threshold_multiotsu, threshold_otsu

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import number_array

CLASSICAL = ("none", "otsu", "otsu1", "otsu3", "median-otsu")
"""Names that `threshold_labels` knows."""
THRESHOLDS = {"none": 0.513, "otsu": 0.594, "otsu1": 0.428, "otsu3": 0.445, "median-otsu": 0.608}
"""Least score of an identified target for each name, from the validation frames of experiments/fit_threshold.py."""
MEDIANS = {"otsu": 3, "median-otsu": 5}
"""Side of the median filter that is applied before the thresholds [pixels]."""
GREY = np.array([0.5, 1.0, 0.0], np.float32)
"""Grey value of each label: background, highlight, shadow."""
HISTOGRAM_BINS = 256
"""Number of bins of the histogram on which Otsu's thresholds are found."""


def threshold_labels(
    image: Float[np.ndarray, "range beam"], name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> UInt8[np.ndarray, "range beam"]:
    """Labels (range, beam) of a grey frame (range, beam): 0 background, 1 highlight, 2 shadow.

    `otsu1` uses Otsu's single threshold: highlight above it, no shadow. `otsu3` uses his two thresholds on the frame,
    `otsu` on its 3 × 3 median and `median-otsu` on its 5 × 5 median: highlight above the upper one, shadow at or below
    the lower one. `none` cuts the frame at 1/4 and 3/4. Otsu's thresholds are those of the pixels inside `mask`. If
    these have a single grey value (for two thresholds: one or two), everything is background. Pixels outside `mask` may
    hold anything: median filters see them as the median of the measured pixels, which is mostly floor. They are
    background, so without a measured pixel everything is.
    """
    image = np.asarray(image, np.float32)
    measured = np.ones(image.shape, bool) if mask is None else np.asarray(mask, bool)
    if not measured.any():
        return np.zeros(image.shape, np.uint8)
    if name in MEDIANS:
        image = np.where(measured, image, np.median(image[measured]))
        image = median_filter(image, np.ones((MEDIANS[name], MEDIANS[name])))
    image = image.astype(
        np.float64
    )  # in float32 a threshold between two neighbouring values would round to one of them
    low, high = _thresholds(image[measured], name)
    labels = np.where(image > high, 1, np.where(image <= low, 2, 0))
    return np.where(measured, labels, 0).astype(np.uint8)


def to_grey(labels: Any) -> Float[np.ndarray, "*batch range beam"]:
    """Turn labels into grey images: shadow 0, background 0.5, highlight 1.

    >>> to_grey([[0, 1, 2]]).tolist()
    [[0.5, 1.0, 0.0]]

    Args:
        labels: Labels (range, beam), or a stack of them: 0 background, 1 highlight, 2 shadow.

    Returns:
        Grey images (range, beam) of the same shape.

    Raises:
        SonarjaxError: There is something else than these labels.
    """
    classes = number_array(labels, "labels")
    if classes.size and not (classes.dtype.kind in "iu" and classes.min() >= 0 and classes.max() <= 2):
        raise SonarjaxError("labels: expected whole numbers: 0 background, 1 highlight, 2 shadow")
    return GREY[classes]


def from_grey(grey: Any) -> Any:
    """Labels of a grey map of any shape, NumPy or JAX: highlight above 3/4, shadow below 1/4, else background.

    If a network hesitates between background and another class, this is the more likely of the two. If it hesitates
    between highlight and shadow, this is background.
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
    levels = np.unique(values)
    if len(levels) < 3:
        return float(levels[0]) - 1.0, float(levels[-1])
    if len(levels) == 3:  # one class each; a histogram's thresholds might lie on the wrong side of a value
        return float(levels[0]), float(levels[1])
    if np.count_nonzero(np.histogram(values, bins=HISTOGRAM_BINS)[0]) < 3:
        return _split_groups(values, float(levels[0] + levels[-1]) / 2)
    low, high = threshold_multiotsu(values, classes=3, nbins=HISTOGRAM_BINS)
    return float(low), float(high)


def _split_groups(values: Float[np.ndarray, " pixel"], middle: float) -> tuple[float, float]:
    """Two thresholds for values that lie in two narrow groups, below and above `middle`.

    In a histogram such values look like two, too few for three classes. One threshold separates the groups. The other
    is Otsu's threshold within one of them, the one where it adds more to the variance between classes.
    """
    lower, upper = values[values <= middle], values[values > middle]
    (gain, inside), (gain_upper, inside_upper) = _one_split(lower), _one_split(upper)
    border = float(lower.max())
    return (inside, border) if gain >= gain_upper else (border, inside_upper)


def _one_split(values: Float[np.ndarray, " pixel"]) -> tuple[float, float]:
    """Otsu's threshold of values, preceded by the variance between its two classes times the number of values."""
    if values.min() == values.max():
        return 0.0, float(values[0])
    threshold = float(threshold_otsu(values))
    above = values > threshold
    gap = float(values[above].mean() - values[~above].mean())
    return gap**2 * above.sum() * (~above).sum() / len(values), threshold
