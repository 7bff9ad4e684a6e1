"""Points in space with an array for each coordinate: a CPU computes with them several times faster than with one array.

XLA's CPU code does not vectorise arithmetic along a last axis of three, and derivatives suffer most.
"""

from __future__ import annotations

from typing import TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sonarjax.records import record


@record
class Vector:
    """Points [m] or directions."""

    x: Float[Array, "*batch"]
    """Forward."""
    y: Float[Array, "*batch"]
    """To port."""
    z: Float[Array, "*batch"]
    """Up."""

    def __sub__(self, other: Vector) -> Vector:
        """The vector from `other` to this one."""
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __truediv__(self, by: Float[Array, "*batch"]) -> Vector:
        """The vector divided by a number."""
        return Vector(self.x / by, self.y / by, self.z / by)

    def dot(self, other: Vector) -> Float[Array, "*batch"]:
        """Inner product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vector) -> Vector:
        """Vector product."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def turned(self, azimuth: Float[Array, "*#batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Coordinates along the horizontal direction at `azimuth` [rad], and to port of it."""
        c, s = jnp.cos(azimuth), jnp.sin(azimuth)
        return c * self.x + s * self.y, c * self.y - s * self.x


Corners: TypeAlias = tuple[Vector, Vector, Vector]
"""The corners of triangles [m]."""


def take_points(points: Float[Array, "point 3"], index: Int[Array, "*batch"]) -> Vector:
    """The `points` (point, xyz) [m] at `index`, as a vector (*batch)."""
    return Vector(*(points[:, k][index] for k in range(3)))


def normal_of(corners: Corners) -> Vector:
    """Normals of triangles, twice as long as their area [m²]."""
    first, second, third = corners
    return (second - first).cross(third - first)


def unit(vector: Vector) -> Vector:
    """The vector at length 1; that of length 0 stays as it is, with finite derivatives."""
    return vector / jnp.sqrt(vector.dot(vector) + 1e-24)
