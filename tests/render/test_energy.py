"""Lambert's law for the floor: cosines of incidence of single rays."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sonarjax.render.energy import floor_energy
from sonarjax.render.window import in_sonar_frame
from sonarjax.scene import Pose, objects
from sonarjax.sonar import Sonar


@pytest.mark.parametrize(
    ("preset", "tilt_deg", "roll_deg"), [("oculus", 45, 0), ("oculus", 25, 8), ("didson-hf", 25, 0)]
)
def test_lamberts_law_takes_the_incidence_on_the_floor(preset, tilt_deg, roll_deg):
    """The exponent 1 divides the energy of exponent 0 by as much as a ray's angle from the vertical says."""
    sonar = Sonar.preset(preset, tilt=math.radians(tilt_deg), roll=math.radians(roll_deg), height=1.5, range_min=1.6)
    scene = in_sonar_frame(objects.brick(), Pose(), sonar)
    azimuth, edges = jnp.asarray(sonar.azimuth), jnp.asarray(sonar.range_edges)
    plain, lambert = (
        np.asarray(floor_energy(azimuth, scene, sonar.replace(lambert=v), edges), np.float64) for v in (0.0, 1.0)
    )
    elevation = np.linspace(-0.5, 0.5, 401) * float(sonar.elevation_aperture)
    middles = np.asarray(edges[1:] + edges[:-1]) / 2
    to_ground = Rotation.from_euler("YX", [math.radians(tilt_deg), math.radians(roll_deg)]).as_matrix()
    for beam in (0, sonar.n_beams // 2, sonar.n_beams - 1):
        theta = float(azimuth[beam])
        rays = [np.cos(elevation) * math.cos(theta), np.cos(elevation) * math.sin(theta), np.sin(elevation)]
        down = -(to_ground @ np.stack(rays))[2]  # the cosine of incidence on a level floor
        ranges = np.where(down > 0, 1.5 / np.maximum(down, 1e-9), np.inf)
        seen = (middles > ranges.min() * 1.001) & (middles < ranges[np.isfinite(ranges)].max() * 0.999)
        seen &= plain[:, beam] > 1e-7
        assert seen.sum() > 30
        order = np.argsort(ranges)
        expected = np.interp(middles[seen], ranges[order], down[order])
        np.testing.assert_allclose(lambert[seen, beam] / plain[seen, beam], expected, rtol=2e-3)
