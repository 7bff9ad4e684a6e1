"""Where an object stands: position on the floor and rotation, as a pytree of floats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Any  # a Python float, a NumPy scalar or a JAX array of any batch shape


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pose:
    """Pose of an object in the ground frame (x forward, y to port, z up; origin on the floor under the sonar).

    Every field is a float or an array; a `Pose` whose fields all have shape (batch,) is a batch for `jax.vmap`.
    The rotation is yaw, then pitch, then roll about the object's own axes: R = Rz(yaw) Ry(pitch) Rx(roll).
    """

    x: Scalar = 0.0
    """Forward position of the mesh origin [m]."""
    y: Scalar = 0.0
    """Position to port of the mesh origin [m]."""
    yaw: Scalar = 0.0
    """Rotation about the vertical, counter-clockwise from above [rad]."""
    z: Scalar = 0.0
    """Height of the mesh origin above the floor [m]."""
    roll: Scalar = 0.0
    """Rotation about the object's x axis [rad]."""
    pitch: Scalar = 0.0
    """Rotation about the object's y axis, positive nose down [rad]."""

    def to_ground(self, vertices: Float[Array, "vertex 3"]) -> Float[Array, "vertex 3"]:
        """Vertices (vertex, 3) [m] of the mesh frame, moved to the ground frame [m]."""
        rotation = rotation_z(self.yaw) @ rotation_y(self.pitch) @ rotation_x(self.roll)
        return vertices @ rotation.T + jnp.stack([jnp.asarray(v, jnp.float32) for v in (self.x, self.y, self.z)])


def rotation_x(angle: Scalar) -> Float[Array, "3 3"]:
    """Rotation matrix (3, 3) about x by `angle` [rad]."""
    c, s, o, i = _terms(angle)
    return jnp.stack([jnp.stack([i, o, o]), jnp.stack([o, c, -s]), jnp.stack([o, s, c])])


def rotation_y(angle: Scalar) -> Float[Array, "3 3"]:
    """Rotation matrix (3, 3) about y by `angle` [rad]."""
    c, s, o, i = _terms(angle)
    return jnp.stack([jnp.stack([c, o, s]), jnp.stack([o, i, o]), jnp.stack([-s, o, c])])


def rotation_z(angle: Scalar) -> Float[Array, "3 3"]:
    """Rotation matrix (3, 3) about z by `angle` [rad]."""
    c, s, o, i = _terms(angle)
    return jnp.stack([jnp.stack([c, -s, o]), jnp.stack([s, c, o]), jnp.stack([o, o, i])])


def _terms(angle: Scalar) -> tuple[Array, Array, Array, Array]:
    angle = jnp.asarray(angle, jnp.float32)
    return jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
