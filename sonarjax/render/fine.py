"""Reduce meshes that are much finer than the sonar resolves: triangles cost render time but do not change the frame."""

from __future__ import annotations

import numpy as np

from sonarjax.scene import Mesh, Reduction, SurfaceDistance, reduce_mesh
from sonarjax.scene.reduce import real_arrays
from sonarjax.sonar import Sonar

MANY = 5_000
"""Meshes of up to this many triangles are not reduced, because there is little to gain."""
SHARE = 0.125
"""How far a surface may move, as a share of the sonar's resolution. `experiments/bench_mesh.py` counts how many labels
this changes."""


def mesh_tolerance(sonar: Sonar) -> float:
    """Return the distance by which a surface may move without a visible effect in the frame.

    This is `SHARE` of the length of a range bin or of a beam's width, whichever is smaller. The width is taken for the
    narrowest beam at the nearest range, where it is smallest. With a single beam, or if ranges begin at 0, only the bin
    counts.

    Args:
        sonar: The sonar.

    Returns:
        Distance [m].
    """
    spacing = np.diff(np.asarray(sonar.azimuth, np.float64), axis=-1).min() if sonar.n_beams > 1 else np.inf
    across = spacing * float(np.min(np.asarray(sonar.range_min)))
    bin_length = float(np.min(np.asarray(sonar.range_bin)))
    return SHARE * (min(bin_length, across) if across > 0 else bin_length)


def reduced_for(mesh: Mesh, sonar: Sonar, tolerance: float | None = None) -> Reduction:
    """Reduce a mesh that has many triangles, by default to the detail that the sonar resolves.

    The mesh is returned unchanged if it has at most `MANY` triangles, if more than half of them would remain, or if it
    is a batch of meshes.

    Args:
        mesh: The mesh.
        sonar: The sonar.
        tolerance: Tolerance for `reduce_mesh` [m]; None means `mesh_tolerance` of the sonar. 0 reduces nothing.

    Returns:
        The mesh to use, the numbers of triangles before and after, and the distance between the two surfaces.

    Raises:
        SonarjaxError: As `reduce_mesh`, for a mesh of more than `MANY` triangles: it has reflectivities, or `tolerance`
            is negative or not finite.
    """
    tolerance = mesh_tolerance(sonar) if tolerance is None else tolerance
    count = len(real_arrays(mesh)[1]) if mesh.vertices.ndim == 2 else 0
    same = Reduction(mesh, count, count, tolerance, SurfaceDistance(0.0, 0.0, 0.0))
    if count <= MANY or tolerance == 0:
        return same
    found = reduce_mesh(mesh, tolerance)
    return found if found.after <= count / 2 else same
