"""`recognize` with a semantic map of one's own, with a map of no use, and with a rule."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.engine import PLAIN
from sonarjax.io import SonarjaxError
from sonarjax.refine import ERROR_BAR, MAP_REFINEMENT
from sonarjax.segment import EVIDENCE, IdentificationRule, Segmenter, load_segmenter

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
    ("segmenter", "masked", "refine"),
    [
        ("otsu", False, None),
        pytest.param("otsu", True, None, marks=pytest.mark.slow),
        pytest.param("none", False, MAP_REFINEMENT, marks=pytest.mark.slow),
    ],
)
def test_a_segmenter_s_own_map_gives_what_the_segmenter_gives(image, mesh, segmenter, masked, refine):
    """All but the score and what error bars make of it, since a map of one's own has no rule, and `agree`, since the
    frame itself is not matched.
    """
    mask = np.ones(SONAR.shape, bool)
    mask[:10] = False
    mask = mask if masked else None
    recognizer = sj.Recognizer(mesh, SONAR, segmenter=segmenter, refine=refine)
    by_name = recognizer(image, mask, threshold=0.5)
    filled = image if mask is None else np.where(mask, image, np.float32(0.5))
    given = recognizer(image, mask, semantic=load_segmenter(segmenter).semantic(filled, mask), threshold=0.5)
    assert given.agree is None
    assert given.segmenter == "given" and given.score == given.score_bank
    for name in {field.name for field in fields(given)} - {"segmenter", "score", "agree", "yaw_std", "hypotheses"}:
        np.testing.assert_array_equal(getattr(given, name), getattr(by_name, name), err_msg=name)
    assert [replace(h, yaw_std=None) for h in given.hypotheses] == [
        replace(h, yaw_std=None) for h in by_name.hypotheses
    ]
    if refine is not None:
        known, drop = np.array([given.evidence["curvature_std"]]), given.evidence["frame_drop"]
        assert given.yaw_std == pytest.approx(ERROR_BAR.std(known, drop))


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


class Blind(Segmenter):
    """A segmenter that sees nothing but noise."""

    def semantic(self, image, mask=None, engine=PLAIN):
        return np.random.default_rng(1).random(image.shape, np.float32)


@pytest.mark.slow
def test_where_the_map_is_of_no_use_the_frame_itself_gives_the_yaw(image, mesh):
    result = sj.Recognizer(mesh, SONAR, segmenter=Blind("blind", 0.5))(image)
    assert math.degrees(abs(result.yaw - 0.8)) < 2 < math.degrees(abs(result.yaw_bin - 0.8))
    assert set(EVIDENCE) < set(result.evidence)
    assert result.evidence["frame_peak"] > result.score_bank
    assert result.agree is False


@pytest.mark.slow
def test_a_rule_weighs_the_evidence_and_its_threshold_decides(image, mesh):
    rule = IdentificationRule((1.0,) * len(EVIDENCE), -2.0, 0.3, 0.1)
    result = sj.Recognizer(mesh, SONAR, segmenter=replace(load_segmenter("none"), rule=rule))(image)
    odds = sum(result.evidence[name] for name in EVIDENCE) - 2.0
    assert result.score == pytest.approx(1 / (1 + math.exp(-odds)))
    assert result.threshold == 0.3 and result.identified == (result.score >= 0.3)
    known, drop = np.array([result.evidence["curvature_std"]]), result.evidence["frame_drop"]
    assert result.yaw_std == pytest.approx(ERROR_BAR.std(known, drop, result.score))
