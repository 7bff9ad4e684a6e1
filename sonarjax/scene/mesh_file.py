"""Check mesh files before trimesh opens them: their size, what their headers announce, and why they cannot be read.

A header of a few bytes can ask for any amount of memory, so it is checked first. On a corrupt file trimesh tries one
reader after another and reports the trouble of the last; the messages here say what is wrong with the file.
"""

from __future__ import annotations

import json
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import check_size, size_limit
from sonarjax.scene.limits import MAX_FACES, check_face_count

MESH_LIMIT = 512 * 2**20
"""Largest mesh file, 512 MiB [bytes]: `MAX_FACES` triangles as text; a reader needs several times as much memory."""
HEADER_BYTES = 4096
"""How much of the start of a file is read to find its header [bytes]."""
STL_HEADER, STL_FACE = 84, 50
"""Size of the header and of a triangle of a binary STL file [bytes]."""
PLAIN = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Formats that trimesh reads without another package. An ImportError for one of them means text that cannot be decoded.
"""
PACKED = (".gz", ".bz2", ".xz", ".tar", ".tgz")


def check_mesh_file(path: Path) -> None:
    """Raise a SonarjaxError if a mesh file is too large, announces too much, or is truncated (where its size tells)."""
    size = path.stat().st_size
    check_size(str(path), size, min(MESH_LIMIT, size_limit()))
    ending = path.suffix.lower()
    if ending in PACKED:
        raise SonarjaxError(f"{path}: expected a mesh file, this is compressed: unpack it first")
    with open(path, "rb") as file:
        start = file.read(HEADER_BYTES)
    if ending == ".stl":
        _check_stl(path, start, size)
    elif ending == ".ply":
        _check_ply(path, start)
    elif ending in (".glb", ".gltf"):
        _check_gltf(path, start)
    elif start[:4] == b"PK\x03\x04":
        _check_zip(path)


def reading_problem(path: Path, error: Exception) -> SonarjaxError:
    """The error to raise after trimesh failed to read `path` with `error`: one line that names the file."""
    ending = path.suffix.lower()
    kind = ending.removeprefix(".").upper()
    if isinstance(error, MemoryError):
        return SonarjaxError(f"{path}: cannot be read as a mesh: not enough free memory")
    if isinstance(error, (ImportError, UnicodeError)) and ending in PLAIN:
        return SonarjaxError(f"{path}: cannot be read as a mesh: corrupt, or not {kind} (its text is not UTF-8)")
    if isinstance(error, ImportError):
        return SonarjaxError(f"{path}: reading {kind} files needs the Python package {_missing(error)}")
    reason = " ".join(str(error).split())[:160] or type(error).__name__
    return SonarjaxError(f"{path}: cannot be read as a mesh ({reason})")


def _missing(error: ImportError) -> str:
    """Name of the package that could not be imported. trimesh raises some of these errors anew, without their name."""
    quoted = re.search(r"No module named '([\w.]+)'", str(error))
    return error.name or (quoted[1] if quoted else f"that it names: {error}")


def _check_stl(path: Path, start: bytes, size: int) -> None:
    """A binary STL file says how many triangles follow. One that starts with `solid` may be text, left to trimesh."""
    count = struct.unpack_from("<I", start, STL_HEADER - 4)[0] if len(start) >= STL_HEADER else 0
    expected = STL_HEADER + STL_FACE * count
    if size == expected:
        check_face_count(count, str(path))
    elif b"\0" in start or not start.lstrip().lower().startswith(b"solid"):
        raise SonarjaxError(
            f"{path}: not an STL file, or corrupt: a binary STL with this header has {count} triangles in {expected} "
            f"bytes, the file has {size}; a text STL starts with 'solid'"
        )


def _check_ply(path: Path, start: bytes) -> None:
    for count in re.findall(rb"element\s+\w+\s+([0-9]{1,30})\s", start):
        if int(count) > 3 * MAX_FACES:
            check_face_count(int(count), f"{path}: header")


def _check_gltf(path: Path, start: bytes) -> None:
    """In glTF an accessor without data stands for that many zeros, however small the file is."""
    try:
        with open(path, "rb") as file:
            if start[:4] == b"glTF":
                file.seek(20)  # skip the header of the file and that of its first chunk, which holds the JSON
                text = file.read(struct.unpack_from("<I", start, 12)[0])
            else:
                text = file.read()
        counts = list(_accessor_counts(json.loads(text)))
    except (ValueError, RecursionError, struct.error):
        return  # trimesh will say what is wrong
    if sum(counts) > 16 * MAX_FACES:
        raise SonarjaxError(
            f"{path}: accessors: expected at most {16 * MAX_FACES} values in total, the header lists {sum(counts)}"
        )


def _accessor_counts(header: Any) -> Iterator[int]:
    accessors = header.get("accessors") if isinstance(header, dict) else None
    for accessor in accessors if isinstance(accessors, list) else ():
        count = accessor.get("count") if isinstance(accessor, dict) else None
        if isinstance(count, int) and count > 0:
            yield count


def _check_zip(path: Path) -> None:
    """A zipped format (3MF) may unpack to a thousand times its size."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(info.file_size for info in archive.infolist())
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        return  # trimesh will say what is wrong
    check_size(f"{path}: unpacked", unpacked, min(MESH_LIMIT, size_limit()))
