"""Check that an object fits the sonar's view: one drawn in millimetres does not, and mesh files seldom name a unit."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind
from sonarjax.scene import Mesh
from sonarjax.scene.limits import MILLIMETRES
from sonarjax.sonar import Sonar


def check_single(mesh: Any, name: str) -> None:
    """Raise a SonarjaxError for a stack of meshes, or for anything that is no mesh."""
    check_kind(mesh, Mesh, name)
    if mesh.closed.shape:
        raise SonarjaxError(f"{name}: expected one mesh, got a stack of shape {mesh.closed.shape}")


def check_fits(mesh: Mesh, sonar: Sonar, name: str) -> None:
    """Check that a mesh is not longer than the sonar's range.

    A part of 90 mm whose file is read as metres looks like an object of 90 m; only the sonar's range shows the mistake.

    Args:
        mesh: The object.
        sonar: The sonar.
        name: Name of the mesh; the error message begins with it.

    Raises:
        SonarjaxError: The mesh is too long, a stack of meshes, or no mesh.
    """
    check_single(mesh, name)
    extent = float(np.ptp(np.asarray(mesh.vertices), axis=0).max())
    reach = float(np.max(np.asarray(sonar.range_max)))
    if extent > reach:
        raise SonarjaxError(
            f"{name}: the mesh is {extent:.4g} m long, but the sonar's range ends at {reach:.4g} m (range_max_m): "
            f"expected a smaller object{f' ({MILLIMETRES})' if extent <= 1000 * reach else ''}"
        )
