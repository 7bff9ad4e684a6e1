"""`refine_pose`: leaning and lifted objects on labels, error bars, what no frame can tell, and what it refuses."""

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sonarjax as sj
from sonarjax.refine.free import ALL, wrapped
from sonarjax.refine.template import VIEWS, Subject, draw, layers_with_slope, nominal_law, paint_with_slope
from sonarjax.render import Window
from sonarjax.render.region import leaning_room
from tests.refine.engines import Optimised

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
GREY = np.array([0.5, 1.0, 0.0], np.float32)
COUNT = 4
CONFIG = sj.RefineConfig(polish=0)
MESH = sj.objects.target()
ENGINE = Optimised()
OFF = np.array([math.radians(8), 0.02, 0.02, 0.02, math.radians(6), math.radians(6)])
UNITS = dict(zip(ALL, ("rad", "m", "m", "m", "rad", "rad"), strict=True))


def numbers(pose):
    """(..., 6) in the order of ALL."""
    return np.stack([np.asarray(getattr(pose, name)) for name in ALL], axis=-1)


def as_pose(values):
    return sj.Pose(**{name: values[..., k] for k, name in enumerate(ALL)})


def rotation(pose):
    yaw, _, _, _, roll, pitch = numbers(pose).T
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))


def pick(pose, index):
    return jax.tree.map(lambda v: v[index], pose)


@pytest.fixture(scope="module")
def truth():
    """Leaning by up to 12° and up to 5 cm above the floor."""
    rng = np.random.default_rng(11)
    lean = math.radians(12)
    low, high = [0, 2.25, -0.15, 0, -lean, -lean], [2 * math.pi, 2.35, 0.15, 0, lean, lean]
    values = rng.uniform(low, high, (COUNT, 6))
    for one in values:
        one[3] = rng.uniform(0, 0.05) - min(0.0, np.asarray(as_pose(one).to_ground(MESH.vertices))[:, 2].min())
    return as_pose(values.astype(np.float32))


@pytest.fixture(scope="module")
def start(truth):
    return as_pose((numbers(truth) + np.random.default_rng(1).uniform(-1, 1, (COUNT, 6)) * OFF).astype(np.float32))


@pytest.fixture(scope="module")
def frames(truth):
    return jax.jit(lambda poses: sj.render(MESH, poses, SONAR, quality=sj.RenderQuality(4)))(truth)


@pytest.fixture(scope="module")
def size(start):
    return sj.plan_refinement(MESH, SONAR, start, CONFIG, ALL)


def test_a_leaning_pose_is_found_on_labels(truth, start, frames, size):
    found = sj.refine_pose(
        GREY[np.asarray(frames.labels())], MESH, SONAR, start, free=ALL, config=CONFIG, window=size, engine=ENGINE
    )
    angle = np.degrees((rotation(truth).inv() * rotation(found.pose)).magnitude())
    away = np.linalg.norm(numbers(found.pose)[:, 1:4] - numbers(truth)[:, 1:4], axis=1)
    print(f"\nrotation {angle.round(2)}°, place {(1000 * away).round(2)} mm")
    assert angle.max() < 0.6 and away.max() < 2e-3
    assert np.asarray(found.converged).all() and np.asarray(found.observable).all()
    assert found.free == ALL and found.std.shape == (COUNT, 6) and found.covariance.shape == (COUNT, 6, 6)
    assert (np.asarray(found.pose.yaw) >= 0).all() and (np.asarray(found.pose.yaw) < 2 * math.pi).all()
    assert (np.diff(np.asarray(found.singular_values), axis=-1) <= 0).all()
    assert (np.asarray(found.score) > np.asarray(found.start_score)).all()


@pytest.mark.slow
def test_standard_deviations_are_those_of_many_noisy_frames(truth, frames, size):
    """White noise on one frame: how the solutions scatter, against what each says of itself."""
    config, image = replace(CONFIG, sharpness=0.0, blurs=(0.5, 0.3)), np.asarray(frames.semantic())[0]
    noise = np.random.default_rng(5).normal(0, 0.1, (24, *image.shape)).astype(np.float32)
    there = jax.tree.map(lambda v: np.full(24, np.asarray(v)[0], np.float32), truth)
    found = sj.refine_pose(image + noise, MESH, SONAR, there, free=ALL, config=config, window=size, engine=ENGINE)
    values = numbers(found.pose)
    values[:, 0] = (values[:, 0] - float(truth.yaw[0]) + np.pi) % (2 * np.pi)
    scatter, said = values.std(axis=0, ddof=1), np.sqrt((np.asarray(found.std) ** 2).mean(axis=0))
    print(f"\nscatter {scatter}, said {said}, ratio {scatter / said}")
    assert (scatter / said > 0.5).all() and (scatter / said < 2.0).all()
    # Which numbers err together is said too.
    between = np.corrcoef(values.T)
    mean = np.asarray(found.covariance).mean(axis=0)
    expected = mean / np.sqrt(np.outer(np.diag(mean), np.diag(mean)))
    strong = np.abs(expected) > 0.6
    assert strong.sum() > 6 and (np.sign(between[strong]) == np.sign(expected[strong])).all()


def test_nothing_is_guessed_of_an_even_image(start, size):
    found = sj.refine_pose(
        np.full(SONAR.shape, 0.5, np.float32),
        MESH,
        SONAR,
        pick(start, 0),
        free=ALL,
        config=CONFIG,
        window=size,
        engine=ENGINE,
    )
    assert not np.asarray(found.observable).any()
    np.testing.assert_allclose(numbers(found.pose)[1:], numbers(pick(start, 0))[1:])
    assert np.isfinite(numbers(found.pose)).all() and not np.isnan(np.asarray(found.std)).any()


@pytest.mark.slow
def test_yaw_of_a_solid_of_revolution_stays_at_its_start_and_is_flagged():
    cylinder, at = sj.objects.concrete_cylinder(), sj.Pose(2.3, 0.05, 0.0)
    image = GREY[np.asarray(sj.render(cylinder, at, SONAR).labels())]
    start = sj.Pose(2.32, 0.04, 0.7)
    found = sj.refine_pose(image, cylinder, SONAR, start, free=("y", "x", "yaw"), config=CONFIG)
    assert found.free == ("yaw", "x", "y")
    np.testing.assert_array_equal(found.observable, [False, True, True])
    assert float(found.pose.yaw) == pytest.approx(0.7, abs=1e-6)
    assert abs(float(found.pose.x) - 2.3) < 3e-3 and abs(float(found.pose.y) - 0.05) < 3e-3
    assert bool(found.converged)
    # Of the yaw nothing is known but its bounds: a uniform variate's deviation.
    assert float(found.std[0]) == pytest.approx(2 * CONFIG.bounds[0] / math.sqrt(12), rel=1e-4)
    assert float(found.std[1:].max()) < 5e-3


@pytest.mark.slow
@pytest.mark.computes
def test_refine_yaw_is_its_first_case():
    poses = sj.Pose(np.array([2.3, 2.25]), np.array([0.05, -0.1]), np.array([0.4, 4.0]))
    images = GREY[np.asarray(sj.render(MESH, poses, SONAR).labels())]
    start = replace(poses, yaw=poses.yaw + 0.1, x=poses.x + 0.01)
    window = sj.plan_refinement(MESH, SONAR, start, CONFIG)
    how = {"config": CONFIG, "window": window, "engine": ENGINE}
    alone, found = sj.refine_yaw(images, MESH, SONAR, start, **how), sj.refine_pose(images, MESH, SONAR, start, **how)
    for name in ("yaw", "x", "y"):
        np.testing.assert_allclose(getattr(found.pose, name), getattr(alone, name), atol=1e-6)
    np.testing.assert_allclose(found.std[:, 0], alone.yaw_std, rtol=1e-3)
    for name in ("score", "start_score", "converged"):
        np.testing.assert_allclose(getattr(found, name), getattr(alone, name), atol=1e-6)
    assert np.asarray(found.observable).all()


@pytest.mark.slow
@pytest.mark.parametrize("template", ["semantic", "echo"])
def test_derivatives_of_the_template_against_central_differences(truth, template):
    """By each of the six numbers, blurred as the solver sees them."""
    from scipy.ndimage import gaussian_filter

    window, pose = Window(0, 16, (512, 64)), pick(truth, 1)
    subject = Subject(
        MESH, SONAR, pose, window, jnp.float32(0), jnp.int32(VIEWS[template]), nominal_law(), sj.RenderQuality(), ALL
    )
    at = jnp.array([0.0] * 6 + [0.2, 0.3])
    slope = jax.jit(lambda step: paint_with_slope(subject, *layers_with_slope(subject, step), step[6:])[1])(at)
    drawn = jax.jit(lambda step: draw(subject, step))
    # The semantic image is a share of each pixel, rough where short steps move an edge by less than a pixel; the echo
    # is the fourth root of an energy that is narrow in range, and a face that leans shows it in single bins.
    angle, length, limit = (1.5e-3, 5e-4, 0.55) if template == "echo" else (6e-3, 1.5e-3, 0.25)
    for k, name in enumerate(ALL):
        moved = (angle if UNITS[name] == "rad" else length) * jnp.eye(8)[k]
        expected = gaussian_filter(np.asarray((drawn(at + moved) - drawn(at - moved)) / (2 * moved[k])), (2.0, 0.8))
        ours = gaussian_filter(np.asarray(slope[k]), (2.0, 0.8))
        off, size = np.linalg.norm(ours - expected) / np.linalg.norm(expected), (ours * expected).sum()
        print(f"{template}, {name}: {off:.3f} off, {size / (expected**2).sum():.3f} times as large")
        assert off < limit and size / (expected**2).sum() == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_the_derivative_of_a_refined_lift_is_how_it_moves(truth, frames, size):
    """By the image, along the difference to that of an object lifted a little more: the implicit derivative."""
    config = sj.RefineConfig(blurs=(2.0, 0.8), polish=20, sharpness=0.0)
    pose = pick(truth, 0)
    image = np.asarray(frames.semantic())[0]
    along = np.asarray(sj.render(MESH, replace(pose, z=pose.z + 0.01), SONAR, quality=sj.RenderQuality(4)).semantic())

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def lift(share):
        moved = image + share * (along - image)
        estimate = sj.refine_pose(moved, MESH, SONAR, pose, free=("x", "z", "pitch"), config=config, window=size)
        return estimate.pose.z, estimate.determined

    (_, determined), found = lift(0.0)
    assert bool(determined)
    wanted = (float(lift(0.2)[0][0]) - float(lift(-0.2)[0][0])) / 0.4
    print(f"\nimplicit {found:.5f}, differences {wanted:.5f}")
    assert found == pytest.approx(wanted, rel=0.25)


def test_room_for_a_leaning_object_holds_all_of_it(truth):
    for k in range(COUNT):
        pose = pick(truth, k)
        room = leaning_room(MESH, float(pose.z), abs(float(pose.roll)), abs(float(pose.pitch)))
        placed = np.asarray(replace(pose, x=jnp.zeros(()), y=jnp.zeros(())).to_ground(MESH.vertices))
        assert np.hypot(placed[:, 0], placed[:, 1]).max() <= float(room.radius)
        assert placed[:, 2].max() <= float(room.top)
    hung = MESH.with_vertices(MESH.vertices - jnp.array([0.0, 0.0, MESH.top]))  # its origin at the top
    standing = float(leaning_room(MESH, 0.0, 0.5, 0.0).radius)
    assert float(leaning_room(hung, float(MESH.top), 0.5, 0.0).radius) == pytest.approx(standing, rel=1e-5)
    flat = leaning_room(MESH, 0.0, 0.0, 0.0)
    assert float(flat.radius) == float(MESH.radius) and float(flat.top) == float(MESH.top)


def test_yaws_are_wrapped_to_less_than_a_full_circle():
    yaw = np.float32([-1e-8, -0.5, 0.0, 7.0, 2 * math.pi])
    for array in (np, jnp):
        found = np.asarray(wrapped(array.asarray(yaw)), float)
        assert (found >= 0).all() and (found < 2 * math.pi).all()
        np.testing.assert_allclose(np.sin(found), np.sin(yaw), atol=1e-6)


@pytest.mark.parametrize("free", [(), ("yaw", "tilt"), ("x", "x"), "height"])
def test_free_numbers_that_do_not_exist_are_refused(free):
    image = np.zeros(SONAR.shape, np.float32)
    with pytest.raises(sj.SonarjaxError, match="free: expected names .*: yaw, x, y, z, roll, pitch"):
        sj.refine_pose(image, MESH, SONAR, sj.Pose(2.3), free=free)


def test_shapes_and_bounds_that_do_not_fit_are_refused():
    with pytest.raises(sj.SonarjaxError, match="image: expected shape"):
        sj.refine_pose(np.zeros((3, 4), np.float32), MESH, SONAR, sj.Pose(2.3), free=ALL)
    with pytest.raises(sj.SonarjaxError, match="start: expected one pose"):
        sj.refine_pose(np.zeros(SONAR.shape, np.float32), MESH, SONAR, sj.Pose(np.full((2, 3), 2.3)), free=ALL)
    with pytest.raises(sj.SonarjaxError, match="lean_bounds: expected three positive numbers"):
        sj.RefineConfig(lean_bounds=(0.1, 0.0, 0.1))
