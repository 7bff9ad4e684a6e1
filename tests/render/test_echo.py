"""`render_echo` against the energy that `render` integrates over elevation (eq. 2)."""

import math

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


def test_angle_of_a_bin_of_floor() -> None:
    """The difference of the elevations asin(height / range) at its two edges."""
    middles = np.array([1.6, 2.3, 3.9])
    bin_m = float(SONAR.range_bin)
    low, high = (np.arcsin(0.9 / (middles + sign * bin_m / 2)) for sign in (1, -1))
    np.testing.assert_allclose(floor_angle(jnp.asarray(middles, jnp.float32), SONAR), high - low, rtol=1e-3)
    assert np.isfinite(floor_angle(jnp.float32(0.5), SONAR))
