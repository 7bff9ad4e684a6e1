"""The table of DESIGN.md: every numeric function gives the same under jit and vmap as in a loop, and has its gradient.

All of it on one small sonar and one brick, so that compiled code is shared.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.match import correlation_maps, decide, peaks
from sonarjax.render import Window, render_window, semantic_image
from sonarjax.sensor import SensorModel, received_energy

AZIMUTH = np.radians((np.arange(24) - 11.5) * 29 / 24).astype(np.float32)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), azimuth=AZIMUTH, n_ranges=96)
QUALITY = sj.RenderQuality(sub_beams=1, elevations=16)
BRICK = sj.objects.brick()
X, Y = np.array([2.2, 2.35, 1.9], np.float32), np.array([0.0, 0.2, -0.15], np.float32)
YAW = np.array([0.3, 2.0, 5.1], np.float32)
POSES = sj.Pose(x=X, y=Y, yaw=YAW)
POSE = jax.tree.map(lambda v: v[0], POSES)
# The whole frame, so that no plan depends on a start; one short ladder of blurs.
REFINE = sj.RefineConfig(blurs=(2.0, 0.8), polish=0)
WHOLE = sj.WindowSize(SONAR.shape, SONAR.n_beams)

smaller_poses = jax.tree.map(lambda v: v[:2], POSES)


def semantic(pose: sj.Pose, mesh: sj.Mesh = BRICK, sonar: sj.Sonar = SONAR) -> jax.Array:
    return sj.render(mesh, pose, sonar, quality=QUALITY).semantic()


@cache
def images() -> jax.Array:
    """Clean semantic images (pose, range, beam) of the brick."""
    return semantic(POSES)


@cache
def templates() -> jax.Array:
    """A bank (yaw, 40, 12) cut out of noise: matching asks nothing of it."""
    return jnp.asarray(np.random.default_rng(0).random((8, 40, 12)), jnp.float32)


@cache
def network() -> sj.GeneratorWeights:
    weights = sj.load_segmenter().weights
    assert weights is not None
    return weights


def stacked(*trees: Any) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, jnp.float32) for leaf in leaves]), *trees)


def open_box() -> sj.Mesh:
    """The brick without one of its sides: no closed surface."""
    return sj.Mesh.from_arrays(np.asarray(BRICK.vertices), np.asarray(BRICK.faces)[:10])


def scores() -> jax.Array:
    return jnp.asarray(np.random.default_rng(1).random((3, 36)), jnp.float32)


def refined(job: Any) -> Any:
    found = sj.refine_yaw(job[0], BRICK, SONAR, job[1], config=REFINE, window=WHOLE)
    return found.yaw, found.x, found.y, found.score, found.start_score


def refined_pose(job: Any) -> Any:
    found = sj.refine_pose(job[0], BRICK, SONAR, job[1], free=("x", "z", "pitch"), config=REFINE, window=WHOLE)
    return found.pose, found.std, found.score, found.observable


def off(pose: sj.Pose) -> sj.Pose:
    return replace(pose, yaw=pose.yaw + 0.05)


YAWS36 = np.arange(36, dtype=np.float32) * np.float32(math.radians(10.0))


@pytest.fixture(autouse=True, scope="module")
def _made_before() -> None:
    """What tests share is computed outside of any trace."""
    images(), templates(), seen(), network()


# Name: a function of one thing, and a batch of it. What is compared is a pytree of numbers.
CASES: dict[str, Callable[[], tuple[Callable[[Any], Any], Any]]] = {
    "render, poses": lambda: (lambda pose: sj.render(BRICK, pose, SONAR, quality=QUALITY), POSES),
    "render, sonars": lambda: (
        lambda sonar: semantic(sj.Pose(2.2, 0.1, 0.3), BRICK, sonar),
        stacked(SONAR, SONAR.replace(tilt=0.4), SONAR.replace(height=0.8)),
    ),
    "render, meshes": lambda: (
        lambda mesh: semantic(sj.Pose(2.2, 0.1, 0.3), mesh),
        sj.stack_meshes([BRICK, sj.objects.brick(0.25, 0.1, 0.08), open_box()]),
    ),
    "observe": lambda: (
        lambda job: sj.observe(seen(), job[0], key=job[1]),
        (stacked(*(SensorModel.nominal(s) for s in (0.5, 1.0, 1.5))), jax.random.split(jax.random.key(0), 3)),
    ),
    "match_bank": lambda: (lambda image: sj.match_bank(image, templates()), images()),
    "match_positions": lambda: (lambda image: sj.match_positions(image, templates()), images()),
    "match_bank, masked": lambda: (
        lambda image: sj.match_bank(image, templates(), jnp.arange(24) + jnp.zeros((96, 1), int) > 3),
        images(),
    ),
    "correlation_maps": lambda: (lambda image: correlation_maps(image, templates()), images()),
    "match_bank, banks": lambda: (
        lambda bank: sj.match_bank(images()[0], bank),
        jnp.stack([templates(), templates()[::-1], templates() ** 2]),
    ),
    "decide": lambda: (lambda s: decide(s, jnp.asarray(YAWS36), 0.9), scores()),
    "peaks": lambda: (lambda s: peaks(s, jnp.asarray(YAWS36)), scores()),
    "segment": lambda: (lambda image: sj.segment(image, network()), images()),
    "segment, masked": lambda: (
        lambda job: sj.segment(job[0], network(), job[1]),
        (images(), images() > jnp.array([0.1, 0.4, 0.6])[:, None, None]),
    ),
    "semantic_image": lambda: (lambda both: semantic_image(*both), (images(), images()[::-1])),
    "labels": lambda: (
        lambda both: replace(seen(), highlight=both[0], shadow=both[1]).labels(),
        (images(), images()[::-1]),
    ),
    "refine_yaw": lambda: (refined, (images()[:2], off(smaller_poses))),
    "refine_pose": lambda: (refined_pose, (images()[:2], replace(smaller_poses, z=smaller_poses.z + 0.01))),
}
# Each of these compiles the renderer, the sensor or the network once more; the other way is tested here or beside them.
SLOW = {
    ("jit", "observe"), ("vmap", "observe"), ("vmap", "render, poses"), ("vmap", "render, sonars"),
    ("jit", "segment"), ("vmap", "segment"), ("jit", "segment, masked"),
    ("jit", "render, sonars"), ("jit", "render, meshes"), ("jit", "refine_yaw"), ("vmap", "refine_yaw"),
    ("jit", "refine_pose"), ("vmap", "refine_pose"),
}  # fmt: skip
# Of the largest value: other fusions round otherwise, and a pixel of `observe` may fall into the next of 256 steps.
TOLERANCE = {"observe": 1.1 / 255, "refine_yaw": 3e-3, "refine_pose": 3e-3}


def elements(batch: Any) -> list[Any]:
    count = len(jax.tree.leaves(batch)[0])
    return [jax.tree.map(lambda v, k=k: v[k], batch) for k in range(count)]


@cache
def looped(name: str) -> list[Any]:
    function, batch = CASES[name]()
    return [function(one) for one in elements(batch)]


@pytest.mark.parametrize(
    ("way", "name"),
    [
        pytest.param(way, name, marks=pytest.mark.slow if (way, name) in SLOW else ())
        for name in CASES
        for way in ("jit", "vmap")
    ],
)
def test_as_a_loop_of_untraced_calls(way: str, name: str) -> None:
    function, batch = CASES[name]()
    if way == "vmap":
        found = elements(jax.vmap(function)(batch))
    else:
        compiled = jax.jit(function)
        found = [compiled(one) for one in elements(batch)]
    for ours, theirs in zip(found, looped(name), strict=True):
        assert jax.tree.structure(ours) == jax.tree.structure(theirs)
        for path, value in jax.tree_util.tree_leaves_with_path(ours):
            wanted = dict(jax.tree_util.tree_leaves_with_path(theirs))[path]
            compare(np.asarray(value), np.asarray(wanted), TOLERANCE.get(name, 2e-4), str(path))


def compare(found: np.ndarray, wanted: np.ndarray, tolerance: float, what: str) -> None:
    assert found.shape == wanted.shape and found.dtype == wanted.dtype, what
    if found.dtype.kind == "f":
        known = np.isfinite(wanted)
        np.testing.assert_array_equal(np.isfinite(found), known, err_msg=what)
        largest = float(np.abs(wanted[known]).max(initial=0.0))
        np.testing.assert_allclose(found[known], wanted[known], atol=tolerance * max(largest, 1e-9), err_msg=what)
    else:
        np.testing.assert_array_equal(found, wanted, err_msg=what)


def windows(poses: sj.Pose, rows: jax.Array, columns: jax.Array) -> jax.Array:
    """Windows of 48 x 16 pixels whose places are traced."""

    def one(pose: sj.Pose, row: jax.Array, column: jax.Array) -> jax.Array:
        return render_window(BRICK, pose, SONAR, Window(row, column, (48, 16)), QUALITY).semantic()

    return jax.vmap(one)(poses, rows, columns)


def test_a_window_is_a_crop_of_the_frame() -> None:
    rows, columns = np.array([10, 20, 5]), np.array([4, 0, 8])
    found = jax.jit(windows)(POSES, jnp.asarray(rows), jnp.asarray(columns))
    for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
        wanted = images()[k][row : row + 48, column : column + 16]
        np.testing.assert_allclose(found[k], wanted, atol=2e-4)


# ---------------------------------------------------------------- batches of poses and meshes


def test_vmap_takes_a_pose_of_numbers_and_arrays() -> None:
    found = jax.vmap(semantic)(sj.Pose(x=X, y=0.0, yaw=YAW))
    assert found.shape == (3, *SONAR.shape)
    np.testing.assert_allclose(found[1], semantic(sj.Pose(X[1], 0.0, YAW[1])), atol=2e-4)


def test_a_batch_of_poses_of_any_shape_is_a_batch_of_frames() -> None:
    frame = sj.render(BRICK, sj.Pose(x=X[:2, None], y=0.1, yaw=YAW), SONAR, quality=QUALITY)
    assert frame.intensity.shape == (2, 3, *SONAR.shape) and frame.overflow.shape == (2, 3)
    assert frame.labels().shape == frame.semantic().shape == (2, 3, *SONAR.shape)
    for (i, j), overflow in np.ndenumerate(np.asarray(frame.overflow)):
        one = sj.render(BRICK, sj.Pose(X[i], 0.1, YAW[j]), SONAR, quality=QUALITY)
        assert overflow == one.overflow == 0
        for name in ("intensity", "highlight", "shadow"):
            wanted = np.asarray(getattr(one, name))
            np.testing.assert_allclose(getattr(frame, name)[i, j], wanted, atol=2e-4 * wanted.max(), err_msg=name)


@pytest.mark.slow
def test_stacked_meshes_and_poses_broadcast() -> None:
    meshes = sj.stack_meshes([BRICK, sj.objects.brick(0.25, 0.1, 0.08)])
    frame = sj.render(meshes, smaller_poses, SONAR, quality=QUALITY)
    assert frame.highlight.shape == (2, *SONAR.shape)
    for k, pose in enumerate(elements(smaller_poses)):
        one = jax.tree.map(lambda v, k=k: v[k], meshes)
        np.testing.assert_allclose(frame.semantic()[k], semantic(pose, one), atol=2e-4)


# ---------------------------------------------------------------- room for triangles


@cache
def cramped() -> sj.Mesh:
    return replace(BRICK, crossings=1, front=1)


def test_a_traced_overflow_is_counted() -> None:
    frame = jax.jit(lambda mesh: sj.render(mesh, POSE, SONAR, quality=QUALITY))(cramped())
    assert int(frame.overflow) > 0
    assert int(sj.render(BRICK, POSE, SONAR, quality=QUALITY).overflow) == 0


def test_outside_a_trace_room_is_made() -> None:
    frame = sj.render(cramped(), POSE, SONAR, quality=QUALITY)
    assert int(frame.overflow) == 0
    np.testing.assert_allclose(frame.semantic(), images()[0], atol=2e-4)


@pytest.mark.slow
def test_a_bank_makes_room_too() -> None:
    roomy, small = (sj.template_bank(m, SONAR, YAW, x=2.2, quality=QUALITY) for m in (BRICK, cramped()))
    assert roomy.templates.shape == small.templates.shape
    np.testing.assert_allclose(small.templates, roomy.templates, atol=2e-4)


def test_vertices_are_measured_again_where_they_are_known() -> None:
    taller = BRICK.vertices * jnp.array([1.0, 1.0, 3.0])
    known = BRICK.with_vertices(taller)
    traced = jax.jit(BRICK.with_vertices)(taller)
    assert float(known.top) == pytest.approx(3 * 0.057, abs=0.011)
    assert float(traced.top) == float(BRICK.top) and float(traced.radius) == float(BRICK.radius)
    np.testing.assert_array_equal(known.vertices, traced.vertices)


# ---------------------------------------------------------------- gradients


STEPS = np.array([6e-3, 1.5e-3, 1.5e-3, 1e-3, 1.5e-3, 1.5e-2])  # yaw, x, y, tilt, height, stretch of the mesh


def weighed(q: jax.Array) -> jax.Array:
    """A smooth number of the image at q = (yaw, x, y, tilt, height, stretch): its pixels under a broad wave."""
    mesh = BRICK.with_vertices(BRICK.vertices * jnp.stack([jnp.ones(()), jnp.ones(()), 1 + q[5]]))
    sonar = SONAR.replace(tilt=q[3], height=q[4])
    picture = sj.render(mesh, sj.Pose(q[1], q[2], q[0]), sonar, quality=sj.RenderQuality(4, 16)).semantic()
    row, column = jnp.arange(96.0)[:, None] / 96, jnp.arange(24.0) / 24
    return (jnp.sin(9 * row) * jnp.cos(5 * column + 0.5) * (picture - 0.5)).sum()


def test_gradients_of_render_are_central_differences() -> None:
    at = np.array([0.4, 2.2, 0.07, 0.35, 0.9, 0.0])
    shifts = np.diag(STEPS)[:, None] * np.array([1.0, 1.5, 2.0])[:, None]  # three steps, averaged
    points = np.stack([at + shifts, at - shifts]).reshape(-1, 6)
    both = jax.jit(lambda p: jax.lax.map(jax.value_and_grad(weighed), p))
    values, slopes = both(jnp.asarray(np.concatenate([points, at[None]]), jnp.float32))
    up, down = np.asarray(values[:-1], np.float64).reshape(2, 6, 3)
    wanted = ((up - down) / (2 * np.array([1.0, 1.5, 2.0]))).mean(1)  # a step's worth of each
    ours = np.asarray(slopes[-1], np.float64) * STEPS
    print(f"\ngradient {ours}, differences {wanted}")
    assert np.isfinite(ours).all()
    np.testing.assert_allclose(ours, wanted, atol=0.1 * np.abs(wanted).max())


SMOOTH: dict[str, Callable[[], tuple[Callable[[jax.Array], jax.Array], jax.Array, float]]] = {
    "match_bank": lambda: (lambda image: sj.match_bank(image, templates()[:1])[0], planted(), 1e-2),
    "correlation_maps": lambda: (lambda image: (correlation_maps(image, templates()) ** 2).sum(), noise(), 1e-2),
    "segment": lambda: (
        lambda image: (jnp.sin(jnp.arange(96.0) / 7)[:, None] * sj.segment(image, network())).sum(),
        0.3 + 0.4 * images()[0] + 0.1 * noise(),
        3e-4,
    ),
    "semantic_image": lambda: (
        lambda share: (semantic_image(share, 1 - share) * templates()[0]).sum(),
        0.2 + 0.6 * templates()[1],
        1e-2,
    ),
    "received_energy": lambda: (
        lambda intensity: jnp.square(received_energy(replace(seen(), intensity=intensity), SensorModel())).mean(),
        seen().intensity,
        1e-3,
    ),
}


def noise() -> jax.Array:
    return jnp.asarray(np.random.default_rng(2).random(SONAR.shape), jnp.float32)


def planted() -> jax.Array:
    """Noise that holds the first template, so that it is clear which position is best."""
    return noise().at[20:60, 5:17].add(2 * templates()[0])


@cache
def seen() -> sj.SonarFrame:
    return sj.render(BRICK, POSE, SONAR, quality=QUALITY)


@pytest.mark.parametrize("name", SMOOTH)
def test_gradients_are_central_differences(name: str) -> None:
    """Along a random direction of the length of the input."""
    function, at, step = SMOOTH[name]()
    both = jax.jit(jax.value_and_grad(function))
    direction = jnp.asarray(np.random.default_rng(3).normal(size=at.shape), jnp.float32) * at
    wanted = (float(both(at + step * direction)[0]) - float(both(at - step * direction)[0])) / (2 * step)
    found = float((both(at)[1] * direction).sum())
    assert found != 0
    assert found == pytest.approx(wanted, rel=0.02)


TRUTH = sj.Pose(2.2, 0.05, 0.4)


@cache
def polished_yaws() -> Callable[..., Any]:
    """The compiled sum of the yaws refined from starts, by weight, its gradients by image and starts, and the yaws."""
    config = sj.RefineConfig(blurs=(2.0, 0.8), polish=20, sharpness=0.0)

    def total(image: jax.Array, starts: sj.Pose, weights: jax.Array) -> tuple[jax.Array, sj.YawEstimate]:
        found = sj.refine_yaw(image, BRICK, SONAR, starts, config=config, window=WHOLE)
        return (found.yaw * weights).sum(), found

    return jax.jit(jax.value_and_grad(total, (0, 1), has_aux=True, allow_int=True))


@pytest.mark.slow
def test_gradient_of_a_refined_yaw_is_how_the_yaw_moves() -> None:
    """By the image, along the difference to one that is a little turned: the implicit derivative at the solution."""
    image, other = (semantic(replace(TRUTH, yaw=TRUTH.yaw + turn)) for turn in (0.0, 0.03))
    along, first = other - image, jnp.arange(6) == 0
    starts = jax.tree.map(lambda v, edge: jnp.asarray(edge).at[0].set(v), TRUTH, EDGES)

    def yaw(share: float) -> Any:
        return polished_yaws()(image + share * along, starts, first.astype(jnp.float32))

    (_, here), (by_image, by_starts) = yaw(0.0)
    assert bool(here.determined[0])
    found = float((by_image * along).sum())
    assert not any(np.asarray(v).any() for v in jax.tree.leaves(by_starts))  # a minimum does not depend on its start
    wanted = (float(yaw(0.2)[0][0]) - float(yaw(-0.2)[0][0])) / 0.4
    print(f"\nimplicit {found:.4f}, differences {wanted:.4f}")
    assert found == pytest.approx(wanted, rel=0.25)


# ---------------------------------------------------------------- refinement of anything is finite


def finite(estimate: sj.YawEstimate) -> None:
    for name in ("yaw", "x", "y", "score", "start_score"):
        assert np.isfinite(np.asarray(getattr(estimate, name))).all(), name
    std, angle = np.asarray(estimate.yaw_std), np.asarray(estimate.yaw)
    assert not np.isnan(std).any() and (std >= 0).all()  # infinite where nothing is known
    assert (angle >= 0).all() and (angle < 2 * math.pi + 1e-6).all()
    most = np.abs(np.asarray(estimate.score)).max(), np.abs(np.asarray(estimate.start_score)).max()
    assert max(most) <= 1 + 1e-4


EDGES = sj.Pose(
    x=np.array([2.2, 1.4, 4.2, 2.2, -2.0, 2.2], np.float32),  # the last ones behind and far beside the view
    y=np.array([0.0, 0.0, 0.0, 0.56, 0.0, 5.0], np.float32),
    yaw=np.array([0.3, 6.2831, 0.0, 3.0, 1.0, -1.0], np.float32),
)


@pytest.mark.parametrize("kind", ["constant", "zero", "noise", "own"])
def test_refinement_is_finite_for_any_image_and_start(kind: str) -> None:
    made = {"constant": lambda: jnp.full(SONAR.shape, 0.5), "zero": lambda: jnp.zeros(SONAR.shape), "noise": noise}
    image = (made | {"own": lambda: images()[0]})[kind]()
    found = sj.refine_yaw(image, BRICK, SONAR, EDGES, config=REFINE, window=WHOLE)
    finite(found)
    assert not np.asarray(found.converged)[4:].any() and (np.asarray(found.score)[4:] == 0).all()
    if kind in ("constant", "zero"):
        np.testing.assert_allclose(found.score, 0.0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.computes
@pytest.mark.parametrize("template", ["semantic", "echo"])
def test_refinement_is_finite_for_2000_pairs(template: str) -> None:
    rng = np.random.default_rng(7)
    config = replace(REFINE, template=template)
    for k in range(40):
        scale, offset = rng.choice([0.0, 1e-6, 1.0, 1e3]), rng.choice([0.0, 0.5, -1e3])
        image = np.asarray(rng.random(SONAR.shape) * scale + offset, np.float32)
        mask = rng.random(SONAR.shape) < rng.choice([0.0, 0.02, 0.5, 1.0])
        x, y = rng.uniform(-1, 6, 25), rng.uniform(-1.5, 1.5, 25)
        start = sj.Pose(x.astype(np.float32), y.astype(np.float32), rng.uniform(-9, 9, 25).astype(np.float32))
        finite(sj.refine_yaw(image, BRICK, SONAR, start, mask=mask if k % 2 else None, config=config, window=WHOLE))


@pytest.mark.slow
def test_polished_refinement_and_its_gradient_are_finite() -> None:
    for image in (jnp.full(SONAR.shape, 0.5), noise()):
        (_, found), (by_image, _) = polished_yaws()(image, EDGES, jnp.ones(6))
        finite(found)
        assert np.isfinite(np.asarray(by_image)).all()
