"""`recognize` with a semantic map of one's own."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.io import SonarjaxError
from sonarjax.recognize import MAP_REFINEMENT
from sonarjax.segment import load_segmenter

# Few beams and a short window, so that few banks are rendered.
AZIMUTH = np.radians((np.arange(24) - 11.5) * 29 / 24).astype(np.float32)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20), azimuth=AZIMUTH, n_ranges=96, range_min=2.0, range_max=3.0)


@pytest.fixture(scope="module")
def mesh():
    return sj.objects.target()


@pytest.fixture(scope="module")
def image(mesh):
    """A noisy frame (range, beam)."""
    clean = np.asarray(sj.render(mesh, sj.Pose(2.3, 0.05, 0.8), SONAR).semantic())
    return np.clip(clean + np.random.default_rng(0).normal(0.0, 0.1, clean.shape), 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize(
    ("masked", "refine"),
    [
        (False, None),
        pytest.param(True, None, marks=pytest.mark.slow),
        pytest.param(False, MAP_REFINEMENT, marks=pytest.mark.slow),
    ],
)
def test_a_segmenter_s_own_map_gives_what_the_segmenter_gives(image, mesh, masked, refine):
    mask = np.ones(SONAR.shape, bool)
    mask[:10] = False
    mask = mask if masked else None
    recognizer = sj.Recognizer(mesh, SONAR, segmenter="otsu", refine=refine)
    by_name = recognizer(image, mask, threshold=0.5)
    filled = image if mask is None else np.where(mask, image, np.float32(0.5))
    given = recognizer(image, mask, semantic=load_segmenter("otsu").semantic(filled, mask), threshold=0.5)
    assert given.segmenter == "given"
    for name in (field.name for field in fields(given) if field.name != "segmenter"):
        np.testing.assert_array_equal(getattr(given, name), getattr(by_name, name), err_msg=name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda made: made[:-1], "semantic: expected shape"),
        (lambda made: np.full_like(made, np.nan), "semantic: holds NaN"),
    ],
)
def test_a_map_that_cannot_be_used_is_named(image, mesh, change, said):
    with pytest.raises(SonarjaxError, match=said):
        sj.recognize(image, mesh, SONAR, semantic=change(image), threshold=0.5)


def test_a_map_needs_a_threshold(image, mesh):
    with pytest.raises(SonarjaxError, match="threshold: expected a number"):
        sj.recognize(image, mesh, SONAR, semantic=image)
