"""The extents of a brick: recovered from frames, left alone where frames say too little, and bad input."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate.detect import Prepared
from sonarjax.calibrate.fit import Job, _observation, _window
from sonarjax.calibrate.parameters import SIZES, changed_mesh, resting
from sonarjax.engine import PLAIN
from sonarjax.scene.objects import BRICK_M, box
from sonarjax.sensor import SensorModel, observe_scene

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
YAWS = np.radians([10.0, 95.0, 160.0, 230.0, 310.0])
POSES = sj.Pose(2.2, 0.05, YAWS)
BLANK = np.zeros((len(YAWS), *SONAR.shape), np.float32)
DIFFERENT = BLANK + np.linspace(0, 1, len(YAWS), dtype=np.float32)[:, None, None]


def brick(size: tuple[float, ...]) -> sj.Mesh:
    return sj.Mesh.from_arrays(*box((size[0], size[1], size[2]), (0.0, 0.0, size[2] / 2)))


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    """Of a brick 12 % longer, 10 % narrower and 15 % higher than the usual one."""
    true = brick(tuple(np.array(BRICK_M) * (1.12, 0.9, 1.15)))
    model, key = SensorModel.nominal(1.0), jax.random.key(5)
    seen = [
        observe_scene(true, sj.Pose(2.2, 0.05, yaw), SONAR, model, key=jax.random.fold_in(key, k))[0]
        for k, yaw in enumerate(YAWS)
    ]
    return np.stack([np.asarray(image) for image in seen])


def test_sizes_scale_each_axis_from_the_floor_up() -> None:
    mesh = brick(BRICK_M)
    grown = changed_mesh(mesh, ("object_length", "object_height"), jnp.log(jnp.array([1.5, 2.0])))
    np.testing.assert_allclose(grown.vertices, np.asarray(mesh.vertices) * (1.5, 1.0, 2.0), rtol=1e-6)
    assert changed_mesh(mesh, ("tilt",), jnp.ones(1)) is mesh


def test_the_lowest_point_stays_where_the_pose_puts_it() -> None:
    mesh = sj.Mesh.from_arrays(*box(BRICK_M, (0.0, 0.0, 0.0)))
    grown = changed_mesh(mesh, ("object_height",), jnp.log(jnp.array([2.0])))
    half = BRICK_M[2] / 2
    np.testing.assert_allclose([grown.vertices[:, 2].min(), grown.vertices[:, 2].max()], [-half, 3 * half], rtol=1e-6)


@pytest.mark.parametrize("axis", ["object_width", "object_height"])
def test_a_lying_object_grows_from_its_lowest_side(axis) -> None:
    """It lies on its side, or stands on an edge: the lowest point stays, upright the pose does."""
    mesh = brick(BRICK_M)
    grown = changed_mesh(mesh, (axis,), jnp.log(jnp.array([1.5])))
    lying = sj.Pose(2.0, 0.1, [0.2, 0.7], z=0.03, roll=[math.pi / 2, 0.4], pitch=[0.0, 0.3])
    rested = resting(lying, mesh, grown)
    before, after = (np.asarray(p.to_ground(m.vertices)) for p, m in ((lying, mesh), (rested, grown)))
    np.testing.assert_allclose(after[..., 2].min(axis=-1), before[..., 2].min(axis=-1), atol=1e-6)
    np.testing.assert_array_equal([rested.x, rested.y], [lying.x, lying.y])
    np.testing.assert_array_equal(resting(POSES, mesh, grown).z, POSES.z)


def test_the_window_holds_an_object_that_lies_across_the_beams() -> None:
    post, pose = brick((0.08, 0.08, 0.6)), sj.Pose(2.2, 0.3, [0.0, 0.25], z=0.04, roll=math.pi / 2)
    starts = [jax.tree.map(lambda v, k=k: np.asarray(v)[k], pose) for k in range(2)]
    job = Job([], post, SONAR, ("object_height",), np.ones(1), PLAIN, print)
    size = _window(job, starts, np.zeros(1))
    for start in starts:
        seen = np.flatnonzero(np.asarray(sj.render(post, start, SONAR).highlight).any(axis=0))
        frame = Prepared(BLANK[0], None, BLANK[0])
        first = int(_observation(job, frame, start, size, np.zeros(1)).column)
        assert len(seen) > 40 and first <= seen[0] and seen[-1] < first + size.shape[1]


@pytest.mark.slow
@pytest.mark.computes
def test_the_width_of_a_box_that_lies_on_its_side() -> None:
    true, given, yaws = 0.18, 0.15, [-0.5, 0.4, 1.4]
    lying = sj.Pose(2.2, 0.05, np.array(yaws), z=given / 2, roll=math.pi / 2)
    seen = [
        observe_scene(
            brick((0.3, true, 0.2)), sj.Pose(2.2, 0.05, yaw, z=true / 2, roll=math.pi / 2), SONAR,
            SensorModel.nominal(1.0), key=jax.random.key(k),
        )[0]
        for k, yaw in enumerate(yaws)
    ]  # fmt: skip
    found = sj.fit_size(np.stack(seen), brick((0.3, given, 0.2)), SONAR, lying, free=("object_width",))
    assert found.determined["object_width"] and found.extent[1] == pytest.approx(true, rel=0.02)
    lowest = np.asarray(found.poses.to_ground(found.mesh.vertices))[..., 2].min(axis=-1)
    np.testing.assert_allclose(lowest, 0.0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.computes
def test_sides_of_a_brick_are_found_within_a_range_bin(frames) -> None:
    rng = np.random.default_rng(0)
    start = sj.Pose(2.2 + rng.normal(0, 0.01, 5), 0.05 + rng.normal(0, 0.01, 5), YAWS + rng.normal(0, 0.04, 5))
    found = sj.fit_size(frames, brick(BRICK_M), SONAR, start)
    off = found.extent - np.array(BRICK_M) * (1.12, 0.9, 1.15)
    assert found.converged and all(found.determined.values())
    assert np.abs(off).max() < float(SONAR.range_bin)
    assert (np.abs(off) < 4 * found.extent * np.array(list(found.std.values()))).all()
    yaw_off = np.degrees(np.asarray(found.poses.yaw) - YAWS)
    assert np.abs(yaw_off).max() < 4.0
    np.testing.assert_allclose(found.mesh.vertices[:, 2].min(), 0.0, atol=1e-6)  # it still stands on the floor


@pytest.mark.slow
@pytest.mark.computes
def test_what_frames_do_not_tell_better_than_the_prior_is_left_alone(frames) -> None:
    found = sj.fit_size(frames, brick(BRICK_M), SONAR, POSES, prior=dict.fromkeys(SIZES, 1e-3))
    assert not any(found.determined.values())
    np.testing.assert_array_equal(found.scale, 1.0)
    np.testing.assert_allclose(found.extent, BRICK_M, rtol=1e-5)


def other(frames: np.ndarray, poses: sj.Pose = POSES, **options: object) -> None:
    sj.fit_size(frames, brick(BRICK_M), SONAR, poses, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda: other(BLANK[:0]), "frames: expected at least one frame"),
        (lambda: other([BLANK[0], BLANK[0][:-1]], sj.Pose(2.2, 0.0, YAWS[:2])), r"frames\[1\]: expected shape"),
        (lambda: other(np.full_like(BLANK, np.nan)), r"frames\[0\]: holds NaN"),
        (lambda: other(BLANK), "frames: expected different frames"),
        (lambda: other(DIFFERENT, sj.Pose(2.2, 0.0, YAWS[:3])), "poses: expected one for"),
        (lambda: other(DIFFERENT, sj.Pose(9.0, 0.0, YAWS)), r"poses\[0\]: expected the object in view"),
        (
            lambda: sj.fit_size(DIFFERENT, sj.Mesh.from_arrays(*box(BRICK_M, (0.0, 0.0, 0.0))), SONAR, POSES),
            "mesh: expected a mesh above the floor, .* 0.0[0-9]+ m below that: move it with mesh.standing",
        ),
        (lambda: other(BLANK, free=("depth",)), "free: .*unknown 'depth'"),
        (lambda: other(BLANK, free=()), "free: expected names"),
        (lambda: other(BLANK, prior={"tilt": 0.1}), "prior: 'tilt' is not among"),
        (lambda: other(BLANK, prior={"object_width": -1.0}), "prior: object_width: expected a positive"),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_line(given, message) -> None:
    with pytest.raises(sj.SonarjaxError, match=message):
        given()
