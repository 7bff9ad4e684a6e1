"""Objects that are too large for the sonar's view, and searches over too much floor, before anything is rendered."""

import math

import pytest

from sonarjax import Sonar
from sonarjax.io import SonarjaxError
from sonarjax.recognize import Recognizer
from sonarjax.render import check_fits, render
from sonarjax.scene import Mesh, Pose, objects

FACES = [[0, 1, 2]]


def triangle(length):
    """A mesh [m] of one triangle of that length."""
    return Mesh.from_arrays([[0, 0, 0], [length, 0, 0], [0, length / 2, 0]], FACES)


def test_an_object_larger_than_the_view():
    sonar = Sonar.preset("didson-hf")  # 1.5 to 4 m
    check_fits(triangle(3.9), sonar, "part.stl")
    for length in (4.1, 90.0):
        with pytest.raises(SonarjaxError, match=rf"part.stl: the mesh is {length:g} m long.* 4 m .*unit_m=0.001"):
            check_fits(triangle(length), sonar, "part.stl")
    with pytest.raises(SonarjaxError, match="target: the mesh is 90 m long"):
        Recognizer(triangle(90.0), sonar)


def test_a_search_over_too_many_distances():
    steep = Sonar.preset("didson-hf", tilt=math.radians(7), height=100.0, range_min=1.0, range_max=1000.0)
    with pytest.raises(
        SonarjaxError, match=r"from 401.* to 995 m, 5941 distances of 0.1 m; expected at most 1000: give"
    ):
        Recognizer(objects.brick(), steep)


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ({"x": 1e20}, "pose: x: expected a number from -1e[+]06 to 1e[+]06 m, got 1e[+]20"),
        ({"y": math.nan}, "pose: y: .* got nan"),
        ({"z": -math.inf}, "pose: z: .* got -inf"),
        ({"yaw": 1e30}, "pose: yaw: .* rad, got 1e[+]30"),
    ],
)
def test_poses_beyond_float32(pose, said):
    with pytest.raises(SonarjaxError, match=said):
        render(objects.brick(), Pose(**pose), Sonar.preset("didson-hf"))
    with pytest.raises(SonarjaxError, match=said):
        render([objects.brick()], [Pose(**pose)], Sonar.preset("didson-hf"))
