"""Where an object stands: position on the floor and rotation, as a pytree of float32 fields of one shape."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.exact import full_precision
from sonarjax.io.given import number_array
from sonarjax.records import record

Scalar = Any  # a Python float, a NumPy scalar or a JAX array of any batch shape


@record
class Pose:
    """Pose of an object in the ground frame (x forward, y to port, z up; origin on the floor under the sonar).

    The constructor broadcasts numbers and arrays to float32 fields of one shape `*batch`. A batch of poses is a batch
    for `render` and for `jax.vmap`: `jax.vmap(f)(Pose(x=xs, y=0.0, yaw=yaws))`. The rotation is yaw, then pitch, then
    roll about the object's own axes: R = Rz(yaw) Ry(pitch) Rx(roll).

    >>> Pose(x=2.0, y=[0.0, 0.5], yaw=0.0).shape
    (2,)
    """

    x: Float[Array, "*batch"]
    """Forward position of the mesh origin [m]."""
    y: Float[Array, "*batch"]
    """Position to port of the mesh origin [m]."""
    yaw: Float[Array, "*batch"]
    """Rotation about the vertical, counter-clockwise from above [rad]."""
    z: Float[Array, "*batch"]
    """Height of the mesh origin above the floor [m]."""
    roll: Float[Array, "*batch"]
    """Rotation about the object's x axis [rad]."""
    pitch: Float[Array, "*batch"]
    """Rotation about the object's y axis, positive nose down [rad]."""

    def __init__(
        self,
        x: Scalar = 0.0,
        y: Scalar = 0.0,
        yaw: Scalar = 0.0,
        z: Scalar = 0.0,
        roll: Scalar = 0.0,
        pitch: Scalar = 0.0,
    ) -> None:
        """Broadcast positions [m] and angles [rad] to one shape.

        Raises ValueError if their shapes do not broadcast, and SonarjaxError for text or anything else but numbers.
        """
        given = {"x": x, "y": y, "yaw": yaw, "z": z, "roll": roll, "pitch": pitch}
        numbers = {name: _as_floats(value, name) for name, value in given.items()}
        shape = jnp.broadcast_shapes(*(v.shape for v in numbers.values()))
        for name, value in numbers.items():
            object.__setattr__(self, name, _spread_out(value, shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape `*batch` of every field."""
        return tuple(self.x.shape)

    @full_precision
    def to_ground(self, vertices: Float[Array, "vertex 3"]) -> Float[Array, "*batch vertex 3"]:
        """Move vertices from the mesh frame to the ground frame.

        Args:
            vertices: Vertices in the mesh frame (vertex, 3) [m].

        Returns:
            Vertices in the ground frame (vertex, 3) [m], for each pose, after the batch axes.
        """
        place = jnp.expand_dims(jnp.stack([self.x, self.y, self.z], axis=-1), -2)
        return vertices @ jnp.swapaxes(self.rotation(), -1, -2) + place

    @full_precision
    def rotation(self) -> Float[Array, "*batch 3 3"]:
        """Return the rotation from the mesh frame to the ground frame.

        Returns:
            Rotation matrix (3, 3) of each pose, after the batch axes.
        """
        return rotation_z(self.yaw) @ rotation_y(self.pitch) @ rotation_x(self.roll)


def _as_floats(value: Any, name: str) -> Any:
    """A field as an array: on the host in float32, unless it is JAX's, traced or not."""
    # A copy: on a CPU, JAX would take over the memory of the caller's array, who may change it later.
    return value if isinstance(value, jnp.ndarray) else np.array(number_array(value, f"Pose: {name}"), np.float32)


def _spread_out(value: Any, shape: tuple[int, ...]) -> Any:
    """Broadcast a field to float32 of `shape`; numbers that are on the host stay there, so that nothing is compiled."""
    if isinstance(value, np.ndarray):
        return jax.device_put(np.broadcast_to(value, shape))
    value = value if value.dtype == jnp.float32 else value.astype(jnp.float32)
    return value if value.shape == shape else jnp.broadcast_to(value, shape)


def rotation_x(angle: Scalar) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices (*batch, 3, 3) about x by `angle` (*batch) [rad]."""
    c, s, o, i = _terms(angle)
    return _matrix([i, o, o], [o, c, -s], [o, s, c])


def rotation_y(angle: Scalar) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices (*batch, 3, 3) about y by `angle` (*batch) [rad]."""
    c, s, o, i = _terms(angle)
    return _matrix([c, o, s], [o, i, o], [-s, o, c])


def rotation_z(angle: Scalar) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices (*batch, 3, 3) about z by `angle` (*batch) [rad]."""
    c, s, o, i = _terms(angle)
    return _matrix([c, -s, o], [s, c, o], [o, o, i])


def _matrix(*rows: list[Array]) -> Array:
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _terms(angle: Scalar) -> tuple[Array, Array, Array, Array]:
    angle = jnp.asarray(angle, jnp.float32)
    return jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
