"""`refine_yaw`: how near it comes on labels, several starts, masks, error bars and what it refuses."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.refine.objective import make_blur, normalised
from sonarjax.refine.template import labelled
from tests.refine.engines import Optimised

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
GREY = np.array([0.5, 1.0, 0.0], np.float32)
COUNT = 8
CONFIG = sj.RefineConfig()
SIZE = sj.plan_refinement(sj.objects.target(), SONAR, sj.Pose(2.3), CONFIG)  # one for all, so that all share a compile


def refine(image, mesh, start, mask=None, config=CONFIG, engine=Optimised()):  # noqa: B008
    return sj.refine_yaw(image, mesh, SONAR, start, mask=mask, config=config, window=SIZE, engine=engine)


@pytest.fixture(scope="module")
def scene():
    """(mesh, grey label frames, poses (frame, 3) as yaw, x, y)."""
    rng = np.random.default_rng(3)
    poses = rng.uniform([0, 2.25, -0.15], [2 * math.pi, 2.35, 0.15], (COUNT, 3)).astype(np.float32)
    mesh = sj.objects.target()

    @jax.jit
    def labels(poses):
        return jax.lax.map(
            lambda p: sj.render(mesh, sj.Pose(p[1], p[2], p[0]), SONAR, quality=sj.RenderQuality(4)).labels(), poses
        )

    return mesh, GREY[np.asarray(labels(poses))], poses


def near(poses, seed, shape=()):
    rng = np.random.default_rng(seed)
    moved = poses.T.reshape(3, -1, *(1,) * len(shape)) + rng.uniform(-1, 1, (3, len(poses), *shape)) * np.array(
        [math.radians(10), 0.02, 0.02]
    ).reshape(3, 1, *(1,) * len(shape))
    yaw, x, y = moved.astype(np.float32)
    return sj.Pose(x, y, yaw)


def pick(pose, index):
    return jax.tree.map(lambda v: v[index], pose)


def yaw_error_deg(found, true):
    return np.degrees(np.abs((np.asarray(found) - true + np.pi) % (2 * np.pi) - np.pi))


def test_labels_give_the_yaw_to_a_fraction_of_a_degree(scene):
    mesh, images, poses = scene
    found = refine(images, mesh, near(poses, 0))
    error = yaw_error_deg(found.yaw, poses[:, 0])
    print(f"\nyaw error: median {np.median(error):.3f}°, largest {error.max():.3f}°")
    assert error.max() < 1.0 and np.median(error) < 0.3
    assert np.hypot(found.x - poses[:, 1], found.y - poses[:, 2]).max() < 4e-3
    assert np.asarray(found.converged).all()
    assert (np.asarray(found.yaw) >= 0).all() and (np.asarray(found.yaw) < 2 * math.pi).all()
    assert (np.asarray(found.score) > 0.9).all()
    std = np.degrees(np.asarray(found.yaw_std))
    print(f"error / yaw_std, RMS: {np.sqrt((error**2).mean() / (std**2).mean()):.2f}")
    assert 0.4 < np.sqrt((error**2).mean() / (std**2).mean()) < 2.5


def test_several_starts_keep_their_axis_and_a_batch_equals_single_frames(scene):
    mesh, images, poses = scene
    starts = near(poses[:2], 1, (2,))
    many = refine(images[:2], mesh, starts)
    assert many.yaw.shape == many.score.shape == (2, 2)
    for frame in range(2):
        single = refine(images[frame], mesh, pick(starts, frame))
        np.testing.assert_allclose(single.yaw, many.yaw[frame], atol=1e-4)
    assert refine(images[0], mesh, pick(starts, (0, 0))).yaw.shape == ()


class Watching(Optimised):
    """An engine that notes what decides compiled code."""

    def __init__(self):
        self.seen = set()

    def run(self, function, *args, **static):
        leaves, tree = jax.tree.flatten(args)
        self.seen.add((function, str(tree), tuple(np.shape(v) for v in leaves), tuple(sorted(static.items(), key=str))))
        return super().run(function, *args, **static)


def test_batches_of_any_size_and_configs_of_all_numbers_share_compiled_code(scene):
    mesh, images, poses = scene
    engine = Watching()
    for count in (1, 2):
        refine(images[:count], mesh, near(poses[:count], 5), engine=engine)
    refine(images[0], mesh, pick(near(poses[:2], 5, (2,)), 0), engine=engine)
    other = replace(CONFIG, bounds=(0.1, 0.05, 0.04), blurs=(4.0, 1.0, 0.5), iterations=2, polish=1, sharpness=0.0)
    refine(images[0], mesh, pick(near(poses[:2], 5), 0), config=replace(other, margin=(8, 2)), engine=engine)
    refine(images[0], mesh, pick(near(poses[:2], 5), 0), config=replace(other, template="echo"), engine=engine)
    assert len(engine.seen) == 1


def test_what_is_masked_does_not_count(scene):
    mesh, images, poses = scene
    mask = np.ones(images[0].shape, bool)
    mask[:, : images.shape[2] // 2 - 4] = False
    spoiled = np.where(mask, images[0], np.random.default_rng(0).random(mask.shape)).astype(np.float32)
    start = pick(near(poses, 2), 0)
    clean = refine(images[0], mesh, start, mask)
    for hidden in (spoiled, np.where(mask, spoiled, np.nan)):
        found = refine(hidden, mesh, start, mask)
        np.testing.assert_allclose(found.yaw, clean.yaw, atol=1e-6)
        np.testing.assert_allclose(found.score, clean.score, atol=1e-6)


def test_with_a_mask_the_images_offset_does_not_count_either(scene):
    mesh, images, poses = scene
    image, start = images[3], pick(near(poses, 2), 3)
    mask = np.ones(image.shape, bool)
    mask[:, int(np.median(np.nonzero(image == 0)[1])) :] = False  # from the middle of the shadow on
    plain, bright = (refine(image + np.float32(offset), mesh, start, mask) for offset in (0.0, 5.0))
    assert yaw_error_deg(plain.yaw, poses[3, 0]) < 0.5
    np.testing.assert_allclose(bright.yaw, plain.yaw, atol=2e-4)
    np.testing.assert_allclose(bright.score, plain.score, atol=1e-4)


def test_bounds_hold_and_are_reported(scene):
    mesh, images, poses = scene
    start = sj.Pose(float(poses[0, 1]), float(poses[0, 2]), float(poses[0, 0]) + 0.2)
    found = refine(images[0], mesh, start, config=replace(CONFIG, bounds=(0.05, 0.01, 0.01)))
    assert abs((float(found.yaw) - float(start.yaw) + np.pi) % (2 * np.pi) - np.pi) <= 0.05 + 1e-5
    assert not bool(found.converged) and not bool(found.determined)


def test_nothing_converges_on_a_constant_frame(scene):
    mesh, _, poses = scene
    found = refine(np.full(SONAR.shape, 0.5, np.float32), mesh, pick(near(poses, 0), 0))
    assert not found.converged and found.score == 0


def test_the_start_is_judged_too(scene):
    mesh, images, poses = scene
    found = refine(images[0], mesh, pick(near(poses, 0), 0))
    assert float(found.start_score) < float(found.score)
    true = sj.Pose(poses[0, 1], poses[0, 2], poses[0, 0])
    assert float(refine(images[0], mesh, true).start_score) == pytest.approx(float(found.score), abs=0.02)
    assert found.pose.shape == () and float(found.pose.yaw) == float(found.yaw)


@pytest.mark.slow
def test_without_polishing_it_is_as_good_but_nothing_is_determined(scene):
    mesh, images, poses = scene
    found = refine(images[:3], mesh, near(poses[:3], 0), config=replace(CONFIG, polish=0))
    assert yaw_error_deg(found.yaw, poses[:3, 0]).max() < 1.0
    assert not np.asarray(found.determined).any()


@pytest.mark.slow
def test_inside_jit_as_outside(scene):
    mesh, images, poses = scene
    start = pick(near(poses, 4), 1)
    small = SONAR.replace(azimuth=SONAR.azimuth[24:72])  # tracing hides the start: the window is the whole frame
    image = images[1][:, 24:72]
    plain = replace(CONFIG, polish=0)
    traced = jax.jit(lambda image, start: sj.refine_yaw(image, mesh, small, start, config=plain).yaw)(image, start)
    np.testing.assert_allclose(traced, sj.refine_yaw(image, mesh, small, start, config=plain).yaw, atol=2e-3)
    # Only the shape of the object is traced, and there are several starts.
    two = jax.tree.map(lambda v: np.full(2, v, np.float32), start)
    assert jax.eval_shape(lambda mesh: sj.refine_yaw(image, mesh, small, two).yaw, mesh).shape == (2,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros((3, 4), np.float32)}, "image: expected shape"),
        ({"mask": np.ones((3, 4), bool)}, "mask: expected the image's shape"),
        ({"start": sj.Pose(np.full(3, 2.3), np.zeros((2, 3)), np.zeros(3))}, "start: expected one pose"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    given = {"image": np.zeros(SONAR.shape, np.float32), "start": sj.Pose(2.3, 0.0, 0.0)} | change
    mesh = sj.objects.brick()
    with pytest.raises(sj.SonarjaxError, match=message):
        sj.refine_yaw(given.pop("image"), mesh, SONAR, given.pop("start"), **given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds": (0.1, 0.0, 0.1)}, "bounds: expected three positive"),
        ({"blurs": ()}, "blurs: expected positive"),
        ({"blurs": (math.nan,)}, "blurs: expected positive"),
        ({"iterations": 0}, "iterations: expected a whole number of 1 or more"),
        ({"polish": -1}, "polish"),
    ],
)
def test_configs_that_no_search_can_have_are_refused(change, message):
    with pytest.raises(sj.SonarjaxError, match=message):
        sj.RefineConfig(**change)


@pytest.mark.parametrize("change", [{"template": "intensity"}, {"bounds": (0.1, 0.1)}])
def test_configs_of_the_wrong_kind_are_refused(change):
    with pytest.raises((sj.SonarjaxError, TypeError)):  # TypeError: where annotations are checked, they speak first
        sj.RefineConfig(**change)


def test_blur_keeps_a_constant_and_spreads_as_scipy_does():
    from scipy.ndimage import gaussian_filter1d

    image = np.random.default_rng(1).random((64, 24)).astype(np.float32)
    blurred = make_blur((64, 24), 3.0)(jnp.asarray(image))
    expected = gaussian_filter1d(gaussian_filter1d(image, 3.0, axis=0, truncate=6), 1.2, axis=1, truncate=6)
    np.testing.assert_allclose(blurred[8:24, 6:18], expected[16:48:2, 6:18], atol=2e-3)
    np.testing.assert_allclose(make_blur((64, 24), 8.0)(jnp.ones((64, 24))), 1.0, atol=1e-5)


def test_labelled_shares():
    share = jnp.linspace(0, 1, 11)
    np.testing.assert_allclose(labelled(share, jnp.float32(0.0)), share)
    sharp = labelled(share, jnp.float32(10.0))
    np.testing.assert_allclose(sharp[jnp.array([0, 5, 10])], [0, 0.5, 1], atol=1e-6)
    np.testing.assert_allclose(sharp + sharp[::-1], 1.0, atol=1e-6)
    assert float(sharp[3]) < 0.3 < 0.7 < float(sharp[7])
    assert np.isfinite(jax.grad(lambda k: labelled(share, k).sum())(0.0))


def test_normalised_image_has_unit_norm_over_what_was_measured():
    rng = np.random.default_rng(2)
    image, weight = jnp.asarray(rng.random((6, 5)), jnp.float32), jnp.asarray(rng.random((6, 5)) < 0.7, jnp.float32)
    out = normalised(image, weight)
    assert float((out * weight).sum()) == pytest.approx(0, abs=1e-5)
    assert float((out**2).sum()) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(normalised(jnp.full((6, 5), 0.3), weight), 0.0, atol=1e-3)


def test_a_margin_leaves_out_what_lies_far_from_the_start(scene):
    """A bright wall in the window pulls at the estimate; with a margin around the template it cannot."""
    mesh, images, poses = scene
    wall = images.copy()
    row = int((math.hypot(2.3, 0.9) - float(SONAR.range_min)) / float(SONAR.range_bin))
    wall[:, row - 80 : row - 60] = 1.0  # 0.3 m before the object's middle
    start = near(poses, 1)
    free, boxed, clean = (
        refine(frames, mesh, start, config=replace(CONFIG, margin=margin, blurs=(4.0, 2.0, 0.8)))
        for frames, margin in ((wall, None), (wall, (12, 3)), (images, (12, 3)))
    )
    np.testing.assert_allclose(boxed.yaw, clean.yaw, atol=1e-4)
    assert yaw_error_deg(boxed.yaw, poses[:, 0]).max() < 1.0
    assert np.median(yaw_error_deg(free.yaw, poses[:, 0])) > np.median(yaw_error_deg(boxed.yaw, poses[:, 0]))
