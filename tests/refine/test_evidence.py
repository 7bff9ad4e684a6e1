"""Evidence for a template: what the target gives, what another object gives, and what noise does to both."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.refine import gather_evidence
from sonarjax.segment import load_segmenter

SHAPE = (96, 40)


def block(rows: slice, columns: slice, value: float) -> np.ndarray:
    image = np.zeros(SHAPE, np.float32)
    image[rows, columns] = value
    return image


LABELS = block(slice(30, 40), slice(12, 26), 0.5) + block(slice(40, 60), slice(12, 26), -0.5)
EXTRA = block(slice(34, 46), slice(24, 30), 0.5)  # of another object: beside the template's highlight


def gathered(shown: np.ndarray, noise: float, mask: np.ndarray | None = None) -> dict[str, float]:
    speckle = np.random.default_rng(4).normal(size=SHAPE)
    frame = (0.4 + 0.5 * shown + noise * speckle).astype(np.float32)
    measured = np.ones(SHAPE, np.float32) if mask is None else mask
    found = gather_evidence(*(jnp.asarray(v) for v in (frame, 0.5 + shown, measured, LABELS, LABELS)))
    return {name: float(getattr(found, name)) for name in found.__dataclass_fields__}


def test_a_perfect_match_leaves_nothing() -> None:
    found = gathered(LABELS, 0.0)
    assert found["map_fit"] == pytest.approx(1.0, abs=1e-3)
    assert found["frame_fit"] == pytest.approx(1.0, abs=1e-3) and found["coarse_fit"] == pytest.approx(1.0, abs=1e-3)
    assert found["left_over"] < 0.02 and abs(found["unexplained"]) < 0.05


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_another_object_is_seen_through_noise(noise: float) -> None:
    """The correlation falls with noise for both; what map and frame share beyond the template tells them apart."""
    own, other = gathered(LABELS, noise), gathered(LABELS + EXTRA, noise)
    assert abs(own["unexplained"]) < 0.1 < 0.25 < other["unexplained"]
    assert other["left_over"] > own["left_over"]
    assert other["map_fit"] < own["map_fit"]


def test_speckle_counts_for_less_when_blurred() -> None:
    found = gathered(LABELS, 0.3)
    assert found["coarse_fit"] > found["frame_fit"] + 0.05


def test_what_was_not_measured_does_not_count() -> None:
    mask = np.ones(SHAPE, np.float32)
    mask[:, 27:] = 0
    hidden = EXTRA * (np.arange(SHAPE[1]) >= 27)
    assert gathered(LABELS + hidden, 0.0, mask)["map_fit"] == pytest.approx(1.0, abs=1e-3)
    assert gathered(LABELS + hidden, 0.0)["map_fit"] < 0.99


def test_an_empty_template_gives_no_nan() -> None:
    nothing = jnp.zeros(SHAPE)
    found = gather_evidence(nothing + 0.3, nothing + 0.5, nothing + 1, nothing, nothing)
    assert all(np.isfinite(float(getattr(found, name))) for name in found.__dataclass_fields__)


@pytest.mark.parametrize("own_rise", [0.0, 0.3])
def test_a_constant_frame_is_left_over_whole(own_rise: float) -> None:
    """The template explains nothing of it, and the shipped rule refuses what has no other evidence."""
    frame, measured = np.full(SHAPE, 0.3, np.float32), np.ones(SHAPE, np.float32)
    little = 0.02 * np.random.default_rng(4).normal(size=SHAPE)  # what a network sees in it
    semantic = (0.5 + little).astype(np.float32)
    found = gather_evidence(*(jnp.asarray(v) for v in (frame, semantic, measured, LABELS, LABELS)))
    evidence = {name: float(getattr(found, name)) for name in found.__dataclass_fields__}
    assert evidence["left_over"] == pytest.approx(1.0, abs=1e-6)
    rule = load_segmenter().rule
    assert rule is not None
    evidence |= dict.fromkeys(("map_rise", "frame_rise", "frame_peak"), 0.01) | {"own_rise": own_rise}
    assert rule.probability(evidence) < 0.2
