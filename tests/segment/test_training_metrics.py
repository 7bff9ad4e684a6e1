"""Metrics against scikit-image and counts made by hand."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from skimage.metrics import contingency_table, peak_signal_noise_ratio

from sonarjax.segment.metrics import confusion, iou, psnr


def test_confusion_is_scikit_images(rng):
    truth, predicted = (rng.integers(0, 3, (5, 32, 24)).astype(np.uint8) for _ in range(2))
    found = confusion(jnp.asarray(predicted), jnp.asarray(truth))
    wanted = contingency_table(truth.reshape(5, -1), predicted.reshape(5, -1)).toarray()
    np.testing.assert_array_equal(found, wanted)


def test_iou_is_intersection_over_union(rng):
    truth, predicted = (rng.integers(0, 3, (4, 32, 24)).astype(np.uint8) for _ in range(2))
    found = iou(confusion(jnp.asarray(predicted), jnp.asarray(truth)))
    wanted = [((truth == k) & (predicted == k)).sum() / ((truth == k) | (predicted == k)).sum() for k in range(3)]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_iou_of_what_is_nowhere_is_one():
    nothing = jnp.zeros((1, 8, 8), jnp.uint8)
    np.testing.assert_array_equal(iou(confusion(nothing, nothing)), [1, 1, 1])
    np.testing.assert_array_equal(iou(confusion(nothing + jnp.uint8(2), nothing)), [0, 1, 0])


def test_psnr_is_scikit_images(rng):
    truth, image = (rng.random((3, 32, 24), np.float32) for _ in range(2))
    wanted = [peak_signal_noise_ratio(t, i, data_range=1.0) for t, i in zip(truth, image, strict=True)]
    np.testing.assert_allclose(psnr(jnp.asarray(image), jnp.asarray(truth)), wanted, rtol=1e-5)


def test_psnr_of_equals_is_finite():
    assert float(psnr(jnp.ones((4, 4)), jnp.ones((4, 4)))) == pytest.approx(100.0)
