"""Several views of one standing object: frames of the sonars, the joint solution, and what is refused."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sonarjax as sj
from sonarjax.refine import in_common, in_view
from sonarjax.refine.free import ALL
from sonarjax.refine.views import turned

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
MESH = sj.objects.target()
GREY = np.array([0.5, 1.0, 0.0], np.float32)
TRUTH = sj.Pose(2.3, 0.1, 0.9, 0.05, math.radians(9.0), math.radians(-6.0))
SONARS = np.array([(0.0, 0.0, 0.0), (2.4, -2.2, math.pi / 2)])
SONAR_POSES = sj.Pose(SONARS[:, 0], SONARS[:, 1], SONARS[:, 2])


def numbers(pose):
    return np.array([np.asarray(getattr(pose, name)) for name in ALL], float)


def test_a_pose_in_a_view_is_the_same_points_seen_from_there():
    for sonar in np.array([(0.3, -1.2, 0.7), (2.4, -2.2, math.pi / 2)]):
        there = in_view(TRUTH, sonar)
        expected = np.asarray(TRUTH.to_ground(MESH.vertices)) - [sonar[0], sonar[1], 0.0]
        expected = Rotation.from_euler("z", -sonar[2]).apply(expected)
        np.testing.assert_allclose(there.to_ground(MESH.vertices), expected, atol=1e-5)
        np.testing.assert_allclose(numbers(in_common(there, sonar)), numbers(TRUTH), atol=1e-5)


def test_derivatives_in_a_view_are_central_differences():
    sonar, step = np.array([0.3, -1.2, 0.7]), 1e-2
    for k, name in enumerate(ALL):
        ahead, behind = (replace(TRUTH, **{name: getattr(TRUTH, name) + s}) for s in (step, -step))
        slope = (numbers(in_view(ahead, sonar)) - numbers(in_view(behind, sonar))) / (2 * step)
        np.testing.assert_allclose(turned(sonar[2])[:, k], slope, atol=1e-3)


@pytest.mark.slow
def test_two_views_give_the_pose_on_labels():
    config = sj.RefineConfig(polish=0, iterations=6)
    poses = [in_view(TRUTH, one) for one in SONARS]
    images = np.stack(
        [GREY[np.asarray(sj.render(MESH, p, SONAR, quality=sj.RenderQuality(4)).labels())] for p in poses]
    )
    away = np.array([[0.1, 0.015, -0.015, 0.015, -0.08, 0.08], [-0.1, -0.01, 0.02, -0.01, 0.08, 0.06]])
    start = sj.Pose(
        *(float(getattr(TRUTH, n)) + away[:, ALL.index(n)] for n in ("x", "y", "yaw", "z", "roll", "pitch"))
    )
    both = sj.refine_pose(images, MESH, SONAR, start, free=ALL, config=config, sonar_poses=SONAR_POSES)
    assert both.score.shape == (2,) and both.covariance.shape == (2, 6, 6) and both.free == ALL
    assert np.asarray(both.converged).all() and np.asarray(both.observable).all()
    assert not np.asarray(both.determined).any()
    assert (np.asarray(both.score) > np.asarray(both.start_score)).all()
    # A third sonar, which looks the other way, changes nothing.
    away = sj.Pose(*np.vstack([SONARS, (0.0, 0.0, math.pi)]).T)
    frames = np.concatenate([images, np.full((1, *SONAR.shape), 0.5, np.float32)])
    three = sj.refine_pose(frames, MESH, SONAR, start, free=ALL, config=config, sonar_poses=away)
    np.testing.assert_allclose(numbers(three.pose), numbers(both.pose), atol=1e-5)
    np.testing.assert_allclose(three.std, both.std, rtol=1e-3)
    assert np.asarray(three.converged).all()
    for k in range(2):
        pose = jax.tree.map(lambda v, k=k: v[k], both.pose)
        turn = np.asarray(pose.rotation()).T @ np.asarray(TRUTH.rotation())
        assert math.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.4
        assert np.linalg.norm((numbers(pose) - numbers(TRUTH))[1:4]) < 1e-3


@pytest.mark.slow
def test_two_views_with_white_noise_know_more_than_one():
    """White noise: what two views tell adds up, so that no number is known worse."""
    config = sj.RefineConfig(polish=0, iterations=6, sharpness=0.0, blurs=(1.0, 0.5))
    clean = np.stack([np.asarray(sj.render(MESH, in_view(TRUTH, one), SONAR).semantic()) for one in SONARS])
    images = clean + np.random.default_rng(2).normal(0, 0.1, clean.shape).astype(np.float32)
    both = sj.refine_pose(images, MESH, SONAR, TRUTH, free=ALL, config=config, sonar_poses=SONAR_POSES)
    alone = sj.refine_pose(images[0], MESH, SONAR, TRUTH, free=ALL, config=config)
    share = np.asarray(both.std) / np.asarray(alone.std)
    print(f"\nstandard deviations of two views over those of one {share.round(2)}")
    assert share.max() < 1.3 and share.mean() < 0.85  # each is itself an estimate from some 25 beams


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros(SONAR.shape, np.float32)}, "image: expected shape"),
        ({"sonar_poses": sj.Pose(np.zeros(3))}, "sonar_poses: expected one pose for each of 2 views"),
        (
            {"sonar_poses": sj.Pose(np.full(2, 448251.3))},
            "sonar_poses: expected x and y from -10000 to 10000 m, got 4482",
        ),
        ({"sonar_poses": sj.Pose(np.full(2, np.nan))}, "sonar_poses: expected x and y from .* got nan"),
        ({"sonar_poses": sj.Pose(np.zeros(2), roll=0.1)}, "sonar_poses: expected z, roll and pitch of 0"),
        ({"start": sj.Pose(np.zeros((2, 2)))}, "start: expected one pose or one axis"),
        ({"mask": np.ones((2, 3), bool)}, "mask: expected the images' shape"),
    ],
)
def test_views_that_do_not_fit_are_refused(change, message):
    given = {"image": np.zeros((2, *SONAR.shape), np.float32), "start": TRUTH, "sonar_poses": SONAR_POSES} | change
    with pytest.raises(sj.SonarjaxError, match=message):
        sj.refine_pose(given.pop("image"), MESH, SONAR, given.pop("start"), free=ALL, **given)


def test_views_cannot_be_traced():
    images = np.zeros((2, *SONAR.shape), np.float32)
    with pytest.raises(sj.SonarjaxError, match="sonar_poses: expected no traced values"):
        jax.eval_shape(lambda v: sj.refine_pose(v, MESH, SONAR, TRUTH, sonar_poses=SONAR_POSES).score, images)
