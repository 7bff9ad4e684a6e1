"""The echo template: its derivatives, and what it is worth on frames of a sensor, whose bounce is found too."""

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.recognize import refine_on_frame
from sonarjax.refine import MAP_REFINEMENT, on_frame
from sonarjax.refine.template import (
    VIEWS,
    Subject,
    draw,
    layers_with_slope,
    nominal_law,
    paint_with_slope,
    render_layers,
)
from sonarjax.render import RenderQuality, place_window, plan_window
from sonarjax.sensor import SensorModel, observe_scene

pytestmark = pytest.mark.slow
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
YAWS = np.radians([11.0, 77.0, 141.0, 218.0, 303.0]).astype(np.float32)
X, Y = 2.3, 0.05
PLAIN = replace(on_frame(MAP_REFINEMENT), template="semantic")
ON_FRAME = (PLAIN, replace(PLAIN, template="echo"))
QUIET = replace(SensorModel.nominal(), speckle=0.0, texture=0.0)  # but with its bounce on the floor


@pytest.fixture(scope="module")
def mesh():
    return sj.objects.target()


@pytest.fixture(scope="module")
def seen(mesh):
    """Frames (yaw, range, beam) of a sensor without speckle, and the semantic images behind them."""

    def observed(yaw, key):
        image, frame = observe_scene(mesh, sj.Pose(X, Y, yaw), SONAR, QUIET, key=key)
        return image, frame.semantic()

    keys = jax.random.split(jax.random.key(0), len(YAWS))
    return jax.jit(lambda *jobs: jax.lax.map(lambda job: observed(*job), jobs))(jnp.asarray(YAWS), keys)


def starts():
    off = np.random.default_rng(0).uniform(-1, 1, (3, len(YAWS))) * [[math.radians(4)], [0.01], [0.01]]
    yaw, x, y = (off + np.stack([YAWS, np.full_like(YAWS, X), np.full_like(YAWS, Y)])).astype(np.float32)
    return sj.Pose(x, y, yaw)


def error_deg(found):
    return np.degrees(np.abs((np.asarray(found.yaw) - YAWS + np.pi) % (2 * np.pi) - np.pi))


def test_frames_of_a_sensor_give_a_better_yaw_than_by_the_semantic_template(mesh, seen):
    semantic, echo = (error_deg(sj.refine_yaw(seen[0], mesh, SONAR, starts(), config=way)) for way in ON_FRAME)
    print(f"\nsemantic {semantic.round(2)}°, echo {echo.round(2)}°")
    # The device's law is not told: one is chosen on each frame, which costs a little beside knowing it.
    assert echo.max() < 0.6 < semantic.max()
    assert echo.mean() < 0.5 * semantic.mean()


def test_the_template_that_fits_is_chosen(mesh, seen):
    for frames, way in zip(seen, reversed(ON_FRAME), strict=True):
        chosen, expected = (f(frames[0], mesh, SONAR, pick(starts(), 0)) for f in (refine_on_frame, refined_by(way)))
        assert float(chosen.yaw) == pytest.approx(float(expected.yaw), abs=1e-5)
        assert float(chosen.score) == pytest.approx(float(expected.score), abs=1e-4)


def pick(pose, index):
    return sj.Pose(pose.x[index], pose.y[index], pose.yaw[index])


def refined_by(way):
    return lambda image, mesh, sonar, start: sj.refine_yaw(image, mesh, sonar, start, config=way)


def test_bounces_arrive_after_their_paths():
    """Of a pebble in mid-water: directly, by the floor on one way, and on both; by the image method's lengths."""
    pebble, z = sj.objects.brick(0.02, 0.02, 0.02), 0.25
    pose, window = sj.Pose(X, 0.0, 0.0, z), sj.Window(0, 0, SONAR.shape)
    subject = Subject(
        pebble, SONAR, pose, window, jnp.float32(0), jnp.int32(VIEWS["echo"]), nominal_law(), RenderQuality(), ()
    )
    energy = np.asarray(render_layers(subject, jnp.zeros(0)), np.float64)[:, 0].sum(axis=2)
    edges = np.asarray(SONAR.range_edges, np.float64)
    found = energy @ ((edges[1:] + edges[:-1]) / 2) / energy.sum(axis=1)
    direct, image = (math.hypot(X, float(SONAR.height) - side * (z + 0.01)) for side in (1, -1))
    # Only the near side is seen, half the pebble's length ahead of its middle.
    np.testing.assert_allclose(found, [direct, (direct + image) / 2, image], atol=0.012)


def test_a_bounce_on_one_way_does_not_pull_at_yaw(mesh):
    """It makes walls that meet the floor seem farther away, so that without it in the template yaw is worse."""
    device = replace(QUIET, floor_bounce=0.0)
    frame = jax.jit(lambda model, yaw: observe_scene(mesh, sj.Pose(X, Y, yaw), SONAR, model, key=jax.random.key(1))[0])
    error = {}
    for once in (0.0, 0.6):
        models = jax.tree.map(jnp.float32, replace(device, floor_bounce_once=once))
        images = jnp.stack([frame(models, yaw) for yaw in YAWS])
        error[once] = error_deg(sj.refine_yaw(images, mesh, SONAR, starts(), config=ON_FRAME[1]))
    print(f"\nwithout {error[0.0].round(2)}°, with one bounce {error[0.6].round(2)}°")
    assert error[0.6].mean() < error[0.0].mean() + 0.03


def test_derivatives_against_central_differences(mesh):
    """By yaw, x and y as far as the visible edges follow; by the bounces' energies exactly."""
    window = place_window(plan_window(mesh, SONAR, X), mesh, SONAR, X, Y)
    subject = Subject(
        mesh,
        SONAR,
        sj.Pose(X, Y, 0.4),
        window,
        jnp.float32(0),
        jnp.int32(VIEWS["echo"]),
        nominal_law(),
        RenderQuality(),
    )
    at = jnp.array([0.0, 0.0, 0.0, 0.2, 0.3])
    picture, slope = jax.jit(partial(draw_with_slope, subject))(at)
    drawn = jax.jit(partial(draw, subject))
    np.testing.assert_allclose(picture, drawn(at), atol=1e-3)  # other fusions, other roundings
    # Short steps: the stored value is the fourth root of an energy that is narrow in range.
    for k, (step, limit) in enumerate([(6e-4, 0.2), (3e-4, 0.1), (3e-4, 0.3), (1e-2, 0.01), (1e-2, 0.01)]):
        moved = step * jnp.eye(5)[k]
        expected = smooth((drawn(at + moved) - drawn(at - moved)) / (2 * step))
        off = np.linalg.norm(smooth(slope[k]) - expected) / np.linalg.norm(expected)
        print(f"number {k}: {off:.3f} off")
        assert off < limit


def draw_with_slope(subject, step):
    return paint_with_slope(subject, *layers_with_slope(subject, step), step[3:])


def smooth(image):
    """Blurred as the solver sees it: where an edge passes a pixel, differences of single pixels are rough."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(np.asarray(image), (2.0, 0.8))
