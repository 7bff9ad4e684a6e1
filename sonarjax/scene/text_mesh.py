"""Meshes in text files: what trimesh would read as another surface without a word is put right, or refused.

trimesh counts relative vertex numbers of OBJ from the end of the file instead of from the face's line. It triangulates
every polygon as a fan, which only suits convex ones, and it takes what is left of a truncated file for all of it.
"""

from __future__ import annotations

import io
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from sonarjax.io.errors import SonarjaxError

HEADER_BYTES = 4096
"""How much of the start of a file is read to find its header [bytes]."""
STL_WORDS = (b"solid", b"endsolid", b"facet")
"""What begins a solid, ends it, and begins a triangle."""
BOM = b"\xef\xbb\xbf"
"""What some editors write at the start of a text in UTF-8."""
UNUSUAL = re.compile(
    rb"^(?:" + BOM + rb"|[ \t]+[vf][ \t]|v\t|v [^#\n]*#|f(?!(?: +[1-9][^\s#]*){3}[ \r]*$)[ \t])", re.MULTILINE
)
"""A line of an OBJ file that trimesh may misread: indented, with tabs or a comment, or a face that is no triangle, has
numbers below 1, or goes on in the next line.
"""
PLY_FACES = ("vertex_index", "vertex_indices")
"""What the list of a face's vertices is called in PLY files."""
INWARD = -0.05
"""Sine of a polygon's turn at a corner below which it counts as turning inward; above it a fan's error is small."""


def source_for_trimesh(path: Path) -> dict[str, Any]:
    """What `trimesh.load` is to read: the file, or the text of an OBJ file in a form that it reads well.

    Raises:
        SonarjaxError: A face of an OBJ file has fewer than three corners or names no vertex, or is a polygon that is
            not convex.
    """
    if path.suffix.lower() != ".obj":
        return {"file_obj": path}
    text = path.read_bytes()
    if not UNUSUAL.search(text):  # the loops below take as long as trimesh
        return {"file_obj": path}
    lines = list(_plain(path, text.removeprefix(BOM).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()))
    _check_obj(path, lines)
    return {"file_obj": io.BytesIO(b"\n".join(lines)), "file_type": "obj"}


def check_complete(path: Path, triangles: int) -> None:
    """Raise a SonarjaxError if a text file announces or begins more faces than the `triangles` that were read."""
    ending = path.suffix.lower()
    if ending == ".stl":
        _check_stl(path, path.read_bytes(), triangles)
        return
    faces = {".obj": _faces_of_obj, ".ply": _faces_of_ply, ".off": _faces_of_off}.get(ending, lambda _: 0)(path)
    if triangles < faces:
        raise SonarjaxError(f"{path}: expected {faces} faces, could read {triangles} triangles: truncated or corrupt")


def check_polygons(path: Path, surface: trimesh.Trimesh) -> None:
    """Raise a SonarjaxError if a PLY or OFF file has a polygon that is not convex; `surface` is what trimesh read."""
    ending = path.suffix.lower()
    if ending == ".ply":
        _check_convex(path, *_polygons_of_ply(surface.metadata["_ply_raw"]))
    elif ending == ".off" and len(surface.faces) > _faces_of_off(path):
        _check_convex(path, surface.vertices, _polygons_of_off(path))


def _plain(path: Path, lines: Sequence[bytes]) -> Iterator[bytes]:
    """The lines of an OBJ file without comments, words one space apart, with faces of absolute vertex numbers alone.

    −1 is the last vertex before the line. Raises SonarjaxError for a number that is none of a vertex before the line.
    """
    vertices = 0
    for line in lines:
        words = line.split(b"#", 1)[0].split()
        vertices += words[:1] == [b"v"]
        if words[:1] == [b"f"]:
            numbers = [_number(corner) for corner in words[1:]]
            if any(n == 0 or n < -vertices for n in numbers):
                raise SonarjaxError(
                    f"{path}: face {_shown(line)}: expected numbers of vertices from 1 on, or from -1 back to "
                    f"{-vertices}, the first vertex"
                )
            words[1:] = [b"%d" % (n + vertices + 1 if n < 0 else n) for n in numbers]
        yield b" ".join(words)


def _number(corner: bytes) -> int:
    """The vertex number of a corner such as `3/1/2`. Raises ValueError where it is none."""
    return int(corner.split(b"/", 1)[0])


def _check_obj(path: Path, lines: Sequence[bytes]) -> None:
    """Raise a SonarjaxError for a face with fewer than three corners, or a polygon that is not convex."""
    polygons = []
    for face in (line for line in lines if line.startswith(b"f ") or line == b"f"):
        corners = face.split()[1:]
        if len(corners) < 3:
            raise SonarjaxError(f"{path}: face {_shown(face)}: expected three or more corners: truncated or corrupt")
        if len(corners) > 3:
            polygons.append([_number(corner) - 1 for corner in corners])
    if polygons:
        vertices = np.array([line.split()[1:4] for line in lines if line.startswith(b"v ")], np.float64)
        _check_convex(path, vertices, polygons)


def _check_convex(path: Path, vertices: np.ndarray, polygons: Sequence[Any]) -> None:
    """Raise a SonarjaxError if a polygon, given by numbers from 0 of `vertices` (vertex, 3), is not convex."""
    by_length = defaultdict(list)
    for polygon in polygons:
        by_length[len(polygon)].append(polygon)
    for alike in by_length.values():
        numbers = np.array(alike)
        if numbers.min() < 0 or numbers.max() >= len(vertices):
            continue  # `Mesh` reports it
        inward = np.flatnonzero(_turn_inward(vertices[numbers]))
        if len(inward):
            corners = " ".join(str(number) for number in numbers[inward[0]])[:60]
            raise SonarjaxError(
                f"{path}: face of vertices {corners} (from 0): expected a convex polygon: export the mesh as triangles"
            )


def _polygons_of_ply(elements: dict[str, Any]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Vertices (vertex, 3) and faces of more than three corners among the `elements` that trimesh read from a PLY."""
    faces, vertices = (elements.get(name, {}).get("data") for name in ("face", "vertex"))
    if faces is None or vertices is None:
        return np.zeros((0, 3)), []
    names = list(faces) if isinstance(faces, dict) else list(faces.dtype.names)
    lists = faces[next((name for name in names if name in PLY_FACES), names[0])]
    if lists.dtype.names:  # of a binary file: the count, and as many numbers in each face
        lists = lists[lists.dtype.names[-1]]
    triangles = lists.ndim == 2 and lists.shape[1] <= 3
    polygons = [] if triangles else [face for face in lists if len(face) > 3]
    return np.column_stack([np.asarray(vertices[axis], np.float64) for axis in "xyz"]), polygons


def _polygons_of_off(path: Path) -> list[list[int]]:
    """Faces of more than three corners of an OFF file that trimesh could read."""
    text = path.read_text(errors="replace").split("OFF", 1)[1]
    lines = [line for line in (line.split("#", 1)[0].split() for line in text.splitlines()) if line]
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    found = ([int(word) for word in line] for line in lines[1 + vertices : 1 + vertices + faces])
    return [numbers[1 : numbers[0] + 1] for numbers in found if numbers[0] > 3]


def _turn_inward(corners: np.ndarray) -> np.ndarray:
    """Whether polygons (face, corner, 3) turn inward at any corner (face,), seen along their mean normal."""
    edges = np.roll(corners, -1, axis=1) - corners
    turns = np.cross(edges, np.roll(edges, -1, axis=1))
    apart = corners - corners[:, :1]
    normal = np.cross(apart, np.roll(apart, -1, axis=1)).sum(axis=1)[:, None]
    length = np.linalg.norm(edges, axis=-1)
    scale = length * np.roll(length, -1, axis=1) * np.linalg.norm(normal, axis=-1)
    return ((turns * normal).sum(axis=-1) < INWARD * scale).any(axis=1)


def _shown(face: bytes) -> str:
    return repr(" ".join(face.decode(errors="replace").split())[:60])


def _check_stl(path: Path, text: bytes, triangles: int) -> None:
    """Raise a SonarjaxError if a text STL lacks the end of a solid, or a triangle. A binary one passes."""
    if b"\0" in text[:HEADER_BYTES] or text.lstrip()[:5].lower() != b"solid":
        return
    begun, ended, facets = (len(re.findall(rb"^[ \t]*" + word + rb"\b", text, re.M | re.I)) for word in STL_WORDS)
    if begun != ended:
        raise SonarjaxError(f"{path}: expected an `endsolid` for each `solid`, got {ended} for {begun}: truncated?")
    if facets != triangles:
        raise SonarjaxError(f"{path}: expected {facets} triangles, could read {triangles}: truncated or corrupt")


def _faces_of_obj(path: Path) -> int:
    return len(re.findall(rb"^[ \t]*f[ \t]", path.read_bytes(), re.M))


def _faces_of_ply(path: Path) -> int:
    with open(path, "rb") as file:
        found = re.search(rb"element\s+face\s+([0-9]{1,18})\s", file.read(HEADER_BYTES))
    return int(found[1]) if found else 0


def _faces_of_off(path: Path) -> int:
    """The second number after `OFF`; comments begin with `#`."""
    with open(path, "rb") as file:
        words = re.sub(rb"#[^\n]*", b"", file.read(HEADER_BYTES)).split()
    counts = words[1:3] if words[:1] and words[0].upper().endswith(b"OFF") else []
    return int(counts[1]) if len(counts) == 2 and counts[1].isdigit() else 0
