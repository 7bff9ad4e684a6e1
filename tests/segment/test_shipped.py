"""The shipped network on frames of an object that it was never trained on."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.io.safetensors import read_safetensors
from sonarjax.segment import load_segmenter
from sonarjax.segment.metrics import confusion, iou
from sonarjax.segment.training import find_recipe
from sonarjax.segment.weights import shipped_path
from sonarjax.sensor import SensorModel, observe_scene

YAW = math.radians(40.0)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20))
POSE = sj.Pose(x=2.3, y=0.05, yaw=YAW)


@pytest.fixture(scope="module")
def scene():
    """Sonar, image (range, beam) at severity 1 and the clean frame of the target."""
    image, frame = observe_scene(sj.objects.target(), POSE, SONAR, SensorModel.nominal(), key=jax.random.key(1))
    return SONAR, np.asarray(image), frame


def shares(labels: np.ndarray, truth: np.ndarray) -> float:
    """Mean intersection over union of highlight and shadow."""
    return float(iou(confusion(jnp.asarray(labels), jnp.asarray(truth)))[1:].mean())


def test_the_file_says_how_it_was_made_and_is_small():
    about = read_safetensors(shipped_path())[1]
    newer = {"initial_weights": None, "pair_settings": about["recipe"]["pair_settings"] | {"varied": False}}
    assert about["recipe"] | newer == find_recipe("gpu").as_json() and about["versions"]["jax"]
    assert {"iou_mean", "psnr_gain_db"} <= set(about["metrics"]) and "run_seed" in about["recipe"]
    assert shipped_path().stat().st_size <= 15e6


@pytest.mark.slow
def test_a_noisy_frame_is_segmented_far_better_than_by_a_threshold(scene):
    _, image, frame = scene
    truth = np.asarray(frame.labels())
    network, otsu = (shares(load_segmenter(name).labels(image), truth) for name in ("pix2pix", "otsu"))
    assert network > 0.6 and network > otsu + 0.3


def test_a_rendered_map_passes_nearly_unchanged():
    """What `sonarjax render` writes is recognized by the default segmenter too."""
    frame = sj.render(sj.objects.target(), POSE, SONAR)
    found = load_segmenter().labels(np.asarray(frame.semantic()))
    assert shares(found, np.asarray(frame.labels())) > 0.85


@pytest.mark.slow
def test_the_default_recognizes_target_and_yaw(scene):
    sonar, image, _ = scene
    result = sj.recognize(image, sj.objects.target(), sonar)
    assert result.segmenter == "pix2pix" and result.identified and result.agree is True
    assert abs(math.degrees(math.remainder(result.yaw - YAW, 2 * math.pi))) < 3.0
    assert math.hypot(result.x - 2.3, result.y - 0.05) < 0.03


@pytest.mark.slow
def test_nothing_is_found_in_an_empty_tank(scene):
    sonar, _, _ = scene
    far = sj.Pose(x=50.0, y=0.0, yaw=0.0)
    image, _ = observe_scene(sj.objects.target(), far, sonar, SensorModel.nominal(), key=jax.random.key(2))
    assert (load_segmenter().labels(np.asarray(image)) > 0).mean() < 0.01
    assert not sj.recognize(np.asarray(image), sj.objects.target(), sonar, refine=None).identified
