"""Whether an object can be in a sonar's view at all: one drawn in millimetres cannot, and seldom says so itself."""

from __future__ import annotations

import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar


def check_fits(mesh: Mesh, sonar: Sonar, name: str) -> None:
    """Raises SonarjaxError when the mesh is longer than the sonar sees far; `name` opens the message.

    A part of 90 mm that is read as metres passes for an object of 90 m, until it is compared with the view.
    """
    extent = float(np.ptp(np.asarray(mesh.vertices), axis=0).max())
    reach = float(np.max(np.asarray(sonar.range_max)))
    if extent > reach:
        hint = "in millimetres? then give --unit-m 0.001, in Python unit_m=0.001"
        raise SonarjaxError(
            f"{name}: the mesh is {extent:.4g} m long, but the sonar's range ends at {reach:.4g} m (range_max_m): "
            f"expected a smaller object{f' ({hint})' if extent <= 1000 * reach else ''}"
        )
