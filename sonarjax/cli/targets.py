"""Meshes that the command line names: files, or folders of them, and how they are read."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sonarjax.io import SonarjaxError, complain

MESH_ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf", ".3mf")
"""Endings of the files of a folder that are taken for meshes."""


def mesh_files(given: Sequence[str], option: str) -> dict[str, str]:
    """Mesh files by the stem of their names, in the order given; those of a folder in that of their names.

    `option` is what gave them, for messages.

    Raises SonarjaxError for a folder without meshes, or where two files have one stem.
    """
    files: dict[str, str] = {}
    for one in given:
        for path in _of_folder(Path(one), option) if Path(one).is_dir() else [one]:
            stem = Path(path).stem
            if stem in files:
                raise SonarjaxError(
                    f"{option}: {files[stem]} and {path} are both called {stem!r}: expected names that differ"
                )
            files[stem] = path
    return files


def _of_folder(folder: Path, option: str) -> list[str]:
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_ENDINGS and path.is_file())
    if not found:
        endings = ", ".join(MESH_ENDINGS)
        raise SonarjaxError(f"{option}: {folder}: expected a folder of meshes, there is no {endings} file in it")
    return [str(path) for path in found]


def load_mesh(path: str, sonar: Any, args: argparse.Namespace) -> Any:
    """The mesh of a file as the options of `add_mesh_options` say; a line on stderr tells what was reduced.

    Raises SonarjaxError for a mesh that cannot be read, or is too large for the sonar's view.
    """
    from sonarjax.render import check_fits, reduced_for  # JAX is set up by now
    from sonarjax.scene import Mesh

    mesh = Mesh.load(path, args.unit_m)
    check_fits(mesh, sonar, path)
    found = reduced_for(mesh, sonar, args.mesh_tolerance)
    if found.after < found.before:
        complain(f"{path}: {found}; --mesh-tolerance 0 keeps all", kind="note: ")
    return found.mesh
