"""Find and load the meshes that are named on the command line, as files or as folders of files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sonarjax.io import SonarjaxError, complain
from sonarjax.io.given import is_text

MESH_ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf", ".3mf")
"""File name endings of meshes. Other files in a folder are ignored."""


def mesh_files(given: Sequence[str], option: str) -> dict[str, str]:
    """List mesh files by the stems of their names.

    Args:
        given: Files, and folders of files. Their order is kept; the files of a folder are sorted by name.
        option: The command line option that names them, for error messages.

    Returns:
        Paths by stem.

    Raises:
        SonarjaxError: A name is empty, a folder holds no mesh, a stem is not in UTF-8, or two files have the same stem.
    """
    files: dict[str, str] = {}
    for one in given:
        if not one:  # pathlib would take it for the current folder
            raise SonarjaxError(f"{option}: expected a mesh file or a folder of meshes, got ''")
        for path in _of_folder(Path(one), option) if Path(one).is_dir() else [one]:
            stem = Path(path).stem
            if not is_text(stem):
                raise SonarjaxError(f"{option}: {path!r}: expected a file name in UTF-8, because results hold it")
            if stem in files:
                raise SonarjaxError(
                    f"{option}: {files[stem]} and {path} are both called {stem!r}: expected different names"
                )
            files[stem] = path
    return files


def _of_folder(folder: Path, option: str) -> list[str]:
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_ENDINGS and path.is_file())
    if not found:
        endings = ", ".join(MESH_ENDINGS)
        raise SonarjaxError(f"{option}: {folder}: expected a folder of meshes, found no {endings} file")
    return [str(path) for path in found]


def load_mesh(path: str, sonar: Any, args: argparse.Namespace, above_floor: bool = False) -> Any:
    """Load a mesh, reduce it if it is much finer than the sonar resolves, and let it stand with `--stand`.

    A line on stderr tells of a reduction, and of a mesh that does not stand on the floor.

    Args:
        path: The mesh file.
        sonar: The sonar.
        args: Parsed arguments, with the options of `add_mesh_options`.
        above_floor: Refuse a mesh that goes through the floor, instead of a note.

    Raises:
        SonarjaxError: The mesh cannot be read, is too large for the sonar's view, or goes through the floor
            although it must not.
    """
    from sonarjax.render import check_fits, reduced_for  # not at the top of the file: JAX must be set up first
    from sonarjax.scene import Mesh
    from sonarjax.scene.standing import REMEDY, check_above_floor, why_not_standing

    mesh = Mesh.load(path, args.unit_m)
    check_fits(mesh, sonar, path)
    found = reduced_for(mesh, sonar, args.mesh_tolerance)
    if found.after < found.before:
        complain(f"{path}: {found}; --mesh-tolerance 0 keeps all triangles", kind="note: ")
    if args.stand:
        return found.mesh.standing()
    if above_floor:
        check_above_floor(found.mesh, path)
    problem = why_not_standing(found.mesh)
    if problem is not None:
        complain(f"{path}: the floor is its z = 0, {problem}: {REMEDY}", kind="note: ")
    return found.mesh
