"""Triangle meshes as padded arrays, read by trimesh (only `scene/` imports it).

Meshes are padded to a few fixed sizes, so that meshes of different size share compiled code. What the renderer must
know about a mesh before it compiles, such as how many triangles a slice can cross, is measured here, on the host.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Bool, Float, Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason
from sonarjax.io.given import is_number, listed, number_array, shown
from sonarjax.records import record, static
from sonarjax.scene.limits import check_coordinates, check_face_count
from sonarjax.scene.mesh_file import check_mesh_file, reading_problem
from sonarjax.scene.slicing import has_crossing_triangles, most_crossings, most_front
from sonarjax.scene.text_mesh import check_complete, check_polygons, source_for_trimesh
from sonarjax.scene.winding import signed_volumes, turn_outward

CREASE_ANGLE = math.radians(20.0)  # an edge that bends more is an edge of the body, not of its tessellation
MAX_EVENTS = 64
CHECKED_FACES = 1000  # larger meshes are assumed to pass through themselves, because the check would take seconds


@record
class Mesh:
    """A triangle surface in its own frame [m]; a pytree that is differentiable in `vertices`.

    Build it with `Mesh.load`, `Mesh.from_arrays` or the functions of `sonarjax.scene.objects`. `stack_meshes` makes a
    batch for `jax.vmap`. Only counts are static: two meshes of one padded size and capacity share compiled code.
    """

    vertices: Float[Array, "*batch vertex 3"]
    """Vertex positions [m]; padding repeats the first vertex."""
    faces: Int[Array, "*batch face 3"]
    """Vertex indices of each triangle, counter-clockwise from outside; padding is (0, 0, 0)."""
    crease: Int[Array, "*batch event"]
    """Vertices at sharp edges, at whose azimuths a slice's profile may jump; padding is vertex 0."""
    closed: Bool[Array, "*batch"]
    """True if the surface encloses a volume; faces that look away from the sonar are then never seen."""
    radius: Float[Array, "*batch"]
    """Largest horizontal distance of a vertex from the mesh origin [m], rounded up. Windows are sized by it."""
    top: Float[Array, "*batch"]
    """Largest height of a vertex above the mesh origin [m], rounded up."""
    crossings: int = static(default=0)
    """Most triangles that one vertical slice has room for (only front faces if `closed`)."""
    front: int = static(default=0)
    """Most triangles facing the sonar at once that there is room for (all triangles unless `closed`)."""
    intersecting: bool = static(default=True)
    """False if no two triangles pass through each other; slices then hold half as many visible intervals."""
    events: int = static(default=MAX_EVENTS)
    """Most crease vertices at whose azimuths the slabs of a view end; those on the steepest silhouettes are taken
    first.
    """
    reflectivity: Float[Array, "*batch face"] | None = None
    """Factor on the energy that each triangle sends back [1]; None if all are 1."""

    @classmethod
    def load(cls, path: str | Path, unit_m: float | None = None) -> Mesh:
        """Read a surface from any format that trimesh reads (STL, OBJ, PLY, GLB, 3MF, OFF, …).

        Axes are taken as the file stores them, with z up. The convention of glTF (GLB) is y up: such a file lies on
        its side.

        Args:
            path: The mesh file.
            unit_m: Length of the file's unit [m]. None for the unit that the file names, or else metres.

        Returns:
            The mesh.

        Raises:
            SonarjaxError: `path` is no path; the file is missing, empty, too large, corrupt or not a surface; `unit_m`
                is not a positive number; or the coordinates cannot be metres (`sonarjax.scene.limits`).
        """
        if not isinstance(path, str | os.PathLike):
            raise SonarjaxError(f"path: expected that of a mesh file, got {shown(path)}: Mesh.from_arrays takes arrays")
        path = Path(path)
        _check_file(path)
        if unit_m is not None and not (is_number(unit_m) and 0 < unit_m < math.inf):
            expected = "a positive number of metres (0.001 for millimetres)"
            raise SonarjaxError(f"{path}: unit_m must be {expected}, got {shown(unit_m)}")
        vertices, faces, unit = _read_surface(path)
        scale = unit_m if unit_m is not None else _unit_m(unit, path)
        with np.errstate(over="ignore"):  # `from_arrays` refuses infinite vertices
            vertices = vertices.astype(np.float64) * scale
        return cls.from_arrays(vertices, faces, name=str(path))

    @classmethod
    def from_arrays(cls, vertices: Any, faces: Any, name: str = "mesh") -> Mesh:
        """Make a mesh from arrays.

        Equal vertices are merged. Unused vertices, triangles of zero area and triangles that occur again are dropped.

        Args:
            vertices: Vertices (vertex, 3) [m].
            faces: Vertex numbers of the triangles (face, 3).
            name: Name of the mesh in error messages.

        Returns:
            The mesh, padded. It is closed if its triangles enclose a volume; they then all face outwards, those of a
            cavity into it. A closed mesh is seen from outside alone: leave a room around the sonar open.

        Raises:
            SonarjaxError: Something else than numbers is given, a shape is wrong, there is no triangle or more than
                `MAX_FACES`, every triangle has zero area, a value is not finite, an index is no whole number or out of
                range, or the extent shows that the coordinates are not metres.
        """
        vertices, faces = number_array(vertices, f"{name}: vertices"), number_array(faces, f"{name}: faces")
        check_face_count(len(np.atleast_1d(faces)), name)  # before anything is copied
        vertices = vertices.astype(np.float64)
        _check(vertices, faces, name)
        vertices, faces = _used(vertices, faces.astype(np.int64))
        check_coordinates(vertices, name)
        surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
        surface.merge_vertices()
        surface.update_faces(surface.nondegenerate_faces())
        surface.update_faces(surface.unique_faces())  # both sides of a face that was exported as double-sided
        if len(surface.faces) == 0:
            raise SonarjaxError(f"{name}: every triangle has zero area, expected a surface")
        closed = bool(surface.is_watertight)
        if closed:
            turn_outward(surface)
        return _padded(surface, closed)

    def with_vertices(self, vertices: Float[Array | np.ndarray, "vertex 3"]) -> Mesh:
        """Return the same triangles with other vertex positions, to deform a shape or differentiate by it.

        The gradient by the shape is `jax.grad(lambda v: loss(mesh.with_vertices(v)))(mesh.vertices)`. For concrete
        vertices, what slices can meet is measured again, and the triangles of a closed mesh are turned if the new
        vertices are mirrored, so that they still face outwards. For traced ones all this is kept as it is, and
        `SonarFrame.overflow` says whether there is still enough room.

        Args:
            vertices: New positions of all vertices, padding included (vertex, 3) [m].

        Returns:
            The changed mesh.

        Raises:
            SonarjaxError: Something else than numbers is given, the shape differs, concrete values are not finite, or
                this is a stack of meshes and nothing is traced.
        """
        vertices = vertices if isinstance(vertices, jax.Array) else number_array(vertices, "vertices")
        if tuple(vertices.shape) != tuple(self.vertices.shape):
            raise SonarjaxError(f"vertices: expected shape {self.vertices.shape}, got {tuple(vertices.shape)}")
        if any(isinstance(v, jax.core.Tracer) for v in (vertices, *jax.tree.leaves(self))):
            return replace(self, vertices=jnp.asarray(vertices))
        self._check_alone("with_vertices")
        positions, faces, closed = np.asarray(vertices, np.float32), np.asarray(self.faces), bool(self.closed)
        if not np.isfinite(positions).all():
            raise SonarjaxError("vertices: hold NaN or infinite values")
        real = faces[:, 0] != faces[:, 1]
        points = positions.astype(np.float64)
        mirrored = closed and signed_volumes(points[faces[real]], points.mean(axis=0)).sum() < 0
        if mirrored:  # else the sonar would see the inside
            faces = np.where(real[:, None], faces[:, ::-1], faces)
        return replace(
            self,
            vertices=jnp.asarray(positions),
            faces=jnp.asarray(faces) if mirrored else self.faces,
            **_measured(positions, faces[real], closed),
        )

    def standing(self) -> Mesh:
        """Return the mesh moved so that it stands at its origin: the lowest point at z = 0, the middle at x = y = 0.

        Poses place the origin, and take z = 0 of the mesh for the floor. CAD programs often put the origin elsewhere.

        Returns:
            The moved mesh; the middle is that of its extent along x and y.

        Raises:
            SonarjaxError: This is a stack of meshes.
        """
        self._check_alone("standing")
        vertices = np.asarray(self.vertices)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        base = np.append((low + high)[:2] / 2, low[2]).astype(np.float32)
        return self.with_vertices(vertices - base)  # on the host, where it is measured under `jax.jit` too

    def with_room(self, crossings: int, front: int) -> Mesh:
        """Return the same mesh with room for more triangles in a slice and more that face the sonar.

        The room never shrinks, and never grows beyond the number of triangles, padding included.

        Args:
            crossings: Least number of triangles that one vertical slice must have room for.
            front: Least number of triangles facing the sonar at once that there must be room for.

        Returns:
            The mesh with more room.
        """
        most = self.n_faces
        return replace(
            self,
            crossings=max(self.crossings, _rounded(min(crossings, most), most)),
            front=max(self.front, _rounded(min(front, most), most)),
        )

    def _check_alone(self, name: str) -> None:
        if self.vertices.ndim != 2:
            raise SonarjaxError(f"{name}: expected one mesh, got a batch of shape {self.vertices.shape[:-2]}")

    @property
    def n_faces(self) -> int:
        """Number of triangles, padding included."""
        return int(self.faces.shape[-2])


def stack_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Stack several meshes into one batch for `jax.vmap`, padded to common sizes and capacities.

    Args:
        meshes: Single meshes, at least one.

    Returns:
        A mesh whose arrays are (mesh, ...).

    Raises:
        SonarjaxError: The sequence is empty, or holds something other than single meshes.

    >>> from sonarjax.scene import objects
    >>> stack_meshes([objects.brick(), objects.target()]).vertices.shape[0]
    2
    """
    meshes = listed(meshes, Mesh, "meshes")
    if not meshes or any(mesh.closed.shape for mesh in meshes):
        raise SonarjaxError(f"stack_meshes: expected at least one mesh, {'none stacked' if meshes else 'got none'}")
    vertices, faces, crease = (
        max(getattr(m, name).shape[0] for m in meshes) for name in ("vertices", "faces", "crease")
    )
    painted = any(mesh.reflectivity is not None for mesh in meshes)
    alike = [
        replace(
            mesh,
            reflectivity=_reflectivity(mesh, faces) if painted else None,
            vertices=_padded_to(mesh.vertices, vertices),
            faces=jnp.pad(mesh.faces, ((0, faces - mesh.n_faces), (0, 0))),
            crease=_padded_to(mesh.crease, crease),
            crossings=max(m.crossings for m in meshes),
            front=max(m.front for m in meshes),
            events=max(m.events for m in meshes),
            intersecting=any(m.intersecting for m in meshes),
        )
        for mesh in meshes
    ]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *alike)


def check_reflectivity(mesh: Mesh, name: str) -> None:
    """Raise a SonarjaxError unless the reflectivity has a factor for each triangle, padding included."""
    given = mesh.reflectivity
    if given is not None and np.shape(given)[-1:] != (mesh.n_faces,):
        raise SonarjaxError(
            f"{name}: expected a reflectivity of {mesh.n_faces} factors, one for each triangle and padding, got shape "
            f"{np.shape(given)}"
        )


def joined_reflectivity(meshes: Sequence[Mesh]) -> Float[Array, "face"] | None:
    """The factors of all triangles (face,) of several meshes, one after the other; None if no mesh states any."""
    if all(mesh.reflectivity is None for mesh in meshes):
        return None
    return jnp.concatenate([_reflectivity(mesh, mesh.n_faces) for mesh in meshes])


def _reflectivity(mesh: Mesh, faces: int) -> Array:
    """Factor on the energy of each triangle (face,), padded with ones."""
    own = jnp.ones(mesh.n_faces) if mesh.reflectivity is None else mesh.reflectivity
    return jnp.pad(own, (0, faces - mesh.n_faces), constant_values=1.0)


def _padded_to(values: Array, size: int) -> Array:
    return jnp.concatenate([values, jnp.repeat(values[:1], size - values.shape[0], axis=0)])


_UNIT_M = {
    "m": 1.0,
    "meters": 1.0,
    "meter": 1.0,
    "microns": 1e-6,
    "micron": 1e-6,
    "millimeters": 1e-3,
    "millimeter": 1e-3,
    "mm": 1e-3,
    "centimeters": 1e-2,
    "centimeter": 1e-2,
    "cm": 1e-2,
    "inches": 0.0254,
    "inch": 0.0254,
    "in": 0.0254,
    "feet": 0.3048,
    "foot": 0.3048,
}


def _unit_m(unit: str | None, path: Path) -> float:
    """Length [m] of the unit that trimesh found in a file; metres where it found none."""
    if unit in (None, "", "none"):
        return 1.0
    given = re.fullmatch(r"([0-9.eE+-]+) \* meters", unit)  # as trimesh tells that of COLLADA files
    if given is None and unit not in _UNIT_M:
        raise SonarjaxError(f"{path}: holds lengths in {unit!r}, expected a known unit: state its length as unit_m")
    return _UNIT_M[unit] if given is None else float(given[1])


def _check_file(path: Path) -> None:
    """Raise a SonarjaxError unless this is a file that is not empty."""
    try:
        if path.is_dir():
            raise SonarjaxError(f"{path}: is a folder, expected a mesh file")
        if not path.is_file():
            raise SonarjaxError(f"{path}: no such mesh file")
        if path.stat().st_size == 0:
            raise SonarjaxError(f"{path}: the mesh file is empty")
    except OSError as error:
        raise SonarjaxError(f"{path}: cannot be read: {reason(error)}") from error


def _read_surface(path: Path) -> tuple[np.ndarray, np.ndarray, str | None]:
    try:
        check_mesh_file(path)
        loaded = trimesh.load(**source_for_trimesh(path), process=False)
        if isinstance(loaded, trimesh.Scene):  # a scene may hold one small geometry a million times
            check_face_count(_faces_of_scene(loaded), str(path))
        surface = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        if not isinstance(surface, trimesh.Trimesh):
            raise SonarjaxError(f"{path}: holds a {type(surface).__name__}, expected a surface of triangles")
        check_complete(path, len(surface.faces))
        check_polygons(path, surface)
        unit = surface.units if surface.units is not None else getattr(loaded, "units", None)
        return np.asarray(surface.vertices), np.asarray(surface.faces), unit
    except SonarjaxError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their format's parser raises
        raise reading_problem(path, error) from error


def _faces_of_scene(scene: trimesh.Scene) -> int:
    geometries = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
    return sum(len(getattr(geometry, "faces", ())) for geometry in geometries)


def _check(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    if vertices.ndim != 2 or vertices.shape[-1] != 3 or faces.ndim != 2 or faces.shape[-1] != 3:
        raise SonarjaxError(
            f"{name}: expected vertices (n, 3) and triangles (m, 3), got {vertices.shape} and {faces.shape}"
        )
    if len(faces) == 0 or len(vertices) == 0:
        raise SonarjaxError(f"{name}: the mesh is empty, expected at least one triangle")
    if not np.isfinite(vertices).all():
        raise SonarjaxError(f"{name}: vertices hold NaN or infinite values")
    if faces.dtype.kind == "f" and not (faces == np.rint(faces)).all():
        raise SonarjaxError(f"{name}: faces: expected whole vertex numbers, got fractions or NaN")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SonarjaxError(f"{name}: a triangle refers to a vertex that does not exist")


def _used(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices that triangles refer to, in their order, and the triangles with the new indices."""
    kept = _mentioned(faces, len(vertices))
    return vertices[kept], (np.cumsum(kept) - 1)[faces]


def _mentioned(faces: np.ndarray, count: int) -> np.ndarray:
    """Which of `count` vertices triangles refer to (vertex,)."""
    kept = np.zeros(count, bool)
    kept[faces] = True
    return kept


def _padded(surface: trimesh.Trimesh, closed: bool) -> Mesh:
    vertices = np.asarray(surface.vertices, np.float32)
    faces = np.asarray(surface.faces, np.int32)
    crease = _crease_vertices(surface)
    # `device_put` compiles nothing; `jnp.asarray` would compile a copy for every shape.
    return Mesh(
        vertices=jax.device_put(_pad(vertices, _bucket(len(vertices)), vertices[:1])),
        faces=jax.device_put(_pad(faces, _bucket(len(faces)), np.zeros((1, 3), np.int32))),
        crease=jax.device_put(_pad(crease, _bucket(max(len(crease), 1)), np.zeros(1, np.int32))),
        closed=jax.device_put(np.bool_(closed)),
        **_measured(vertices, faces, closed),
    )


def _measured(vertices: np.ndarray, faces: np.ndarray, closed: bool) -> dict[str, Any]:
    """What the renderer must know in advance: the extent of the surface, and how many triangles slices can meet."""
    used = vertices[_mentioned(faces, len(vertices))]
    return {
        "radius": jax.device_put(np.float32(_round_up(float(np.hypot(used[:, 0], used[:, 1]).max())))),
        "top": jax.device_put(np.float32(_round_up(float(used[:, 2].max())))),
        "crossings": _rounded(most_crossings(vertices, faces, closed), len(faces)),
        "front": _rounded(most_front(vertices, faces) if closed else len(faces), len(faces)),
        "intersecting": len(faces) > CHECKED_FACES or has_crossing_triangles(vertices, faces),
    }


def _pad(values: np.ndarray, size: int, filler: np.ndarray) -> np.ndarray:
    return np.concatenate([values, np.repeat(filler, size - len(values), axis=0)])


def _bucket(count: int) -> int:
    """Smallest of 8, 12, 16, 24, 32, 48, 64, … that is at least `count`: less than half of it is padding."""
    power = 1 << max(3, math.ceil(math.log2(count)))
    return power * 3 // 4 if 8 < count <= power * 3 // 4 else power


def _round_up(length: float, step: float = 0.01) -> float:
    return math.ceil(length / step - 1e-6) * step


def _crease_vertices(surface: trimesh.Trimesh) -> np.ndarray:
    """Vertices (event,) at sharp edges, open ones, and those of three or more triangles, in ascending order."""
    sharp = surface.face_adjacency_edges[surface.face_adjacency_angles > CREASE_ANGLE]
    edges = surface.edges_sorted
    other = np.ones(len(edges), bool)
    other[trimesh.grouping.group_rows(edges, require_count=2).reshape(-1)] = False
    return np.unique(np.concatenate([sharp, edges[other]])).astype(np.int32)


def _rounded(bound: int, faces: int) -> int:
    """`bound` rounded up, so that similar meshes share compiled code; never above the padded number of faces."""
    return min(-(-bound // 4) * 4 if bound < 64 else _bucket(bound), _bucket(faces))
