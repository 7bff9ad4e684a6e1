"""`Pose` against SciPy's rotations, and as a pytree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sonarjax.scene import Pose

POINTS = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (20, 3)), jnp.float32)


@pytest.mark.parametrize("seed", range(5))
def test_to_ground_agrees_with_scipy(seed):
    x, y, z, yaw, pitch, roll = np.random.default_rng(seed).uniform(-3, 3, 6)
    moved = Pose(x=x, y=y, yaw=yaw, z=z, roll=roll, pitch=pitch).to_ground(POINTS)
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(POINTS) + [x, y, z]
    np.testing.assert_allclose(moved, expected, atol=2e-6)  # float32


def test_signs():
    np.testing.assert_allclose(Pose(yaw=jnp.pi / 2).to_ground(jnp.eye(3))[0], [0, 1, 0], atol=1e-6)  # bow to port
    assert Pose(pitch=0.1).to_ground(jnp.eye(3))[0, 2] < 0  # nose down
    assert Pose(roll=0.1).to_ground(jnp.eye(3))[1, 2] > 0  # port side up


def test_default_pose_moves_nothing():
    np.testing.assert_array_equal(Pose().to_ground(POINTS), POINTS)


def test_pose_is_a_pytree_of_six_float32_of_one_shape():
    leaves = jax.tree.leaves(Pose(x=2.2, yaw=np.float64(0.3)))
    assert [leaf.dtype for leaf in leaves] == [jnp.float32] * 6
    np.testing.assert_allclose(leaves, [2.2, 0.0, 0.3, 0.0, 0.0, 0.0])
    batch = Pose(x=np.zeros((4, 1)), y=1, yaw=jnp.zeros(3, jnp.bfloat16))
    assert batch.shape == (4, 3)
    assert {leaf.shape for leaf in jax.tree.leaves(batch)} == {(4, 3)}
    assert {leaf.dtype for leaf in jax.tree.leaves(batch)} == {jnp.dtype("float32")}


def test_a_pose_keeps_its_numbers_when_the_array_it_was_made_from_changes():
    """JAX takes over memory that is aligned to 64 bytes."""
    memory = np.zeros(128, np.uint8)
    start = -memory.ctypes.data % 64
    x = memory[start : start + 32].view(np.float32)
    pose = Pose(x=x)
    x[:] = 9.0
    np.testing.assert_array_equal(pose.x, np.zeros(8))


def test_what_does_not_broadcast_is_refused():
    with pytest.raises(ValueError, match="broadcast"):
        Pose(x=np.zeros(2), yaw=np.zeros(3))


def test_placeholders_pass_through_untouched():
    """JAX rebuilds a pose from axes, specs and None: the constructor must not see them."""
    pose = Pose(x=2.2)
    for leaf in (0, None, "axis"):
        leaves, structure = jax.tree.flatten(jax.tree.map(lambda _, v=leaf: v, pose), is_leaf=lambda v: v is None)
        assert leaves == [leaf] * 6
        assert jax.tree.unflatten(structure, leaves).x == leaf


def test_vmap_over_a_batch_of_poses():
    yaws = jnp.linspace(0.0, 3.0, 4)
    batch = Pose(2.2, 0.1, yaw=yaws, z=0.1 * yaws, roll=-yaws, pitch=yaws / 2)
    moved = jax.vmap(lambda pose: pose.to_ground(POINTS))(batch)
    assert moved.shape == (4, 20, 3)
    for i in range(4):
        single = jax.tree.map(lambda leaf, i=i: leaf[i], batch)
        np.testing.assert_allclose(moved[i], single.to_ground(POINTS), atol=1e-6)


@pytest.mark.parametrize("count", [2, 3])
def test_a_batch_of_poses_has_a_rotation_each(count):
    angles = jnp.linspace(0.1, 2.0, count)
    batch = Pose(2.2, angles, yaw=angles, roll=-angles, pitch=angles / 2)
    rotations, moved = batch.rotation(), batch.to_ground(POINTS)
    assert rotations.shape == (count, 3, 3)
    for i in range(count):
        single = jax.tree.map(lambda leaf, i=i: leaf[i], batch)
        np.testing.assert_allclose(rotations[i], single.rotation(), atol=1e-6)
        np.testing.assert_allclose(moved[i], single.to_ground(POINTS), atol=1e-6)


def test_gradient_equals_finite_differences():
    weights = jnp.asarray(np.random.default_rng(1).normal(size=(20, 3)), jnp.float32)

    def loss(values):
        return (Pose(*values).to_ground(POINTS) * weights).sum()

    values = jnp.array([2.2, 0.1, 0.3, 0.05, -0.2, 0.4])
    gradient = jax.grad(loss)(values)
    step = 1e-2
    for i in range(6):
        shift = jnp.zeros(6).at[i].set(step)
        difference = (loss(values + shift) - loss(values - shift)) / (2 * step)
        assert abs(gradient[i] - difference) < 1e-3 * float(jnp.abs(gradient).max()) + 1e-3  # float32 and step²
    assert np.all(np.abs(gradient) > 1e-3)
