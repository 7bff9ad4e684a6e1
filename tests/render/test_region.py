"""Windows around objects: against points of the object turned one by one, and against whole frames."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sonarjax.render import RenderQuality, place_window, plan_window, render, template_bank
from sonarjax.render.region import leaning_room
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar

SONAR = Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
POST = Mesh.from_arrays(*objects.box((0.1, 0.1, 0.4), (0.0, 0.0, 0.2)))
HANGING = Mesh.from_arrays(*objects.box((0.06, 0.06, 0.6), (0.0, 0.0, -0.3)))


@pytest.mark.parametrize("roll_deg", [0.0, 5.0, -20.0, 45.0])
def test_windows_of_a_rolled_sonar_hold_the_object_s_beams(roll_deg):
    """Points of the post, rotated into the sonar's frame, fall into the columns of the window at each place in view."""
    sonar = SONAR.replace(roll=math.radians(roll_deg))
    to_ground = Rotation.from_euler("YX", [float(sonar.tilt), float(sonar.roll)]).as_matrix()
    beams = np.asarray(sonar.azimuth_edges, np.float64)
    rng = np.random.default_rng(0)
    places = 0
    for bearing in np.radians(np.linspace(-40, 40, 17)):
        x, y = 2.3 * math.cos(bearing), 2.3 * math.sin(bearing)
        points = rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.4], (4000, 3)) + [x, y, -0.9]
        ahead, aside, _ = (points @ to_ground).T
        touched = np.searchsorted(beams, np.arctan2(aside, ahead)) - 1
        touched = touched[(touched >= 0) & (touched < sonar.n_beams)]
        if not touched.size:
            continue
        size = plan_window(POST, sonar, 2.3)
        window = place_window(size, POST, sonar, x, y)
        assert int(window.column) <= touched.min() and touched.max() < int(window.column) + size.shape[1]
        assert np.ptp(touched) + 1 <= size.object_columns
        places += 1
    assert places >= 6


def test_a_sonar_without_roll_has_windows_as_wide_as_the_cylinder():
    """Straight ahead, tangents from the sonar to the rings at the floor and at the top bound the cylinder."""
    around = np.linspace(0, 2 * np.pi, 65)
    x, y = 2.3 + float(POST.radius) * np.cos(around), float(POST.radius) * np.sin(around)
    below = 0.9 - np.array([[0.0], [float(POST.top)]])
    width = 2 * np.arctan2(y, x * math.cos(0.4) + below * math.sin(0.4)).max()
    sonar = SONAR.replace(tilt=0.4)
    columns = math.ceil(width / float(np.diff(np.asarray(sonar.azimuth)).min()))
    assert plan_window(POST, sonar, 2.3).shape[1] == -(-(columns + 8) // 8) * 8
    assert plan_window(POST, sonar, 2.3).object_columns == -(-(columns + 2) // 4) * 4


@pytest.mark.parametrize(
    ("mesh", "x", "sonar_roll", "roll"),
    [(POST, 2.3, 0.35, 0.0), (HANGING, 2.6, 0.0, math.pi)],
    ids=["rolled", "flipped"],
)
def test_a_bank_loses_nothing_of_the_whole_frame(mesh, x, sonar_roll, roll):
    """A tall post under a rolled sonar; a post that hangs from its origin, turned upside down."""
    sonar = SONAR.replace(tilt=math.radians(15.0), roll=sonar_roll, range_max=jnp.float32(8.0), n_ranges=256)
    frame = render(mesh, Pose(x=x, roll=roll), sonar, quality=RenderQuality(sub_beams=1))
    bank = template_bank(mesh, sonar, [0.0], x=x, roll=roll)
    (row, column), (_, height, width) = np.asarray(bank.offset), bank.templates.shape
    whole = np.full(sonar.shape, 0.5)
    whole[row : row + height, column : column + width] = bank.templates[0]
    assert (np.abs(np.asarray(frame.semantic()) - 0.5) > 0.1).sum() > 300
    np.testing.assert_allclose(whole, frame.semantic(), atol=0.02)


@pytest.mark.parametrize("mesh", [POST, HANGING, objects.target()], ids=["post", "hanging", "target"])
def test_leaning_room_holds_the_turned_vertices(mesh):
    for roll in np.radians([0.0, 20.0, 90.0, 120.0, 180.0]):
        for pitch in np.radians([0.0, 60.0, 100.0, 170.0]):
            room = leaning_room(mesh, 0.05, roll, pitch)
            turned = np.asarray(Pose(0.0, 0.0, 0.3, 0.05, roll, pitch).to_ground(mesh.vertices))
            assert turned[:, 2].max() <= float(room.top) + 1e-5
            assert np.hypot(turned[:, 0], turned[:, 1]).max() <= float(room.radius) + 1e-5
    upright = leaning_room(mesh, 0.0, 0.0, 0.0)
    assert (float(upright.top), float(upright.radius)) == (float(mesh.top), float(mesh.radius))
