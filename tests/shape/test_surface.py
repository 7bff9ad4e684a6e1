"""All vertices of a body: the Laplacian's closed forms, the descent on a known problem, the gradient, a whole fit."""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.engine import PLAIN
from sonarjax.render import place_window
from sonarjax.render.region import leaning_room
from sonarjax.scene import objects
from sonarjax.sensor import SensorModel, observe_scene
from sonarjax.shape import SurfaceConfig
from sonarjax.shape.surface import (
    SLACK_M,
    _begun,
    _by_vertices,
    _descend,
    _Frame,
    _touched,
    _window,
    above_floor,
    uniform_laplacian,
)

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
YAWS = np.radians([0.0, 90.0, 180.0, 270.0])
TETRAHEDRON = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])


def ball(radius: tuple[float, float, float] = (0.1, 0.1, 0.1)) -> sj.Mesh:
    vertices, faces = objects.sphere_arrays(1.0, rings=9, sectors=16)
    return sj.Mesh.from_arrays(vertices * radius, faces)


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    """Of a ball stretched by 30 % along x."""
    model, key = SensorModel.nominal(0.5), jax.random.key(2)
    poses = [sj.Pose(2.2, 0.0, yaw) for yaw in YAWS]
    true = ball((0.13, 0.1, 0.1))
    seen = [observe_scene(true, pose, SONAR, model, key=jax.random.fold_in(key, k))[0] for k, pose in enumerate(poses)]
    return np.stack([np.asarray(image) for image in seen])


def test_laplacian_is_a_vertex_less_the_mean_of_its_neighbours() -> None:
    laplacian = uniform_laplacian(TETRAHEDRON, 5)  # the last vertex is padding
    np.testing.assert_allclose(laplacian[:4, :4], (4 * np.eye(4) - 1) / 3)
    assert not laplacian[4].any()
    np.testing.assert_allclose(laplacian @ np.ones(5), 0.0, atol=1e-12)


def test_descent_finds_the_minimum_of_a_known_problem() -> None:
    """A target that is the first mesh shifted upwards: no bending, so the prior has nothing against it."""
    begin = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]) * 0.1
    wanted = begin + [0.0, 0.0, 0.02]

    def evaluate(positions: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([((positions - wanted) ** 2).sum()]), 2 * (positions - wanted)

    config = SurfaceConfig(blurs=(2.0, 1.0), iterations=60, step_m=1e-3)
    found, scores, last = _descend(evaluate, lambda at: at, begin, TETRAHEDRON, config, lambda text: None)
    np.testing.assert_allclose(found, wanted, atol=1e-3)
    assert scores[-1] > scores[0] and scores[-1] == pytest.approx(last.mean())


def test_padding_is_no_vertex() -> None:
    vertices, faces = objects.sphere_arrays(1.0, rings=9, sectors=16)
    mesh = sj.Mesh.from_arrays(vertices, faces)
    assert len(_touched(np.asarray(mesh.faces))) == len(vertices) < len(np.asarray(mesh.vertices))


def test_nothing_sinks_into_the_floor() -> None:
    def evaluate(positions: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(1), np.ones_like(positions)

    begin = np.full((4, 3), 0.003)
    config, upright = SurfaceConfig(iterations=20), partial(above_floor, poses=sj.Pose(2.2, 0.0, YAWS))
    found, _, _ = _descend(evaluate, upright, begin, TETRAHEDRON, config, lambda text: None)
    assert found[:, 2].min() == 0.0 and found[:, 0].max() < 0.0


def test_the_floor_is_where_the_poses_have_it() -> None:
    """Of a body that hangs, of one that lies, and of one that stands and lies in turn."""
    points = np.random.default_rng(0).normal(0, 0.2, (50, 3))
    hanging, lying = sj.Pose(2.2, 0.0, YAWS, z=0.15), sj.Pose(2.2, 0.0, YAWS, z=0.1, roll=math.pi / 2, pitch=0.2)
    turned = sj.Pose(2.2, 0.0, 0.3, z=[0.2, 0.1], roll=[0.0, math.pi / 2])
    for poses in (hanging, lying, turned):
        lifted = above_floor(points, poses)
        before, after = (np.asarray(poses.to_ground(jnp.float32(v)))[..., 2] for v in (points, lifted))
        assert before.min() < -0.1 and after.min() == pytest.approx(0.0, abs=1e-6)
        above = (before >= 0).all(axis=0)
        np.testing.assert_array_equal(lifted[above], points[above])


@pytest.mark.slow
def test_gradient_adds_up_to_what_the_cost_rises_by(frames) -> None:
    mesh = ball().with_room(96, 288)
    pose = sj.Pose(2.2, 0.0, YAWS[0])
    size = _window(mesh, SONAR, [pose])
    frame = _begun(PLAIN, mesh, SONAR, size, _Frame(frames[0], np.ones(SONAR.shape, np.float32), pose, (), None))
    rough = np.random.default_rng(0).normal(0, 5e-4, mesh.vertices.shape)  # a symmetric body's faces coincide in view
    base = np.asarray(mesh.vertices) * (1.05, 0.98, 0.97) + rough
    x, _, z = (base / 0.1 - [0, 0, 1]).T

    def cost(vertices: np.ndarray) -> tuple[float, np.ndarray]:
        given = jnp.asarray(vertices, jnp.float32)
        value, slope = _by_vertices(*frame, mesh, SONAR, given, np.float32(6.0), size=size)
        return float(value), np.asarray(slope)

    steps = np.linspace(-4e-3, 4e-3, 9)
    for bend in (np.array([1.0, 0, 0]) * x[:, None], np.array([0, 0, 1.0]) * (1 + z)[:, None], np.eye(3)[0] + 0 * base):
        values, slopes = zip(*(cost(base + step * bend) for step in steps), strict=True)
        along = np.array([(slope * bend).sum() for slope in slopes])
        risen = (along[1:] + along[:-1]).sum() / 2 * (steps[1] - steps[0])
        assert risen == pytest.approx(values[-1] - values[0], rel=0.3, abs=2e-3)


@pytest.mark.parametrize("lean", [{"z": 0.2}, {"roll": 1.5}, {"z": 0.2, "pitch": -1.2}])
def test_the_window_holds_a_body_that_hangs_or_leans(lean) -> None:
    mesh = sj.Mesh.from_arrays(*objects.box((0.06, 0.06, 0.5), (0.0, 0.0, 0.25)))
    pose = sj.Pose(2.2, 0.0, 0.3, **lean)
    size = _window(mesh, SONAR, [pose])
    window = place_window(
        size, leaning_room(mesh, pose.z, abs(pose.roll), abs(pose.pitch)), SONAR, pose.x, pose.y, SLACK_M
    )
    seen = np.asarray(sj.render(mesh, pose, SONAR).labels()) > 0
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    assert seen.sum() > 50
    assert window.row <= rows[0] and rows[-1] < window.row + size.shape[0]
    assert window.column <= columns[0] and columns[-1] < window.column + size.shape[1]


@pytest.mark.slow
@pytest.mark.computes
def test_a_ball_is_stretched_to_what_the_frames_show(frames) -> None:
    config = SurfaceConfig(blurs=(6.0, 3.0), iterations=20)
    found = sj.fit_surface(frames, ball(), SONAR, sj.Pose(2.2, 0.0, YAWS), config=config)
    extent = np.ptp(np.asarray(found.mesh.vertices), axis=0)
    assert abs(extent[0] - 0.26) < 0.02 and abs(extent[1] - 0.2) < 0.02
    assert found.score[-1] > found.score[20] - 0.01 and found.scores.shape == (4,)
    assert found.moved.max() > 0.02


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blurs": ()}, "blurs"),
        ({"iterations": 0}, "iterations"),
        ({"step_m": math.nan}, "step_m"),
        ({"smoothing": -1.0}, "smoothing"),
    ],
)
def test_a_search_that_cannot_be_is_refused(options, message) -> None:
    with pytest.raises(sj.SonarjaxError, match=message):
        SurfaceConfig(**options)


def test_bad_input_is_one_clear_line() -> None:
    blank = np.arange(4)[:, None, None] / 4 * np.linspace(0, 1, SONAR.n_beams) * np.ones((4, *SONAR.shape), np.float32)
    poses = sj.Pose(2.2, 0.0, YAWS)
    with pytest.raises(sj.SonarjaxError, match="frames: expected at least one"):
        sj.fit_surface([], ball(), SONAR, poses)
    with pytest.raises(sj.SonarjaxError, match="poses: expected one for each of the 4"):
        sj.fit_surface(blank, ball(), SONAR, sj.Pose(2.2, 0.0, YAWS[:2]))
    with pytest.raises(sj.SonarjaxError, match=r"poses\[0\]: expected the object in view"):
        sj.fit_surface(blank, ball(), SONAR, sj.Pose(-2.2, 0.0, YAWS))
    vertices, faces = objects.sphere_arrays(0.1, rings=40, sectors=60)
    with pytest.raises(sj.SonarjaxError, match="mesh: expected 2000 vertices or fewer"):
        sj.fit_surface(blank, sj.Mesh.from_arrays(vertices, faces), SONAR, poses)
