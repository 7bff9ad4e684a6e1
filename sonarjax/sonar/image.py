"""The check that a frame fits its sonar, which everything that recognizes frames makes first."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.sonar.model import Sonar

UNMEASURED = 0.5
"""Grey of pixels that were not measured."""


def checked_image(
    image: Any, mask: Any, sonar: Sonar, name: str = "image"
) -> tuple[Float[np.ndarray, "range beam"], Bool[np.ndarray, "range beam"] | None]:
    """Take a frame and its mask as arrays, and check that they fit the sonar.

    Args:
        image: Frame (range, beam), finite where it was measured.
        mask: True where a pixel was measured (range, beam); None means everywhere.
        sonar: The sonar that took it.
        name: What messages call the frame.

    Returns:
        The frame (range, beam), grey where it was not measured, and the mask (range, beam) or None.

    Raises:
        SonarjaxError: A shape does not fit, or a measured pixel is not finite.
    """
    image = np.asarray(image, np.float32)
    if image.shape != sonar.shape:
        raise SonarjaxError(f"{name}: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    mask = None if mask is None else np.asarray(mask, bool)
    if mask is not None and mask.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {mask.shape}")
    if not np.isfinite(image if mask is None else image[mask]).all():
        raise SonarjaxError(f"{name}: holds NaN or infinite values")
    return (image if mask is None else np.where(mask, image, UNMEASURED).astype(np.float32)), mask
