"""Fan pictures whose window is not published: how far off the sonar they begin is read off their straight sides."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Real
from scipy.stats import theilslopes

from sonarjax.io import FanGeometry, content_box, fit_fan

MARGIN = 5
"""Rows left out at both ends of the sides, where corners are rounded [pixels]."""


def sector_of(picture: Real[np.ndarray, "row column"], opening: float) -> FanGeometry:
    """The sector that a picture (row, column) shows above 0, `opening` [rad] wide; its largest range is taken as 1 m.

    The width between the sides grows evenly from the sonar on: where it would be 0 is the apex, and how far in front
    of it the sides begin gives the smallest range. Raises SonarjaxError for a black picture.
    """
    box = content_box((picture > 0).astype(np.uint8))  # 0 and 1: dark pixels belong to these fans too
    rows = np.arange(int(box.top), int(box.bottom))
    seen = picture[rows] > 0
    widths = seen.shape[1] - seen[:, ::-1].argmax(axis=1) - seen.argmax(axis=1)
    sides = slice(int(widths.argmax()) + MARGIN, -MARGIN)
    slope, offset, *_ = theilslopes(widths[sides], rows[sides] + 0.5)
    apex = -offset / slope
    near = (apex - box.bottom) / (apex - box.top) / math.cos(opening / 2)
    return fit_fan(box, opening, near, 1.0)
