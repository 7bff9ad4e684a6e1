"""Where a mesh stands: its lowest point, and the middle of its outline.

A pose places the mesh's origin on the floor. CAD programs often put the origin elsewhere: in the middle of the body, or
metres away.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene.mesh import Mesh

STANDS_M = 0.005
"""A mesh stands on the floor if its lowest point is at most this far above or below its z = 0 [m]."""
REMEDY = "mesh.standing(), on the command line --stand, moves it"


def check_above_floor(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError if a mesh goes through the floor, its z = 0, by more than `STANDS_M`.

    One that hangs above it is fine: it may lie on supports that the mesh leaves out.
    """
    problem = why_not_standing(mesh)
    if problem is not None and _box(mesh)[0, 2] < 0:
        raise SonarjaxError(f"{name}: expected a mesh whose lowest point is at z = 0, {problem}: {REMEDY}")


def why_not_standing(mesh: Mesh) -> str | None:
    """Where the lowest point of a mesh is, in words; None if it stands at its z = 0, to within `STANDS_M`."""
    lowest = float(_box(mesh)[0, 2])
    side = "above" if lowest > 0 else "below"
    return None if abs(lowest) <= STANDS_M else f"it is {abs(lowest):.3g} m {side}"


def check_over_origin(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError if the origin of a mesh lies outside its outline's box in x and y."""
    low, high = _box(mesh)[:, :2]
    if (low > 0).any() or (high < 0).any():
        x, y = (low + high) / 2
        raise SonarjaxError(
            f"{name}: expected a mesh around its origin, got one around x {x:.3g} m, y {y:.3g} m: {REMEDY}"
        )


def _box(mesh: Mesh) -> Float[np.ndarray, "2 3"]:
    """Least and largest coordinates [m]."""
    vertices = np.asarray(mesh.vertices)
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])
