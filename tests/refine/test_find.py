"""`PoseFinder`: a leaning, lifted object from nothing, in one clean frame and in two."""

import math

import jax
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.refine import POSE_ERROR_BAR, in_view
from sonarjax.refine.find import distinct, kept

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
MESH = sj.objects.target()
TRUTH = sj.Pose(2.25, 0.08, 3.7, 0.06, math.radians(11.0), math.radians(-8.0))


def turned_deg(pose):
    turn = np.asarray(pose.rotation()).T @ np.asarray(TRUTH.rotation())
    return math.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))


def away(pose):
    return math.dist(*([float(getattr(one, name)) for name in ("x", "y", "z")] for one in (pose, TRUTH)))


@pytest.mark.slow
@pytest.mark.computes
def test_a_leaning_object_is_found_from_nothing():
    """The semantic image is matched and refined as it is, without a segmenter."""
    sonars = np.array([(0.0, 0.0, 0.0), (2.3, -2.2, math.pi / 2)])
    images = np.stack([np.asarray(sj.render(MESH, in_view(TRUTH, one), SONAR).semantic()) for one in sonars])
    lean = sj.LeanSearchConfig(yaw_bins=18, lifts=(0.03,), candidates=3)
    finder = sj.PoseFinder(MESH, SONAR, segmenter="none", lean=lean)
    alone = [finder(image) for image in images]
    best = jax.tree.map(lambda v: v[0], alone[0].pose)
    assert turned_deg(best) < 1.0 and away(best) < 5e-3
    assert (np.diff(np.asarray(alone[0].score)) <= 1e-6).all()
    finder.error_bar = None
    plain = finder(images[0])
    widened = POSE_ERROR_BAR.covariance(np.asarray(plain.covariance), np.asarray(plain.observable), plain.free)
    np.testing.assert_allclose(alone[0].covariance, widened, rtol=1e-4, atol=1e-12)
    finder.error_bar = POSE_ERROR_BAR
    both = finder.views(images, sj.Pose(*sonars.T), alone)
    best = jax.tree.map(lambda v: v[0], both.pose)
    assert turned_deg(best) < 0.5 and away(best) < 2e-3


def test_views_take_one_estimate_each():
    finder = sj.PoseFinder(MESH, SONAR, free=("yaw", "x", "y"), segmenter="none")
    with pytest.raises(sj.SonarjaxError, match="alone: expected one estimate for each of 2 views, got 1"):
        finder.views(np.full((2, *SONAR.shape), 0.5), sj.Pose(x=[0.0, 1.0]), [made([0.0], [0.5])])


def made(yaws, scores):
    yaws = np.asarray(yaws, np.float32)
    count, scores = len(yaws), jax.device_put(np.asarray(scores, np.float32))
    flags = jax.device_put(np.zeros(count, bool))
    return sj.PoseEstimate(
        sj.Pose(yaw=yaws), jax.device_put(np.zeros((count, 3, 3), np.float32)), scores, scores + 0.1, flags, flags,
        jax.device_put(np.ones((count, 3), bool)), jax.device_put(np.ones((count, 3), np.float32)),
    )  # fmt: skip


def test_poses_that_are_the_same_count_once():
    found = made([0.0, 0.01, 3.0, 2 * math.pi - 0.01, 3.3], [0.5, 0.7, 0.6, 0.65, 0.1])
    assert distinct(found, math.radians(5.0), 5).tolist() == [1, 2, 4]
    assert distinct(found, math.radians(5.0), 2).tolist() == [1, 2]
    assert distinct(found, math.radians(20.0), 5).tolist() == [1, 2]


def test_a_pose_that_neither_settled_nor_fits_better_is_not_kept():
    found = made([1.0, 2.0], [0.5, 0.6])  # both score less than their start, neither converged
    start = sj.Pose(yaw=np.array([0.1, 0.2]))
    np.testing.assert_allclose(kept(found, start).yaw, [0.1, 0.2])


def test_what_cannot_be_free_is_refused():
    with pytest.raises(sj.SonarjaxError, match="free: expected names"):
        sj.PoseFinder(MESH, SONAR, free=("yaw", "heave"))


@pytest.mark.parametrize(
    ("image", "mask", "words"),
    [((4, 4), None, "image: expected shape"), (SONAR.shape, (4, 4), "mask: expected the image's shape")],
)
def test_a_frame_of_another_shape_is_refused(image, mask, words):
    finder = sj.PoseFinder(MESH, SONAR, segmenter="otsu")
    with pytest.raises(sj.SonarjaxError, match=words):
        finder(np.zeros(image), None if mask is None else np.ones(mask, bool))
