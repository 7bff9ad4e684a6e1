"""The check that a frame fits its sonar, which everything that recognizes frames makes first."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, image_array, number_array
from sonarjax.sonar.model import Sonar

NOT_FINITE = "holds NaN or infinite values where it was measured (a mask says where)"
"""What an error says about pixels that are not finite."""
UNMEASURED = 0.5
"""Grey of pixels that were not measured."""
BEYOND = 1.0
"""Values up to this far outside [0, 1] may come of noise that was added; beyond it, the image has another scale."""


def checked_image(
    image: Any, mask: Any, sonar: Sonar, name: str = "image"
) -> tuple[Float[np.ndarray, "range beam"], Bool[np.ndarray, "range beam"] | None]:
    """Take a frame and its mask as arrays, and check that they fit the sonar.

    Args:
        image: Frame (range, beam) in [0, 1] where it was measured; elsewhere it may hold anything.
        mask: True where a pixel was measured (range, beam), in at least one; None means everywhere.
        sonar: The sonar that took it.
        name: What messages call the frame.

    Returns:
        The frame (range, beam), grey where it was not measured, and the mask (range, beam) or None.

    Raises:
        SonarjaxError: The image is none of numbers, a shape does not fit, nothing was measured, or a measured pixel is
            not finite or lies far outside [0, 1]; or `sonar` is no `Sonar`.
    """
    check_kind(sonar, Sonar, "sonar")
    image = np.asarray(image_array(image, name), np.float32)
    if image.shape != sonar.shape:
        raise SonarjaxError(f"{name}: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    mask = None if mask is None else np.asarray(number_array(mask, "mask"), bool)
    if mask is not None and mask.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {mask.shape}")
    if mask is not None and not mask.any():
        raise SonarjaxError("mask: expected at least one pixel that was measured, all are False")
    check_values(image if mask is None else image[mask], name)
    return (image if mask is None else np.where(mask, image, UNMEASURED).astype(np.float32)), mask


def check_finite(image: Any, mask: Any, name: str) -> None:
    """Raise a SonarjaxError if a measured pixel of an image is NaN or infinite.

    Traced images and masks pass, because their values are not known. Arrays of an accelerator are copied to the host.

    Args:
        image: The image, or several, of numbers.
        mask: True where a pixel was measured, in the image's shape; None means everywhere.
        name: What the message calls the image.

    Raises:
        SonarjaxError: A measured pixel is not finite.
    """
    if isinstance(image, jax.core.Tracer) or isinstance(mask, jax.core.Tracer):
        return
    finite = np.isfinite(np.asarray(image))
    if not finite.all() and (mask is None or not finite[np.asarray(mask) > 0].all()):
        raise SonarjaxError(f"{name}: {NOT_FINITE}")


def check_values(values: Float[np.ndarray, "*pixel"], name: str) -> None:
    """Raise a SonarjaxError for values that are not finite or far outside [0, 1], and for labels 0, 1, 2.

    Both extremes of values with a NaN are NaN.
    """
    low, high = float(values.min()), float(values.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        raise SonarjaxError(f"{name}: {NOT_FINITE}")
    if high > 1 and np.array_equal(values, np.round(values)) and high <= 1 + BEYOND:
        raise SonarjaxError(
            f"{name}: expected values in [0, 1], got whole numbers from {low:g} to {high:g}: labels? In a semantic map "
            "shadow is 0, background 0.5, highlight 1"
        )
    if low < -BEYOND or high > 1 + BEYOND:
        hint = "; divide 8-bit values by 255" if low >= 0 and 2 < high <= 255 else ""
        raise SonarjaxError(f"{name}: expected values in [0, 1], got {low:g} to {high:g}{hint}")
