"""Reduce the number of triangles of a mesh: a scan has far more than a sonar resolves, and each costs render time.

Edges are collapsed in the order of their quadric error (Garland and Heckbert, 1997) with the library
`fast-simplification`. The quadric error is not a distance. Therefore the distance between the two surfaces is measured
afterwards, in both directions, and decides how many triangles can be removed.
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
from sonarjax.io.given import check_kind, is_number, shown
from sonarjax.scene.mesh import Mesh

FEWEST = 256
"""Meshes are not reduced below this number of triangles, because there is nothing to gain."""
STEP = 2.0**0.125
"""Ratio between neighbouring triangle counts in the search for the smallest one."""
AGGRESSIVENESS = 3.0
"""Argument `agg` of `fast_simplification`. The default of 7 is faster, but at 5,000 triangles the resulting surface is
twice as far from the original."""
FIRST_CUT = 60_000
"""Meshes of more than twice this number of triangles are first reduced to it, once; the search starts from there, and
goes above it only if nothing from there is near enough."""
SAMPLES = 20_000
"""Number of points on each surface from which the distance to the other surface is measured."""
NEIGHBOURS = 6
"""Number of sample points of the other surface, nearest to a point, whose triangles are tried for its distance."""
USUAL, FARTHEST = 0.99, 4.0
"""The share of the surface that must be within the tolerance, and the limit for all points, in tolerances."""


@dataclass(frozen=True)
class SurfaceDistance:
    """Distance between two surfaces [m], from points spread over each one to the other.

    Each number is the larger one of both directions.
    """

    rms: float
    """Root mean square [m]."""
    usual: float
    """Distance that 99 % of the points do not exceed [m]."""
    largest: float
    """Largest distance of any point, a sampled Hausdorff distance [m]."""


@dataclass(frozen=True)
class Reduction:
    """A mesh with fewer triangles, and its distance from the original mesh."""

    mesh: Mesh
    """The reduced mesh, or the original if it was not reduced."""
    before: int
    """Number of triangles of the original mesh."""
    after: int
    """Number of triangles of the resulting mesh."""
    tolerance: float
    """The requested tolerance [m]: see `reduce_mesh`."""
    error: SurfaceDistance
    """The measured distance between the two meshes; zeros if the mesh was not reduced."""

    def __str__(self) -> str:
        """Summary in one line, for a log."""
        if self.after == self.before:
            return f"{self.before} triangles, not reduced: hardly any can be removed within {self.tolerance:.2g} m"
        return (
            f"{self.before} triangles reduced to {self.after}; 99 % of the surface within {self.error.usual:.2g} m "
            f"(asked for: {self.tolerance:.2g} m), all of it within {self.error.largest:.2g} m"
        )


def reduce_mesh(mesh: Mesh, tolerance: float) -> Reduction:
    """Reduce a mesh to as few triangles as a tolerance allows.

    The distance is measured in both directions between the surfaces (`surface_distance`), so that both a lost part and
    a closed hole are noticed.

    Args:
        mesh: A single mesh without reflectivities.
        tolerance: Largest distance for 99 % of the surface [m]; the rest must be within four times this distance.

    Returns:
        The reduced mesh with its distance from the original, or the original if hardly any triangle can be removed.

    Raises:
        SonarjaxError: `tolerance` is not a positive number, `mesh` is something else or a batch, or its triangles have
            reflectivities (it is not known which reflectivity a new triangle should get).
    """
    check_kind(mesh, Mesh, "mesh")
    if not (is_number(tolerance) and 0 < tolerance < math.inf):
        raise SonarjaxError(f"tolerance: expected a positive number of metres, got {shown(tolerance)}")
    _check_single(mesh, "reduce_mesh")
    if mesh.reflectivity is not None:
        raise SonarjaxError("reduce_mesh: expected a mesh without reflectivity: reduce it first, then set it")
    full = real_arrays(mesh)
    before = len(full[1])
    surface, large = _Surface(*full), before > 2 * FIRST_CUT
    found = _fewest_triangles(_collapsed(*full, FIRST_CUT) if large else full, surface, FEWEST, tolerance)
    if found is None and large:  # the first cut may have gone too far
        found = _fewest_triangles(full, surface, FIRST_CUT, tolerance)
    if found is None:
        return Reduction(mesh, before, before, tolerance, SurfaceDistance(0.0, 0.0, 0.0))
    best, error = found
    return Reduction(Mesh.from_arrays(*best, name="reduced mesh"), before, len(best[1]), tolerance, error)


def _fewest_triangles(
    source: tuple[np.ndarray, np.ndarray], surface: _Surface, fewest: int, tolerance: float
) -> tuple[tuple[np.ndarray, np.ndarray], SurfaceDistance] | None:
    """Reduce `source` to as few triangles as the tolerance [m] from `surface` allows, but not below `fewest`.

    Returns:
        The reduced arrays and their distance from `surface`; None if nothing that was tried is near enough.
    """
    best = None
    # The error grows as triangles are removed, so bisect over the logarithm of their number, in steps of STEP.
    passes, fails = 0, 1 + math.floor(math.log(max(len(source[1]) / fewest, 1.0), STEP))
    while fails - passes > 1:
        middle = (passes + fails) // 2
        tried = _collapsed(*source, int(len(source[1]) / STEP**middle))
        found = surface.distance(_Surface(*tried)) if len(tried[1]) else None
        if found is None or found.usual > tolerance or found.largest > FARTHEST * tolerance:
            fails = middle
        else:
            passes, best = middle, (tried, found)
    return best


def surface_distance(first: Mesh, second: Mesh) -> SurfaceDistance:
    """Measure the distance between two surfaces. The sample points are the same in every call.

    Args:
        first, second: The two surfaces, single meshes in one frame.

    Returns:
        The distance [m], in three numbers.

    Raises:
        SonarjaxError: One is something else, or a batch.
    """
    for name, mesh in (("first", first), ("second", second)):
        check_kind(mesh, Mesh, name)
        _check_single(mesh, name)
    return _Surface(*real_arrays(first)).distance(_Surface(*real_arrays(second)))


def _check_single(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError, which begins with `name`, for a batch of meshes."""
    if mesh.vertices.ndim != 2:
        raise SonarjaxError(f"{name}: expected one mesh, got a batch of shape {mesh.vertices.shape[:-2]}")


def real_arrays(mesh: Mesh) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Vertices (vertex, 3) [m] and triangles (face, 3) of a mesh, without the triangles that only pad its arrays."""
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
    """A surface with points spread evenly over it, to measure the distance of other points from it."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Prepare the surface of vertices (vertex, 3) [m] and triangles (face, 3)."""
        surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
        self._corners = surface.triangles
        self.points, _ = trimesh.sample.sample_surface(surface, SAMPLES, seed=0)
        dense, owner = trimesh.sample.sample_surface(surface, 5 * SAMPLES, seed=1)
        # Add the centre of every triangle, so that small triangles without a sample point are found too.
        self._owner = np.concatenate([owner, np.arange(len(faces))])
        self._tree = cKDTree(np.concatenate([dense, self._corners.mean(axis=1)]))

    def distance(self, other: _Surface) -> SurfaceDistance:
        """The distance between two surfaces; each number is the larger one of both directions."""
        ways = [self._from(other.points), other._from(self.points)]
        return SurfaceDistance(
            max(float(np.sqrt((way**2).mean())) for way in ways),
            max(float(np.quantile(way, USUAL)) for way in ways),
            max(float(way.max()) for way in ways),
        )

    def _from(self, points: np.ndarray) -> np.ndarray:
        """Distance [m] of points (point, 3) from the surface, never less than the true distance.

        It is exact for the triangles that are tried, but a nearer triangle may have been missed.
        """
        near = self._owner[self._tree.query(points, k=NEIGHBOURS)[1]]  # (point, neighbour)
        repeated = np.repeat(points, NEIGHBOURS, axis=0)
        closest = trimesh.triangles.closest_point(self._corners[near.ravel()], repeated)
        return np.linalg.norm(closest - repeated, axis=1).reshape(near.shape).min(axis=1)
