"""`checked_image`: which grey values a frame may have, and where."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io import SonarjaxError
from sonarjax.sonar import Sonar, checked_image

SONAR = Sonar.preset("didson-hf", n_ranges=8, azimuth=np.linspace(-0.2, 0.2, 4))
EVEN = np.full((8, 4), 0.5, np.float32)


def test_noise_may_leave_the_grey_values():
    image = EVEN.copy()
    image[0, :2] = -0.2, 1.3
    found, mask = checked_image(image, None, SONAR)
    np.testing.assert_array_equal(found, image)
    assert mask is None


@pytest.mark.parametrize("odd", [np.nan, np.inf, -1.5, 255.0])
def test_only_measured_pixels_must_be_grey_values(odd):
    image, mask = EVEN.copy(), np.ones((8, 4), bool)
    image[2, 1], mask[2, 1] = odd, False
    found, _ = checked_image(image, mask, SONAR)
    np.testing.assert_array_equal(found, EVEN)
    with pytest.raises(SonarjaxError, match="image: (holds NaN|expected values in)"):
        checked_image(image, None, SONAR)


@pytest.mark.parametrize("kind", [lambda v: v, np.float64, np.ndarray.tolist, lambda v: jnp.asarray(v, jnp.bfloat16)])
def test_any_array_of_numbers_will_do(kind):
    found, _ = checked_image(kind(EVEN), np.ones((8, 4), int), SONAR)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, EVEN)


def test_stored_levels_are_to_be_divided():
    with pytest.raises(SonarjaxError, match=r"image: expected values in \[0, 1\], got 7 to 255; divide 8-bit .* 255"):
        checked_image(np.linspace(7, 255, 32).astype(np.uint8).reshape(8, 4), None, SONAR)


def test_something_must_have_been_measured():
    with pytest.raises(SonarjaxError, match="mask: expected at least one pixel"):
        checked_image(EVEN, np.zeros((8, 4), bool), SONAR)
