"""Meshes far finer than the sonar can tell: each triangle costs time in every view, and the frame shows none of it."""

from __future__ import annotations

import numpy as np

from sonarjax.scene import Mesh, Reduction, SurfaceDistance, reduce_mesh
from sonarjax.scene.reduce import real_arrays
from sonarjax.sonar import Sonar

MANY = 5_000
"""Meshes of no more triangles than this stay as they are: there is little to be gained."""
SHARE = 0.125
"""How far a surface may be off, as a share of what the sonar resolves; `experiments/bench_mesh.py` counts labels that
change."""


def mesh_tolerance(sonar: Sonar) -> float:
    """How far [m] a surface may be off without showing: `SHARE` of a range bin, or of a beam's width if that is less.

    The width is that of the narrowest beam at the nearest range, where it is least.
    """
    spacing = np.diff(np.asarray(sonar.azimuth, np.float64), axis=-1).min() if sonar.n_beams > 1 else np.inf
    across = spacing * float(np.min(np.asarray(sonar.range_min)))
    bin_length = float(np.min(np.asarray(sonar.range_bin)))
    return SHARE * (min(bin_length, across) if across > 0 else bin_length)


def reduced_for(mesh: Mesh, sonar: Sonar, tolerance: float | None = None) -> Reduction:
    """`reduce_mesh` to a `tolerance` [m], by default what the sonar cannot tell, if the mesh has many triangles.

    The mesh is given back as it was where it has no more than `MANY`, or would keep more than half of them. A tolerance
    of 0 reduces nothing. Raises SonarjaxError as `reduce_mesh` does.
    """
    tolerance = mesh_tolerance(sonar) if tolerance is None else tolerance
    count = len(real_arrays(mesh)[1]) if mesh.vertices.ndim == 2 else 0
    same = Reduction(mesh, count, count, tolerance, SurfaceDistance(0.0, 0.0, 0.0))
    if count <= MANY or tolerance == 0:
        return same
    found = reduce_mesh(mesh, tolerance)
    return found if found.after <= count / 2 else same
