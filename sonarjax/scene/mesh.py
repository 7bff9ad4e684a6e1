"""Triangle meshes as padded arrays, read by trimesh (this is the only file that imports it).

Meshes are padded to a few fixed sizes, so that meshes of different size share compiled code. What the renderer
must know about a mesh before it compiles (how many triangles a slice can cross) is measured here, on the host.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Float, Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene.slicing import has_crossing_triangles, most_crossings, most_front

LARGEST_EXTENT_M = 100.0  # an object longer than this is taken for one drawn in millimetres
CREASE_ANGLE = math.radians(20.0)  # edges sharper than this count as edges of the body, not of its tessellation
MAX_EVENTS = 64
CHECKED_FACES = 1000  # larger meshes are taken to pass through themselves: to check them takes seconds


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Mesh:
    """A triangle surface in its own frame [m]; a pytree whose only float leaf is `vertices`.

    Build it with `Mesh.load`, `Mesh.from_arrays` or the functions of `sonarjax.scene.objects`.
    """

    vertices: Float[Array, "vertex 3"]
    """Vertex positions [m]; padding repeats the first vertex."""
    faces: Int[Array, "face 3"]
    """Vertex indices of each triangle, counter-clockwise from outside; padding is (0, 0, 0)."""
    crease: Int[Array, "event"]
    """Vertices at sharp edges: the azimuths at which a slice's profile may jump; padding is vertex 0."""
    closed: bool = field(default=False, metadata={"static": True})
    """True when the surface encloses a volume: faces that look away from the sonar are then never seen."""
    crossings: int = field(default=0, metadata={"static": True})
    """Upper bound of the triangles that one vertical slice crosses (front faces only where `closed`)."""
    front: int = field(default=0, metadata={"static": True})
    """Upper bound of the triangles that look at the sonar at once (all of them unless `closed`)."""
    crossing: bool = field(default=True, metadata={"static": True})
    """False when no two triangles pass through each other: slices then hold half as many pieces."""
    events: int = field(default=MAX_EVENTS, metadata={"static": True})
    """Upper bound of the crease vertices at whose azimuths a view's slabs end; the steepest silhouettes come first."""
    radius: float = field(default=0.0, metadata={"static": True})
    """Largest horizontal distance of a vertex from the mesh origin [m], rounded up: sizes the render window."""
    top: float = field(default=0.0, metadata={"static": True})
    """Largest height of a vertex above the mesh origin [m], rounded up."""

    @classmethod
    def load(cls, path: str | Path, unit_m: float | None = None) -> Mesh:
        """Read a surface in any format trimesh reads (STL, OBJ, PLY, GLB, 3MF, OFF, …).

        `unit_m` is the length of the file's unit [m]; by default the file's own unit where it has one, else metres.
        Raises SonarjaxError when the file is missing, empty, not a surface, or far too large to be in metres.
        """
        path = Path(path)
        if path.is_dir():
            raise SonarjaxError(f"{path}: is a folder, expected a mesh file")
        if not path.is_file():
            raise SonarjaxError(f"{path}: no such mesh file")
        if path.stat().st_size == 0:
            raise SonarjaxError(f"{path}: the mesh file is empty")
        if unit_m is not None and not 0 < unit_m < math.inf:
            raise SonarjaxError(f"{path}: unit_m must be a positive number of metres, got {unit_m}")
        vertices, faces, unit = _read_surface(path)
        scale = unit_m if unit_m is not None else _UNIT_M.get(unit or "", 1.0)
        return cls.from_arrays(vertices * scale, faces, name=str(path))

    @classmethod
    def from_arrays(cls, vertices: Any, faces: Any, name: str = "mesh") -> Mesh:
        """A mesh from vertices (vertex, 3) [m] and triangles (face, 3); `name` is used in messages.

        Raises SonarjaxError when there is no triangle, a value is not finite, an index is out of range, or the
        extent says that the coordinates are not metres.
        """
        vertices = np.asarray(vertices, np.float64)
        faces = np.asarray(faces, np.int64)
        _check(vertices, faces, name)
        surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
        surface.merge_vertices()
        surface.update_faces(surface.nondegenerate_faces())
        if len(surface.faces) == 0:
            raise SonarjaxError(f"{name}: every triangle has zero area, expected a surface")
        closed = bool(surface.is_watertight)
        if closed:
            trimesh.repair.fix_normals(surface, multibody=True)
        return _padded(surface, closed)

    def with_vertices(self, vertices: Float[Array, "vertex 3"]) -> Mesh:
        """The same mesh with other vertex positions (vertex, 3) [m] (to differentiate a shape).

        `crossings`, `front`, `radius` and `top` are kept: for another shape altogether use `from_arrays`.
        """
        return replace(self, vertices=vertices)

    @property
    def n_faces(self) -> int:
        """Number of triangles, padding included."""
        return int(self.faces.shape[0])


_UNIT_M = {
    "m": 1.0,
    "meters": 1.0,
    "meter": 1.0,
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


def _read_surface(path: Path) -> tuple[np.ndarray, np.ndarray, str | None]:
    try:
        loaded = trimesh.load(path, process=False)
        surface = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        if not isinstance(surface, trimesh.Trimesh):
            raise SonarjaxError(f"{path}: holds a {type(surface).__name__}, expected a surface of triangles")
        unit = surface.units if surface.units is not None else getattr(loaded, "units", None)
        return np.asarray(surface.vertices), np.asarray(surface.faces), unit
    except SonarjaxError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their format's parser raises
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SonarjaxError(f"{path}: cannot be read as a mesh ({reason})") from error


def _check(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    if vertices.ndim != 2 or vertices.shape[-1] != 3 or faces.ndim != 2 or faces.shape[-1] != 3:
        raise SonarjaxError(
            f"{name}: expected vertices (n, 3) and triangles (m, 3), got {vertices.shape} and {faces.shape}"
        )
    if len(faces) == 0 or len(vertices) == 0:
        raise SonarjaxError(f"{name}: the mesh is empty, expected at least one triangle")
    if not np.isfinite(vertices).all():
        raise SonarjaxError(f"{name}: vertices hold NaN or infinite values")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SonarjaxError(f"{name}: a triangle refers to a vertex that does not exist")
    extent = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    if extent > LARGEST_EXTENT_M:
        raise SonarjaxError(
            f"{name}: the mesh is {extent:.0f} m long; expected metres (in millimetres? then give unit_m=0.001)"
        )


def _padded(surface: trimesh.Trimesh, closed: bool) -> Mesh:
    vertices = np.asarray(surface.vertices, np.float32)
    faces = np.asarray(surface.faces, np.int32)
    crease = _crease_vertices(surface)
    used = vertices[np.unique(faces)]
    return Mesh(
        vertices=jnp.asarray(_pad(vertices, _bucket(len(vertices)), vertices[:1])),
        faces=jnp.asarray(_pad(faces, _bucket(len(faces)), np.zeros((1, 3), np.int32))),
        crease=jnp.asarray(_pad(crease, _bucket(max(len(crease), 1)), np.zeros(1, np.int32))),
        closed=closed,
        crossings=_rounded(most_crossings(vertices, faces, closed), len(faces)),
        front=_rounded(most_front(vertices, faces) if closed else len(faces), len(faces)),
        crossing=len(faces) > CHECKED_FACES or has_crossing_triangles(vertices, faces),
        radius=_round_up(float(np.hypot(used[:, 0], used[:, 1]).max())),
        top=_round_up(float(used[:, 2].max())),
    )


def _pad(values: np.ndarray, size: int, filler: np.ndarray) -> np.ndarray:
    return np.concatenate([values, np.repeat(filler, size - len(values), axis=0)])


def _bucket(count: int) -> int:
    """Smallest of 8, 12, 16, 24, 32, 48, 64, … that holds `count`: at most half of it is padding."""
    power = 1 << max(3, math.ceil(math.log2(count)))
    return power * 3 // 4 if 8 < count <= power * 3 // 4 else power


def _round_up(length: float, step: float = 0.01) -> float:
    return math.ceil(length / step - 1e-6) * step


def _crease_vertices(surface: trimesh.Trimesh) -> np.ndarray:
    """Vertices (event,) of sharp or open edges, in ascending order."""
    sharp = surface.face_adjacency_edges[surface.face_adjacency_angles > CREASE_ANGLE]
    unique, counts = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    return np.unique(np.concatenate([sharp, unique[counts == 1]])).astype(np.int32)


def _rounded(bound: int, faces: int) -> int:
    """`bound` rounded up, so that similar meshes share compiled code; never above the padded number of faces."""
    return min(-(-bound // 4) * 4 if bound < 64 else _bucket(bound), _bucket(faces))
