"""A platform whose side passes under the sonar: floor on the platform's side alone, and finite derivatives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render.energy import floor_energy
from sonarjax.render.platform import platform_lit
from sonarjax.render.window import in_sonar_frame
from sonarjax.scene import Pose, objects
from sonarjax.sonar import Sonar
from sonarjax.sonar.parts import FloorPatch

SONAR = Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9, n_ranges=64)
PORT = np.asarray(SONAR.azimuth) > 0


def floor_of(sonar):
    """Energy and lit pixels (range, beam) of the bare floor or platform."""
    scene = in_sonar_frame(objects.brick(), Pose(), sonar)
    azimuth, edges = jnp.asarray(sonar.azimuth), jnp.asarray(sonar.range_edges)
    return floor_energy(azimuth, scene, sonar, edges), platform_lit(azimuth, scene, sonar, edges)


@pytest.mark.parametrize("roll", [0.0, 5e-10, -5e-10])  # rounding may put the side a little off the sonar's axis
@pytest.mark.parametrize("side", ["port", "starboard"])
def test_a_side_through_the_point_under_the_sonar(side, roll):
    """The slices on one side of the line y = 0 see the platform as an endless floor, those on the other see nothing."""
    middle = 2.0 if side == "port" else -2.0
    patch = FloorPatch(x=5.0, y=middle, length=10.0, width=4.0)
    energy, lit = floor_of(SONAR.replace(floor=patch, roll=roll))
    endless, _ = floor_of(SONAR)
    on = PORT if side == "port" else ~PORT
    assert not np.asarray(lit)[:, ~on].any() and np.asarray(energy)[:, ~on].max() == 0.0
    assert np.asarray(lit)[:, on].all()
    np.testing.assert_allclose(energy[:, on], endless[:, on], rtol=1e-6)


def test_a_side_through_the_point_under_the_sonar_has_finite_derivatives():
    def total(place, roll):
        x, y, length, width, yaw = place
        patch = FloorPatch(x=x, y=y, length=length, width=width, yaw=yaw)
        return floor_of(SONAR.replace(floor=patch, roll=roll))[0].sum()

    slopes = jax.grad(total, argnums=(0, 1))(jnp.array([2.5, 0.5, 1.0, 1.0, 0.0]), jnp.float32(0.0))
    assert np.isfinite(slopes[0]).all() and np.isfinite(slopes[1])
    assert slopes[0][0] != 0  # the far side lies in view
