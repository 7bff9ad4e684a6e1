"""Where a mesh stands: its lowest point, and the middle of its outline.

A pose places the mesh's origin on the floor. CAD programs often put the origin elsewhere: in the middle of the body, or
metres away.
"""

from __future__ import annotations

import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene.mesh import Mesh

STANDS_M = 0.005
"""A mesh stands on the floor if its lowest point is at most this far above or below its z = 0 [m]."""
REMEDY = "move it with mesh.standing(), or --stand on the command line"


def check_above_floor(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError if a mesh goes through the floor, its z = 0, by more than `STANDS_M`.

    One that hangs above it is fine: it may lie on supports that the mesh leaves out.
    """
    if lowest_point(mesh) < -STANDS_M:
        raise SonarjaxError(f"{name}: expected a mesh above the floor, its z = 0, {why_not_standing(mesh)}: {REMEDY}")


def why_not_standing(mesh: Mesh) -> str | None:
    """Where the lowest point of a mesh is, in words; None if it stands at its z = 0, to within `STANDS_M`."""
    lowest = lowest_point(mesh)
    side = "above" if lowest > 0 else "below"
    return None if abs(lowest) <= STANDS_M else f"but its lowest point is {abs(lowest):.3g} m {side} that"


def lowest_point(mesh: Mesh) -> float:
    """Height of the lowest point of a mesh above its z = 0 [m]."""
    return float(np.asarray(mesh.vertices)[:, 2].min())


def check_over_origin(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError if the origin of a mesh lies outside its extent along x or y, by more than `STANDS_M`."""
    vertices = np.asarray(mesh.vertices)[:, :2]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if (low > STANDS_M).any() or (high < -STANDS_M).any():
        x, y = (low + high) / 2
        raise SonarjaxError(
            f"{name}: expected a mesh around its origin, got one around x {x:.3g} m, y {y:.3g} m: {REMEDY}"
        )
