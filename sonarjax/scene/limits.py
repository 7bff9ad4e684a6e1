"""Limits on an object's size, distance and number of triangles, and one clear error beyond them."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from sonarjax.io.errors import SonarjaxError

LARGEST_EXTENT_M = 100.0
"""An object longer than this [m] is assumed to be drawn in millimetres."""
SMALLEST_EXTENT_M = 1e-4
"""An object shorter than this [m] is assumed to have been scaled twice."""
FARTHEST_VERTEX_M = 1000.0
"""Largest coordinate of a mesh in its own frame [m]. There float32 resolves 0.06 mm; at 10,000 km the shape would be
lost.
"""
FARTHEST_POSE_M = 1e6
"""Largest coordinate of a pose [m]. Anything so far away is out of every sonar's view, and 10²⁰ m overflows float32."""
LARGEST_ANGLE = 1e6
"""Largest angle of a pose [rad], about 160,000 revolutions; float32 resolves 0.06 rad there."""
MILLIMETRES = "in millimetres? then give --unit-m 0.001, in Python unit_m=0.001"
"""What an error asks about a mesh that is too long by a factor of up to 1000."""
MAX_FACES = 2**21
"""Most triangles of a mesh; reading so many takes 2 GiB of memory and minutes."""


def check_face_count(count: int, name: str) -> None:
    """Raise a SonarjaxError if a mesh of `count` triangles is too fine to work with."""
    if count > MAX_FACES:
        raise SonarjaxError(f"{name}: expected at most {MAX_FACES} triangles, got {count}: simplify the mesh")


def check_coordinates(vertices: Float[np.ndarray, "vertex 3"], name: str) -> None:
    """Raise a SonarjaxError if the vertices (vertex, 3) of a mesh cannot be metres around the mesh's own origin."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    with np.errstate(over="ignore"):  # an extent that overflows to infinity is too long as well
        extent = float((high - low).max())
    if extent > LARGEST_EXTENT_M:
        hint = MILLIMETRES if extent <= 1000 * LARGEST_EXTENT_M else "is the file corrupt?"
        raise SonarjaxError(f"{name}: the mesh is {extent:.4g} m long; expected metres ({hint})")
    if extent < SMALLEST_EXTENT_M:
        raise SonarjaxError(
            f"{name}: the mesh is {extent:.3g} m long; expected {SMALLEST_EXTENT_M:g} m or more (is unit_m right?)"
        )
    farthest = float(max(np.abs(low).max(), np.abs(high).max()))
    if farthest > FARTHEST_VERTEX_M:
        raise SonarjaxError(
            f"{name}: the mesh lies {farthest:.4g} m from its own origin; expected at most {FARTHEST_VERTEX_M:g} m: "
            "move the mesh to its origin, and place it with the pose"
        )


def check_pose(pose: Any) -> None:
    """Raise a SonarjaxError unless every field of a Pose is finite and not absurdly large; skip traced values."""
    for field, most, unit in (
        ("x", FARTHEST_POSE_M, "m"), ("y", FARTHEST_POSE_M, "m"), ("z", FARTHEST_POSE_M, "m"),
        ("yaw", LARGEST_ANGLE, "rad"), ("pitch", LARGEST_ANGLE, "rad"), ("roll", LARGEST_ANGLE, "rad"),
    ):  # fmt: skip
        value = getattr(pose, field)
        if isinstance(value, jax.core.Tracer):
            continue
        values = np.asarray(value, np.float64)
        if not (np.abs(values) <= most).all():  # NaN fails this as well
            worst = values.flat[np.argmax(np.where(np.isnan(values), math.inf, np.abs(values)))]
            raise SonarjaxError(f"pose: {field}: expected a number from {-most:g} to {most:g} {unit}, got {worst:g}")
