"""Gradients of the rendered image: against central differences of a converged render, and finite everywhere."""

import importlib.util
import math
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render import RenderQuality, Window, WindowSize, place_window, render, render_window
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar

SIZE = WindowSize((260, 52))
SHAPE = SIZE.shape
SUB_BEAMS, ELEVATIONS = 2, 64
CONVERGED = 6  # sub-beams of the render that is differenced
MESHES = {"target": objects.target, "ball": objects.ball, "brick": objects.brick}
SCENES = 4  # a mesh
NAMES = ("yaw", "x", "y", "tilt", "height", "shape")
# Three steps of each, longer than the image's own roughness, shorter than its curvature. Their median counts: in
# float32 a sliver of the limb may flicker at one of them.
STEPS = np.array(
    [
        [4e-3, 6e-3, 9e-3],
        [0.6e-3, 1.0e-3, 1.5e-3],
        [0.6e-3, 1.0e-3, 1.5e-3],
        [0.4e-3, 0.6e-3, 0.9e-3],
        [0.6e-3, 1.0e-3, 1.5e-3],
        [0.01, 0.015, 0.02],
    ]
)
SONAR = Sonar.preset("didson-hf", tilt=0.0, height=0.9)
# A small frame of the same field of view, for the sweeps over many poses.
SMALL = SONAR.replace(azimuth=jnp.asarray(np.radians((np.arange(24) - 11.5) * 29 / 24), jnp.float32), n_ranges=96)


@pytest.mark.slow
def test_an_object_behind_the_sonar_spoils_no_gradient():
    """Nothing of it is seen, and its facets have negative ranges, of which spreading and absorption have none."""
    brick, sonar = objects.brick(), SMALL.replace(tilt=0.35, n_ranges=32)

    def energy(x, exponent, absorption, behind):
        changed = sonar.replace(spreading_exponent=exponent, absorption=absorption)
        return render([brick, brick], [Pose(x=behind), Pose(x=x)], changed).intensity.sum()

    slopes = {x: jax.grad(energy, (0, 1, 2))(2.3, 2.0, 0.1, x) for x in (-2.0, -3.0)}
    assert np.isfinite(slopes[-2.0]).all() and np.all(np.asarray(slopes[-2.0]) != 0)
    np.testing.assert_allclose(slopes[-2.0], slopes[-3.0], rtol=1e-5)


def image(mesh, p, row, column, sub_beams):
    """Semantic window at p = (yaw, x, y, tilt, height, shape); `shape` stretches the mesh upwards."""
    mesh = mesh.with_vertices(mesh.vertices * jnp.stack([jnp.ones(()), jnp.ones(()), 1 + p[5]]))
    sonar = SONAR.replace(tilt=p[3], height=p[4])
    quality = RenderQuality(sub_beams, ELEVATIONS)
    return render_window(mesh, Pose(p[1], p[2], p[0]), sonar, Window(row, column, SHAPE), quality).semantic()


def squares(picture, target):
    return ((picture - target) ** 2).sum()


def one_minus_ncc(picture, target):
    a, b = picture - picture.mean(), target - target.mean()
    return 1 - (a * b).sum() / jnp.sqrt((a * a).sum() * (b * b).sum())


def losses(mesh, p, row, column, target, sub_beams):
    picture = image(mesh, p, row, column, sub_beams)
    return jnp.stack([squares(picture, target), one_minus_ncc(picture, target)])


@jax.jit
def analytic(mesh, p, row, column, target):
    """Both losses' gradients (2, 6) by reverse mode at the default quality."""
    return jax.jacrev(losses, argnums=1)(mesh, p, row, column, target, SUB_BEAMS)


@jax.jit
def converged(mesh, points, row, column, target):
    """Both losses (point, 2) of a converged render at many points, one after another."""
    return jax.lax.map(lambda p: losses(mesh, p, row, column, target, CONVERGED), points)


converged_image = jax.jit(partial(image, sub_beams=CONVERGED))


def scenes(seed):
    rng = np.random.default_rng(seed)
    for k in range(SCENES):
        # Wholly inside the aperture: where its edge cuts the object, slivers of it appear and vanish as it tilts, each
        # at least a pulse long, and the image truly jumps.
        x = (2.50, 2.20, 1.90)[k % 3]
        place = rng.uniform([0.0, x - 0.05, -0.2], [2 * math.pi, x + 0.05, 0.2])
        turned = rng.choice([-1, 1]) * rng.uniform(0.05, 0.15)
        p = np.array([*place, math.radians((15, 20, 25)[k % 3]), 0.9, 0.0])
        yield p, np.array([turned, *rng.uniform(-0.012, 0.012, 2), 0, 0, 0])


def differences(mesh, p, row, column, target):
    """Central differences (2, 6) of the converged render, the median of three steps."""
    steps = np.eye(6)[:, None] * STEPS[..., None]  # (parameter, step, 6)
    points = np.stack([p + steps, p - steps]).reshape(-1, 6)
    values = np.asarray(converged(mesh, jnp.asarray(points, jnp.float32), row, column, target), np.float64)
    up, down = values.reshape(2, *STEPS.shape, 2)
    return np.median((up - down) / (2 * STEPS[..., None]), axis=1).T


def compare(mesh, seed):
    """(analytic, differences), each (scene, loss, parameter)."""
    ours, theirs = [], []
    for p, off in scenes(seed):
        sonar = SONAR.replace(tilt=float(p[3]))
        window = place_window(SIZE, mesh, sonar, float(p[1]), float(p[2]))
        at = jnp.asarray(p, jnp.float32)
        target = converged_image(mesh, at + jnp.asarray(off, jnp.float32), window.row, window.column)
        ours.append(np.asarray(analytic(mesh, at, window.row, window.column, target), np.float64))
        theirs.append(differences(mesh, p, window.row, window.column, target))
    return np.array(ours), np.array(theirs)


@pytest.fixture(scope="module")
def derivatives():
    """(analytic, differences), each (mesh, scene, loss, parameter)."""
    ours, theirs = zip(*(compare(make(), seed) for seed, make in enumerate(MESHES.values())), strict=True)
    return np.array(ours), np.array(theirs)


@pytest.mark.slow
@pytest.mark.computes
@pytest.mark.parametrize("loss", [0, 1], ids=["squares", "1-ncc"])
@pytest.mark.parametrize("parameter", [0, 1, 2], ids=NAMES[:3])
def test_pose_gradients(derivatives, loss, parameter):
    ours, theirs = (d[..., loss, parameter].ravel() for d in derivatives)
    rms = np.sqrt((theirs**2).mean())
    error = np.abs(ours - theirs) / rms
    clear = np.abs(theirs) > 0.2 * rms
    right = np.mean(np.sign(ours[clear]) == np.sign(theirs[clear]))
    print(
        f"\n{NAMES[parameter]}: error / RMS median {np.median(error):.3f}, 95th percentile "
        f"{np.percentile(error, 95):.3f}, sign right in {right:.3f} of {clear.sum()}"
    )
    assert np.isfinite(ours).all()
    assert np.median(error) <= 0.05
    assert np.percentile(error, 95) <= 0.18
    assert right == 1.0


def stepped_cylinder():
    """Four upright cylinders on top of each other: 384 vertices at sharp edges, 128 candidates a slice."""
    parts = []
    for k, radius in enumerate((0.10, 0.08, 0.06, 0.04)):
        vertices, faces = objects.cylinder_arrays(radius, height=0.05)
        parts.append((vertices + [0, 0, 0.05 * k], faces))
    return Mesh.from_arrays(*objects.join(*parts))


@pytest.mark.slow
def test_a_stepped_body_moves_as_its_steps_do():
    """By x and y (yaw does nothing to a round body): each step's silhouettes and treads, of a sampled profile."""
    ours, theirs = (d[..., 1:3] for d in compare(stepped_cylinder(), seed=3))
    error = np.abs(ours - theirs) / np.sqrt((theirs**2).mean(axis=0))
    median, p95 = np.median(error, axis=0), np.percentile(error, 95, axis=0)
    print(f"\n(loss, x and y): error / RMS median {np.round(median, 3)}, 95th percentile {np.round(p95, 3)}")
    assert (median <= 0.08).all() and (p95 <= 0.25).all()


@pytest.mark.slow
@pytest.mark.computes
@pytest.mark.parametrize("loss", [0, 1], ids=["squares", "1-ncc"])
@pytest.mark.parametrize("parameter", [3, 4, 5], ids=NAMES[3:])
def test_sonar_and_vertex_gradients(derivatives, loss, parameter):
    ours, theirs = (d[..., loss, parameter].ravel() for d in derivatives)
    rms = np.sqrt((theirs**2).mean())
    error = np.abs(ours - theirs) / rms
    print(f"\n{NAMES[parameter]}: error / RMS median {np.median(error):.3f}, 95 % {np.percentile(error, 95):.3f}")
    assert np.isfinite(ours).all() and (ours != 0).all()
    assert np.median(error) <= 0.1
    assert np.percentile(error, 95) <= 0.4
    assert np.corrcoef(ours, theirs)[0, 1] > 0.98


@pytest.mark.slow
def test_forward_mode_equals_reverse_mode():
    mesh, at = objects.brick(), jnp.asarray([0.4, 2.2, 0.05, 0.35, 0.9, 0.0], jnp.float32)
    window = place_window(SIZE, mesh, SONAR.replace(tilt=0.35), 2.2, 0.05)
    target = converged_image(mesh, at + jnp.array([0.1, 0.01, -0.01, 0, 0, 0]), window.row, window.column)
    reverse = np.asarray(analytic(mesh, at, window.row, window.column, target))
    forward = jax.jit(partial(jax.jacfwd(losses, argnums=1), sub_beams=SUB_BEAMS))
    for a, b in zip(forward(mesh, at, window.row, window.column, target), reverse, strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-3 * np.abs(b).max())


@pytest.mark.slow
def test_forward_image_converges():
    """Each layer is within 3 % RMS of one with 8 × the sub-beams and elevations."""

    @partial(jax.jit, static_argnames=("sub_beams", "elevations"))
    def layers(mesh, pose, sonar, row, column, sub_beams, elevations):
        out = render_window(mesh, pose, sonar, Window(row, column, SHAPE), RenderQuality(sub_beams, elevations))
        return out.intensity, out.highlight, out.shadow

    mesh = objects.target()
    worst = np.zeros(3)
    for p, _ in scenes(11):
        sonar = SONAR.replace(tilt=float(p[3]))
        window = place_window(SIZE, mesh, sonar, float(p[1]), float(p[2]))
        pose = Pose(float(p[1]), float(p[2]), float(p[0]))
        ours = layers(mesh, pose, sonar, window.row, window.column, SUB_BEAMS, ELEVATIONS)
        finer = layers(mesh, pose, sonar, window.row, window.column, 8 * SUB_BEAMS, 8 * ELEVATIONS)
        rms = [float(jnp.sqrt(((a - b) ** 2).sum() / (b**2).sum())) for a, b in zip(ours, finer, strict=True)]
        worst = np.maximum(worst, rms)
    print(f"\nlargest RMS of {SCENES} scenes: intensity, highlight, shadow {np.round(worst, 4)}")
    assert (worst <= 0.03).all()


# ---------------------------------------------------------------- finite everywhere


def _summary(mesh, q):
    """A number that depends on every layer, at q = (x, y, yaw, z, roll, pitch, tilt, height)."""
    sonar = SMALL.replace(tilt=q[6], height=q[7])
    out = render_window(mesh, Pose(*q[:6]), sonar, Window(0, 0, SMALL.shape), RenderQuality(1, 16))
    weight = jnp.cos(jnp.arange(out.shadow.size, dtype=jnp.float32)).reshape(out.shadow.shape)
    return (weight * (out.intensity * 100 + out.highlight + 0.5 * out.shadow)).sum()


@jax.jit
def value_and_gradient(mesh, poses):
    """Values (pose,), gradients (pose, 8) and the largest gradient of a vertex (pose,) at poses (pose, 8)."""

    def one(q):
        both = jax.value_and_grad(lambda q, v: _summary(mesh.with_vertices(v), q), (0, 1))
        value, (grad, shape) = both(q, mesh.vertices)
        return value, grad, jnp.abs(shape).max()

    return jax.lax.map(one, poses)


def special_poses(rng, count=1000):
    """Random poses, and those at which something degenerates."""
    q = np.zeros((count, 8))
    q[:, 0], q[:, 1], q[:, 2] = rng.uniform(-1, 4.5, count), rng.uniform(-1, 1, count), rng.uniform(-7, 7, count)
    q[:, 6], q[:, 7] = rng.uniform(0.2, 0.5, count), 0.9
    kind = np.arange(count) % 10
    q[kind == 0, 1] = q[kind == 0, 0] * math.tan(math.radians(14.5))  # on the fan's outer edge: half out of view
    q[kind == 1, 0] = -np.abs(q[kind == 1, 0]) - 0.1  # behind the sonar
    q[kind == 2, 3] = rng.uniform(-0.3, 0.0, (kind == 2).sum())  # in or below the floor
    some = kind == 3  # edge-on and exactly symmetric
    n, quarter = some.sum(), math.pi / 2
    q[some, 0], q[some, 1], q[some, 2] = rng.uniform(1.5, 3, n), 0.0, rng.integers(-4, 5, n) * quarter
    some = kind == 4  # round numbers
    n = some.sum()
    q[some, 0], q[some, 1] = rng.integers(4, 7, n) * 0.5, rng.integers(-2, 3, n) * 0.1
    q[some, 2] = rng.integers(0, 8, n) * quarter / 2
    q[kind == 5, 3:6] = rng.uniform(-math.pi, math.pi, ((kind == 5).sum(), 3)) * [0.1, 1, 1]  # tumbled
    some = kind == 6  # on their heads, on their sides
    q[some, 4:6] = rng.integers(-2, 3, (some.sum(), 2)) * quarter
    q[kind == 7, :2] *= 0.02  # around the foot of the sonar, and around its head
    q[kind == 7, 3] = rng.uniform(0, 1.0, (kind == 7).sum())
    some = kind == 8  # level sonar, top face edge-on to the head's own height
    q[some, 6], q[some, 3] = 0.0, 0.9 - 0.057
    return q  # kind 9: plainly random


def assert_finite(mesh, poses):
    value, grad, shape = (np.asarray(v) for v in value_and_gradient(mesh, jnp.asarray(poses, jnp.float32)))
    bad = ~(np.isfinite(value) & np.isfinite(grad).all(1) & np.isfinite(shape))
    assert not bad.any(), f"{bad.sum()} of {len(poses)} not finite, first at {poses[bad][0].tolist()}"
    return value, grad


@pytest.mark.slow
@pytest.mark.parametrize("count", [1000])
def test_finite_at_many_poses(count):
    poses = special_poses(np.random.default_rng(0), count)
    _, grad = assert_finite(objects.brick(), poses)
    seen = np.abs(grad[:, :3]).max(1) > 0
    print(f"\n{seen.mean():.2f} of the poses are seen; largest gradient {np.abs(grad).max():.3g}")
    assert 0.3 < seen.mean() < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tank", "plane"])
def test_open_meshes_are_finite(name):
    if name == "tank":
        mesh, poses = objects.tank(), special_poses(np.random.default_rng(1), 200) * [0.1, 0.1, 1, 1, 0, 0, 1, 1]
    else:
        corners = np.array([[0, -0.2, 0], [0, 0.2, 0], [0, 0.2, 0.2], [0, -0.2, 0.2]])
        mesh, poses = Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), special_poses(np.random.default_rng(2), 200)
    assert not mesh.closed
    _, grad = assert_finite(mesh, poses)
    assert np.abs(grad[:, :3]).max() > 0


def test_open_plane_is_seen_from_both_sides():
    corners = np.array([[0, -0.2, 0], [0, 0.2, 0], [0, 0.2, 0.2], [0, -0.2, 0.2]])
    mesh = Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])
    sonar = SMALL.replace(tilt=0.35)
    front, back = (render(mesh, Pose(x=2.2, yaw=yaw), sonar) for yaw in (0.0, math.pi))
    assert np.asarray(front.highlight).max() > 0.5
    np.testing.assert_allclose(front.highlight, back.highlight, atol=1e-3)
    np.testing.assert_allclose(front.shadow, back.shadow, atol=1e-3)


@pytest.mark.slow
def test_big_mesh():
    """40,000 triangles: the closed-form nearest range, and Embree's labels but for a few pixels at the outline."""
    mesh = objects.ball(rings=100, sectors=200)
    assert mesh.n_faces > 39_000
    radius, x, y = 0.11, 2.2, 0.1
    sonar = SONAR.replace(tilt=math.radians(20.0))
    frame = render(mesh, Pose(x=x, y=y, yaw=0.3), sonar)
    assert all(np.isfinite(np.asarray(v)).all() for v in (frame.intensity, frame.highlight, frame.shadow))
    rows = np.flatnonzero((np.asarray(frame.highlight) > 1e-3).any(1))
    nearest = math.hypot(math.hypot(x, y), 0.9 - radius) - radius
    step = float(sonar.range_bin)
    assert float(sonar.range_edges[rows[0]]) == pytest.approx(nearest, abs=1.5 * step)
    pytest.importorskip("embreex")
    spec = importlib.util.spec_from_file_location("render_embree", Path(__file__).with_name("embree.py"))
    embree = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(embree)
    ours, (theirs, _, _) = np.asarray(frame.labels()), embree.labels(mesh, x, y, 0.3, sonar)
    either = (ours > 0) | (theirs > 0)
    agree = (ours == theirs)[either].mean()
    print(f"\n40,000 triangles: {agree:.4f} of {either.sum()} object pixels agree")
    assert agree >= 0.95
