"""Fewer triangles for the same surface: a scan has far more than a sonar can tell, and each costs time in every view.

Edges are collapsed by quadric error (Garland and Heckbert, 1997; the library `fast-simplification`). That error is no
distance, so the distance between the surfaces is measured afterwards, both ways, and decides how far to go.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import fast_simplification
import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene.mesh import Mesh

FEWEST = 256
"""No mesh is reduced to fewer triangles: there is nothing to gain."""
STEP = 2.0**0.25
"""Numbers of triangles that are told apart, as a ratio."""
AGGRESSIVENESS = 3.0
"""Of `fast_simplification`: its default of 7 is faster, and its surfaces are twice as far off at 5,000 triangles."""
FIRST_CUT = 60_000
"""Larger meshes are brought down to so many triangles once, and reduced from there."""
SAMPLES = 20_000
"""Points on each surface from which the distance to the other is taken."""
NEIGHBOURS = 6
"""Triangles that are tried for each point: those of the nearest of the points that are spread over the surface."""
USUAL, FARTHEST = 0.99, 4.0
"""The tolerance holds for this share of the surface; no point may be farther off than this many tolerances."""


@dataclass(frozen=True)
class SurfaceDistance:
    """How far two surfaces lie apart [m]: from points spread over each to the other surface, the worse of both ways."""

    rms: float
    """Root mean square [m]."""
    usual: float
    """What 99 % of the points stay within [m]."""
    largest: float
    """The largest of all, a sampled Hausdorff distance [m]."""


@dataclass(frozen=True)
class Reduction:
    """A mesh with fewer triangles, and how far it is from the one it was made from."""

    mesh: Mesh
    """The reduced mesh; the given one where nothing was to be gained."""
    before: int
    """Triangles of the mesh that was given."""
    after: int
    """Triangles of the reduced one."""
    tolerance: float
    """What was asked for [m]: see `reduce_mesh`."""
    error: SurfaceDistance
    """What was measured; zeros where the mesh is as it was."""

    def __str__(self) -> str:
        """One line for a log."""
        if self.after == self.before:
            return f"{self.before} triangles, kept as they are: few can go within {self.tolerance:.2g} m"
        return (
            f"{self.before} triangles reduced to {self.after}; 99 % of the surface within {self.error.usual:.2g} m "
            f"(asked for: {self.tolerance:.2g} m), all of it within {self.error.largest:.2g} m"
        )


def reduce_mesh(mesh: Mesh, tolerance: float) -> Reduction:
    """The mesh with as few triangles as keep 99 % of its surface within `tolerance` [m], all within four times that.

    Measured both ways between the surfaces (`surface_distance`), so that neither a lost part nor a bridged hole passes.
    Raises SonarjaxError unless `tolerance` is a positive number, for a batch, and for a mesh with reflectivities: which
    triangle of the new mesh would have which is not known.
    """
    if not 0 < tolerance < math.inf:
        raise SonarjaxError(f"tolerance: expected a positive number of metres, got {tolerance}")
    if mesh.vertices.ndim != 2:
        raise SonarjaxError(f"reduce_mesh: expected one mesh, got a batch of shape {mesh.vertices.shape[:-2]}")
    if mesh.reflectivity is not None:
        raise SonarjaxError("reduce_mesh: a mesh whose triangles have reflectivities cannot be reduced: paint it after")
    full = real_arrays(mesh)
    before = len(full[1])
    source = _collapsed(*full, FIRST_CUT) if before > 2 * FIRST_CUT else full
    surface = _Surface(*full)
    best, error = full, SurfaceDistance(0.0, 0.0, 0.0)
    # The error grows as triangles go: halve the range of counts, in even steps of their logarithm.
    passes, fails = 0, 1 + math.ceil(math.log(max(len(source[1]) / FEWEST, 1.0), STEP))
    while fails - passes > 1:
        middle = (passes + fails) // 2
        tried = _collapsed(*source, int(len(source[1]) / STEP**middle))
        found = surface.distance(_Surface(*tried)) if len(tried[1]) else None
        if found is None or found.usual > tolerance or found.largest > FARTHEST * tolerance:
            fails = middle
        else:
            passes, best, error = middle, tried, found
    if best is full:
        return Reduction(mesh, before, before, tolerance, error)
    return Reduction(Mesh.from_arrays(*best, name="reduced mesh"), before, len(best[1]), tolerance, error)


def surface_distance(first: Mesh, second: Mesh) -> SurfaceDistance:
    """How far two surfaces lie apart, from the same points every time."""
    return _Surface(*real_arrays(first)).distance(_Surface(*real_arrays(second)))


def real_arrays(mesh: Mesh) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Vertices (vertex, 3) [m] and triangles (face, 3) of a mesh without its padding."""
    faces = np.asarray(mesh.faces)
    return np.asarray(mesh.vertices, np.float64), faces[faces[:, 0] != faces[:, 1]]


def _collapsed(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    points, triangles = fast_simplification.simplify(
        vertices, faces.astype(np.int32), target_count=count, agg=AGGRESSIVENESS
    )
    triangles = np.asarray(triangles, np.int64)
    a, b, c = triangles.T
    return np.asarray(points, np.float64), triangles[(a != b) & (b != c) & (a != c)]


class _Surface:
    """Points spread evenly over a surface, and the distance of other points from it."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Vertices (vertex, 3) [m] and triangles (face, 3)."""
        surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
        self._corners = surface.triangles
        self.points, _ = trimesh.sample.sample_surface(surface, SAMPLES, seed=0)
        dense, owner = trimesh.sample.sample_surface(surface, 5 * SAMPLES, seed=1)
        # The middle of every triangle as well, for the small ones that no point has hit.
        self._owner = np.concatenate([owner, np.arange(len(faces))])
        self._tree = cKDTree(np.concatenate([dense, self._corners.mean(axis=1)]))

    def distance(self, other: _Surface) -> SurfaceDistance:
        """The worse of both ways."""
        ways = [self._from(other.points), other._from(self.points)]
        return SurfaceDistance(
            max(float(np.sqrt((way**2).mean())) for way in ways),
            max(float(np.quantile(way, USUAL)) for way in ways),
            max(float(way.max()) for way in ways),
        )

    def _from(self, points: np.ndarray) -> np.ndarray:
        """Distance [m] of points (point, 3): exact to the triangles near it, so never less than the true one."""
        near = self._owner[self._tree.query(points, k=NEIGHBOURS)[1]]  # (point, neighbour)
        repeated = np.repeat(points, NEIGHBOURS, axis=0)
        closest = trimesh.triangles.closest_point(self._corners[near.ravel()], repeated)
        return np.linalg.norm(closest - repeated, axis=1).reshape(near.shape).min(axis=1)
