"""The template bank: crops of the full frame's semantic image, over any list of yaws."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.engine import Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.render import RenderQuality, WindowSize, bank_place, floor_point, image_azimuth, render, template_bank
from sonarjax.render.region import leaning_room, plan_window
from sonarjax.render.visibility import EXACT_LIMIT
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar

SONAR = Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
X, Y = 2.25, -0.1
YAWS = np.radians(np.arange(0.0, 360.0, 10.0))
LIFT, ROLL, PITCH = 0.06, 0.2, -0.15


@pytest.fixture(scope="module")
def brick():
    return objects.brick()


@pytest.fixture(scope="module")
def bank(brick):
    return template_bank(brick, SONAR, YAWS, x=X, y=Y)


@pytest.fixture(scope="module")
def roomy(brick):
    """A window that holds the brick in any attitude here: banks that are given it share compiled code."""
    return plan_window(leaning_room(brick, LIFT, ROLL, -PITCH), SONAR, math.hypot(X, Y))


def full(brick, yaw, z=0.0, roll=0.0, pitch=0.0):
    """The whole frame's semantic image at the bank's own quality."""
    pose = Pose(*np.array([X, Y, yaw, z, roll, pitch], np.float32))
    return np.asarray(render(brick, pose, SONAR, quality=RenderQuality(sub_beams=1)).semantic())


@pytest.mark.parametrize("step_deg", [10.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_template_for_each_yaw(brick, step_deg):
    every = np.radians(np.arange(0.0, 360.0, step_deg))
    bank = template_bank(brick, SONAR, every, x=X, y=Y)
    yaws, h, w = bank.templates.shape
    assert yaws == len(every) and bank.templates.dtype == jnp.float32
    assert h < 256 and w < 48  # the object's box, not the frame: 360 whole frames would take 70 MB
    assert bank.templates.nbytes < 20e6
    np.testing.assert_allclose(bank.yaws, every, atol=1e-6)
    values = np.asarray(bank.templates)
    assert -1e-6 <= values.min() < 0.02 and 0.98 < values.max() <= 1 + 1e-6  # float32
    assert float(bank.bearing) == pytest.approx(math.atan2(Y, X)) and float(bank.ground_range) == pytest.approx(
        math.hypot(X, Y)
    )
    assert [float(v) for v in (bank.x, bank.y, bank.tilt)] == pytest.approx([X, Y, math.radians(20.0)])


@pytest.mark.parametrize("index", [0, 4, 20, 35])
def test_templates_are_crops_of_the_frame(brick, bank, index):
    image = full(brick, YAWS[index])
    row, column = bank.offset
    _, h, w = bank.templates.shape
    inside = np.zeros(image.shape, bool)
    inside[row : row + h, column : column + w] = True
    np.testing.assert_allclose(bank.templates[index], image[row : row + h, column : column + w], atol=1e-4)
    assert np.abs(image[~inside] - 0.5).max() < 0.011  # nothing of the object is cut off


@pytest.mark.slow
def test_a_pipe_seen_along_its_axis():
    """Slabs must end at its edges: else its shadow is smeared over tens of range bins, and the bank's crop grows."""
    vertices, faces = objects.cylinder_arrays(0.055, 0.24, sides=64)
    lying = np.stack([vertices[:, 2] - 0.12, vertices[:, 1], 0.055 - vertices[:, 0]], axis=1)
    pipe = Mesh.from_arrays(lying, faces, name="pipe")
    assert pipe.crossings > EXACT_LIMIT and pipe.crease.shape[-1] > pipe.events
    bank = template_bank(pipe, SONAR, YAWS[[0, 4, 9]], x=1.8)
    row, column = bank.offset
    _, h, w = bank.templates.shape
    for template, yaw in zip(np.asarray(bank.templates), np.asarray(bank.yaws), strict=True):
        frame = render(pipe, Pose(1.8, 0.0, yaw), SONAR, quality=RenderQuality(sub_beams=1)).semantic()
        np.testing.assert_allclose(template, frame[row : row + h, column : column + w], atol=0.05)


def test_a_sonar_of_a_single_beam(brick):
    narrow = SONAR.replace(azimuth=jnp.zeros(1), beam_width=0.01)
    bank = template_bank(brick, narrow, [0.0], x=X)
    assert bank.templates.shape[2] == 1 and float(bank.templates.max()) > 0.9


def test_margin_around_the_union_of_all_yaws(bank):
    touched = (np.abs(np.asarray(bank.templates) - 0.5) > 0.01).any(0)
    rows, columns = np.flatnonzero(touched.any(1)), np.flatnonzero(touched.any(0))
    h, w = touched.shape
    assert (rows[0], h - 1 - rows[-1], columns[0], w - 1 - columns[-1]) == (12, 12, 3, 3)


@pytest.mark.parametrize("margin", [(0, 0), (40, 10), (600, 96)])
def test_any_margin_around_what_the_object_touches(brick, margin):
    """However large: what lies beyond the window that was rendered is background, and the frame's edges end it."""
    image = full(brick, YAWS[0])
    touched = np.abs(image - 0.5) > 0.01
    bank = template_bank(brick, SONAR, YAWS[:1], x=X, y=Y, margin=margin)
    corner, shape = np.asarray(bank.offset), bank.templates.shape[1:]
    for axis in (0, 1):
        places = np.flatnonzero(touched.any(1 - axis))
        first, last = max(places[0] - margin[axis], 0), min(places[-1] + margin[axis], image.shape[axis] - 1)
        assert (corner[axis], shape[axis]) == (first, last + 1 - first)
    row, column = corner
    np.testing.assert_allclose(bank.templates[0], image[row : row + shape[0], column : column + shape[1]], atol=0.011)


def test_templates_differ_between_yaws(bank):
    """A brick looks the same after half a turn, and different after a quarter."""
    values = np.asarray(bank.templates)
    assert np.abs(values[0] - values[18]).max() < 1e-3
    assert np.abs(values[0] - values[9]).mean() > 0.01


def test_any_list_of_yaws(brick):
    wild = [7.0, -0.5, 0.2, 7.0]
    bank = template_bank(brick, SONAR, wild, x=X, y=Y)
    np.testing.assert_allclose(bank.yaws, wild, atol=1e-6)
    row, column = bank.offset
    _, h, w = bank.templates.shape
    for template, yaw in zip(np.asarray(bank.templates), wild, strict=True):
        np.testing.assert_allclose(template, full(brick, yaw)[row : row + h, column : column + w], atol=1e-4)
    np.testing.assert_array_equal(bank.templates[0], bank.templates[3])


@pytest.mark.parametrize(
    ("count", "at_once", "calls"), [(36, 1, 2), (36, 2, 2), (36, 4, 4), (9, 1, 1), (9, 4, 1), (40, 2, 3)]
)
def test_calls_are_long_unless_threads_would_idle(brick, bank, count, at_once, calls):
    """What a call renders does not depend on how many it renders."""

    class Counting(Engine):
        made = 0
        at_once = property(lambda _: at_once)

        def run(self, function, *args, **static):
            self.made += 1
            return super().run(function, *args, **static)

    engine = Counting()
    found = template_bank(brick, SONAR, np.resize(YAWS, count), x=X, y=Y, engine=engine)
    assert engine.made == calls
    if count == len(YAWS):
        np.testing.assert_allclose(found.templates, bank.templates, atol=1e-6)


@pytest.mark.parametrize("yaws", [[], [0.0, math.nan], [math.inf], [[0.0, 1.0]]])
def test_bad_yaws_are_refused(brick, yaws):
    with pytest.raises(SonarjaxError, match="yaws"):
        template_bank(brick, SONAR, yaws, x=X)


@pytest.mark.parametrize(("x", "y"), [(6.0, 0.0), (-2.2, 0.0), (2.2, 2.0), (0.4, 0.0)])
@pytest.mark.parametrize("planned", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_out_of_view_is_refused(brick, x, y, planned):
    whole = WindowSize(SONAR.shape)
    with pytest.raises(SonarjaxError, match="outside the sonar's view"):
        template_bank(brick, SONAR, [0.0, 1.0], x=x, y=y, size=None if planned else whole)


def test_a_window_that_would_cut_the_object_is_refused(brick):
    far = plan_window(brick, SONAR, 3.5)
    with pytest.raises(SonarjaxError, match="size: expected one that holds"):
        template_bank(brick, SONAR, [0.0], x=1.7, size=far)


def test_floor_point_is_the_inverse_of_image_azimuth():
    rng = np.random.default_rng(0)
    for tilt in (0.0, 0.26, 0.35, 0.44):
        sonar = SONAR.replace(tilt=tilt)
        x, y = jnp.asarray(rng.uniform([1.4, -0.8], [3.8, 0.8], (200, 2)).T, jnp.float32)
        back = floor_point(jnp.sqrt(x**2 + y**2 + 0.81), image_azimuth(x, y, sonar), sonar)
        np.testing.assert_allclose(back[0], x, atol=1e-5)
        np.testing.assert_allclose(back[1], y, atol=1e-5)


def test_bank_place_is_where_the_object_stands(bank):
    slant, azimuth = bank_place(bank, SONAR)
    assert slant == pytest.approx(math.sqrt(X**2 + Y**2 + 0.81))
    x, y = floor_point(slant, azimuth, SONAR)
    assert (float(x), float(y)) == (pytest.approx(X, abs=1e-5), pytest.approx(Y, abs=1e-5))
    # In the image: inside the bank's box, right of its first column.
    row = (slant - float(SONAR.range_min)) / float(SONAR.range_bin) - bank.offset[0]
    column = int(np.searchsorted(np.asarray(SONAR.azimuth_edges), azimuth)) - 1 - bank.offset[1]
    assert 0 < row < bank.templates.shape[1] and 0 < column < bank.templates.shape[2]


def test_a_leaning_template_is_a_crop_of_its_frame(brick, roomy):
    yaws, z, roll, pitch = np.array([[0.4, 2.0], [0.0, LIFT], [0.0, ROLL], [0.0, PITCH]], np.float32)
    bank = template_bank(brick, SONAR, yaws, x=X, y=Y, z=z, roll=roll, pitch=pitch, size=roomy)
    top, left = np.asarray(bank.offset)
    height, width = bank.templates.shape[1:]
    for k in range(2):
        frame = full(brick, yaws[k], z[k], roll[k], pitch[k])
        inside = frame[top : top + height, left : left + width]
        np.testing.assert_allclose(bank.templates[k], inside, atol=2e-4)
        assert np.abs(frame - 0.5).sum() == pytest.approx(np.abs(inside - 0.5).sum(), rel=1e-4)
    assert np.abs(frame - full(brick, yaws[1])).max() > 0.5  # to lean makes a difference
    with pytest.raises(SonarjaxError, match="roll: expected a finite number or one for each of 2 yaws"):
        template_bank(brick, SONAR, yaws, x=X, y=Y, roll=np.zeros(3))
