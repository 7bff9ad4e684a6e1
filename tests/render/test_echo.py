"""`render_echo` against the energy that `render` integrates over elevation (eq. 2)."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.render import RenderQuality, Window, floor_angle, render_echo
from sonarjax.sensor.multipath import without_floor

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)


@jax.jit
def echo_of(mesh, pose, sonar):
    return render_echo(mesh, pose, sonar, Window(0, 0, SONAR.shape), RenderQuality())


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [0.0, 33.0, 70.0])
def test_elevation_times_spreading_is_the_energy(yaw_deg: float) -> None:
    mesh, pose = sj.objects.target(), sj.Pose(2.3, 0.05, math.radians(yaw_deg))
    ground = mesh.with_vertices(pose.to_ground(mesh.vertices))
    view = without_floor(ground, SONAR)
    energy = np.asarray(sj.render(*view, quality=RenderQuality(4, 128)).intensity, np.float64)
    echo, _, shadow = echo_of(*view)
    edges = np.asarray(SONAR.range_edges, np.float64)
    middles = (edges[1:] + edges[:-1])[:, None] / 2
    ours = np.asarray(echo) * middles ** -float(SONAR.spreading_exponent)
    assert ours.sum() == pytest.approx(energy.sum(), rel=0.005)
    assert np.linalg.norm(ours - energy) < 0.05 * np.linalg.norm(energy)
    assert float(np.asarray(shadow).max()) == 0.0  # no floor, no shadow


@pytest.mark.slow
def test_shadow_is_that_of_render() -> None:
    mesh, pose = sj.objects.target(), sj.Pose(2.3, 0.05, 0.6)
    expected = np.asarray(sj.render(mesh, pose, SONAR).shadow)
    np.testing.assert_allclose(echo_of(mesh, pose, SONAR).shadow, expected, atol=0.01)


def test_echo_fades_about_the_incidence_limit() -> None:
    """The limit is where the top of a box is hit: half of its echo is left, and all of the front's. Closed form."""
    front, back, top, height = 2.2, 2.3, 0.1, 0.9
    mesh = sj.objects.brick(back - front, 0.6, top)
    pose = sj.Pose(x=(front + back) / 2)
    limit = math.degrees(math.atan2(pose.x, height - top))
    whole, left = (
        echo_of(mesh, pose, SONAR.replace(highlight_max_incidence=jnp.float32(degrees))) for degrees in (90.0, limit)
    )
    down = [math.atan2(height - z, x) for x, z in ((front, 0.0), (front, top), (back, top))]
    of_front, of_top = down[0] - down[1], down[1] - down[2]
    assert np.asarray(whole.echo)[:, 48].sum() == pytest.approx(of_front + of_top, rel=1e-3)
    assert np.asarray(left.echo)[:, 48].sum() == pytest.approx(of_front + of_top / 2, rel=1e-2)
    # What is labelled highlight ends at the limit itself.
    above, below = (
        echo_of(mesh, pose, SONAR.replace(highlight_max_incidence=jnp.float32(limit + by))) for by in (3, -3)
    )
    np.testing.assert_allclose(above.highlight, whole.highlight, atol=1e-5)
    bins = [float(np.asarray(frame.highlight)[:, 48].sum()) for frame in (whole, below)]
    assert bins[1] < 0.7 * bins[0]


@pytest.mark.parametrize("limit", [45.0, 60.0])
def test_a_round_body_is_highlight_up_to_the_incidence_limit(limit: float) -> None:
    """As `render` has it. Its echo fades over several facets; the derivative is right in sum."""
    mesh, pose = sj.objects.ball(), sj.Pose(2.2, 0.1)

    def seen(limit: jax.Array) -> Any:
        return echo_of(mesh, pose, SONAR.replace(highlight_max_incidence=limit))

    expected = np.asarray(sj.render(mesh, pose, SONAR.replace(highlight_max_incidence=limit)).highlight)
    assert float(seen(jnp.float32(limit)).highlight.sum()) == pytest.approx(expected.sum(), rel=0.05)
    _, slope = jax.jvp(lambda at: seen(at).echo.sum(), (jnp.float32(limit),), (jnp.float32(1.0),))
    up, down = (float(seen(jnp.float32(limit + by)).echo.sum()) for by in (2, -2))
    assert float(slope) == pytest.approx((up - down) / 4, rel=0.05)


@pytest.mark.slow
def test_derivative_of_the_echo_by_the_incidence_limit() -> None:
    """Central differences, alone and beside the derivative by yaw."""

    def echo(limit: jax.Array, yaw: jax.Array) -> jax.Array:
        sonar = SONAR.replace(highlight_max_incidence=limit)
        return echo_of(sj.objects.target(), sj.Pose(2.3, 0.05, yaw), sonar).echo

    at, step, nothing = (jnp.float32(67.0), jnp.float32(0.6)), jnp.float32(0.1), jnp.float32(0.0)
    expected = (np.asarray(echo(at[0] + step, at[1])) - np.asarray(echo(at[0] - step, at[1]))) / (2 * float(step))
    scale = np.abs(expected).max()
    _, slope = jax.jvp(echo, at, (jnp.float32(1.0), nothing))
    np.testing.assert_allclose(slope, expected, atol=0.01 * scale)
    _, by_yaw = jax.jvp(echo, at, (nothing, jnp.float32(1.0)))
    _, by_both = jax.jvp(echo, at, (jnp.float32(1.0), jnp.float32(1.0)))
    np.testing.assert_allclose(by_both - by_yaw, slope, atol=1e-3 * np.abs(by_yaw).max())
    back = jax.grad(lambda limit: (echo(limit, at[1]) ** 2).sum())(at[0])
    assert float(back) == pytest.approx(float((2 * echo(*at) * slope).sum()), rel=1e-3)


def test_angle_of_a_bin_of_floor() -> None:
    """The difference of the elevations asin(height / range) at its two edges."""
    middles = np.array([1.6, 2.3, 3.9])
    bin_m = float(SONAR.range_bin)
    low, high = (np.arcsin(0.9 / (middles + sign * bin_m / 2)) for sign in (1, -1))
    np.testing.assert_allclose(floor_angle(jnp.asarray(middles, jnp.float32), SONAR), high - low, rtol=1e-3)
    assert np.isfinite(floor_angle(jnp.float32(0.5), SONAR))
