"""Records: equal by value, whatever holds the values."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render import SonarFrame
from sonarjax.scene import Mesh, Pose, objects, stack_meshes
from sonarjax.sonar import FloorPatch, Sonar

FLOOR = FloorPatch(2.0, 0.0, 1.0, 1.0)


def frame(sonar: Sonar) -> SonarFrame:
    layer = jnp.zeros((2, 3))
    return SonarFrame(layer, layer, layer, layer > 0, jnp.int32(0), sonar)


def brick(length: float = 0.2) -> Mesh:
    return objects.brick(length)


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (lambda: Sonar.preset("didson-hf"), lambda one: one.replace(tilt=0.1)),
        (lambda: Sonar.preset("didson-hf"), lambda one: one.replace(azimuth=one.azimuth + 0.01)),
        (lambda: Sonar.preset("didson-hf"), lambda one: one.replace(azimuth=one.azimuth[:1])),
        (lambda: Sonar.preset("didson-hf"), lambda one: one.replace(n_ranges=100)),
        (lambda: Sonar.preset("didson-hf"), lambda one: one.replace(floor=FLOOR)),
        (lambda: Pose(2.0, yaw=jnp.arange(3.0)), lambda one: replace(one, yaw=one.yaw + 1)),
        (lambda: Pose(2.0, yaw=jnp.arange(3.0)), lambda one: jax.tree.map(lambda leaf: leaf[:2], one)),
        (brick, lambda one: brick(0.3)),
        (brick, lambda one: stack_meshes([one])),
        (lambda: frame(Sonar.preset("oculus")), lambda one: replace(one, sonar=one.sonar.replace(height=2.0))),
    ],
)
def test_records_are_equal_by_value(make, change) -> None:
    assert make() == make()
    assert make() == jax.tree.map(np.asarray, make())
    assert change(make()) != make()


def test_other_things_are_no_record() -> None:
    pose = Pose(yaw=jnp.arange(3.0))
    assert pose != (pose.x, pose.y, pose.yaw, pose.z, pose.roll, pose.pitch) and pose != brick() and pose != 3
    assert pose in [brick(), None, pose]


def test_what_is_not_a_number_is_equal_to_itself_only() -> None:
    pose = Pose(yaw=jnp.array([jnp.nan, 0.0]))
    assert pose == replace(pose) and pose != Pose(yaw=jnp.array([jnp.nan, 0.0]))


def test_only_records_of_plain_numbers_have_a_hash() -> None:
    assert hash(FLOOR) == hash(FloorPatch(2, 0, 1, 1)) and FloorPatch(2, 0, 1, 1) == FLOOR
    for one in (Pose(), Sonar.preset("didson-hf")):
        with pytest.raises(TypeError, match="unhashable"):
            hash(one)


def test_traced_records_have_no_truth_value() -> None:
    with pytest.raises(jax.errors.TracerBoolConversionError):
        jax.jit(lambda pose: pose == Pose(2.0))(Pose(2.0))
