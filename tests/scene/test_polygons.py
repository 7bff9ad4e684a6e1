"""Polygons in PLY and OFF files: a fan suits the convex ones, the others are refused. Areas are closed forms."""

import math
import struct

import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene import Mesh


def area(mesh):
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def write_prism(path, outline, red=False):
    """Write a prism with one polygon for each side: OFF, or PLY in binary or text; `red`: faces have a colour."""
    n = len(outline)
    vertices = np.array([(x, y, z) for z in (0.0, 0.1) for x, y in outline])
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    faces = [list(range(n))[::-1], list(range(n, 2 * n)), *sides]
    colour = "property uchar red\n" if red else ""
    lines = [" ".join(map(str, v)) for v in vertices]
    lines += [" ".join(map(str, ([7] if red else []) + [len(face), *face])) for face in faces]
    header = (
        "ply\nformat {} 1.0\n" + f"element vertex {2 * n}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\n{colour}property list uchar int vertex_indices\nend_header\n"
    )
    if path.suffix == ".off":
        path.write_text("\n".join([f"OFF # a prism\n{2 * n} {len(faces)} 0", *lines]))
    elif path.stem.endswith("binary"):
        data = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
        path.write_bytes(header.format("binary_little_endian").encode() + vertices.astype("<f4").tobytes() + data)
    else:
        path.write_text(header.format("ascii") + "\n".join(lines) + "\n")


@pytest.mark.parametrize("name", ["text.ply", "red.ply", "binary.ply", "text.off"])
def test_polygons_of_other_formats(name, tmp_path):
    """Four corners: a rhombus as sides and ends; a dart, whose fan covers another area, is refused."""
    rhombus = np.array([(0.0, 0.0), (0.3, -0.2), (0.6, 0.0), (0.3, 0.2)])
    dart = np.array([(0.3, -0.2), (0.1, 0.0), (0.3, 0.2), (0.0, 0.0)])
    write_prism(tmp_path / name, rhombus, red=name == "red.ply")
    expected = 2 * 0.12 + 0.1 * 4 * math.hypot(0.3, 0.2)
    assert area(Mesh.load(tmp_path / name)) == pytest.approx(expected, rel=1e-5)
    write_prism(tmp_path / name, dart, red=name == "red.ply")
    with pytest.raises(SonarjaxError, match=f"{name}: face of vertices .*expected a convex polygon"):
        Mesh.load(tmp_path / name)


def test_polygons_of_unequal_length_in_a_text_ply(tmp_path):
    """A pentagon's ends have five corners, its sides four; an L's fan would fill the notch."""
    angles = np.linspace(0, 2 * np.pi, 5, endpoint=False)
    write_prism(tmp_path / "mixed.ply", np.stack([np.cos(angles), np.sin(angles)], axis=1))
    expected = 5 * np.sin(2 * np.pi / 5) + 0.1 * 5 * 2 * np.sin(np.pi / 5)
    assert area(Mesh.load(tmp_path / "mixed.ply")) == pytest.approx(expected, rel=1e-5)
    write_prism(tmp_path / "mixed.ply", np.array([[1, 0], [1, 1], [0.5, 1], [0.5, 0.5], [0, 0.5], [0, 0]]))
    with pytest.raises(SonarjaxError, match="mixed.ply: face of vertices .*expected a convex polygon"):
        Mesh.load(tmp_path / "mixed.ply")
