"""Meshes that are too large, too far off, too fine or corrupt: one clear line, before memory is spent on them."""

import json
import os
import struct
import zipfile

import numpy as np
import pytest
import trimesh

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene import Mesh
from sonarjax.scene.limits import MAX_FACES
from sonarjax.scene.slicing import most_front

BOX = trimesh.creation.box((0.2, 0.1, 0.06))


def refused(path, *parts):
    """The one line that says why `path` is no mesh; it names the file and says `parts`."""
    with pytest.raises(SonarjaxError) as caught:
        Mesh.load(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text
    assert "No module named" not in text
    assert all(part in text for part in parts), text


# Where it is


@pytest.mark.parametrize("offset", [1e4, 1e6, 1e9, 1e20, 1e38, 1e300])
def test_a_mesh_far_from_its_own_origin(offset):
    with pytest.raises(SonarjaxError, match="thing: the mesh (lies .* from its own origin|is 0 m long)"):
        Mesh.from_arrays(BOX.vertices + [offset, 0, -offset], BOX.faces, name="thing")


@pytest.mark.parametrize("offset", [10.0, 999.0])
def test_a_mesh_within_the_limit_is_right_and_silent(offset):
    mesh = Mesh.from_arrays(BOX.vertices + [offset, 0, 0], BOX.faces)
    np.testing.assert_allclose(np.ptp(np.asarray(mesh.vertices), axis=0), [0.2, 0.1, 0.06], atol=1e-4)
    assert mesh.closed and mesh.crossings > 0


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e-6])
def test_a_mesh_that_was_scaled_twice(scale):
    with pytest.raises(SonarjaxError, match="thing: the mesh is .* m long; expected 0.0001 m or more"):
        Mesh.from_arrays(BOX.vertices * scale, BOX.faces, name="thing")


@pytest.mark.parametrize("scale", [1e10, 1e150, 1e307])
def test_a_mesh_of_absurd_size(scale, tmp_path):
    with pytest.raises(SonarjaxError, match=r"thing: the mesh is .* long; expected metres \(is the file corrupt\?\)"):
        Mesh.from_arrays(BOX.vertices * scale, BOX.faces, name="thing")
    BOX.export(tmp_path / "box.off")
    with pytest.raises(SonarjaxError, match="box.off: "):
        Mesh.load(tmp_path / "box.off", unit_m=scale)


def test_a_far_vertex_that_no_triangle_uses_changes_nothing():
    mesh = Mesh.from_arrays(np.concatenate([[[1e300, 0, 0]], BOX.vertices]), BOX.faces + 1)
    assert mesh.radius < 0.2


# How much it is


def test_more_triangles_than_the_limit_are_refused_before_they_are_copied():
    faces = np.broadcast_to(np.array([0, 1, 2], np.int32), (10**9, 3))  # takes no memory until it is copied
    with pytest.raises(SonarjaxError, match=f"thing: expected at most {MAX_FACES} triangles, got 1000000000"):
        Mesh.from_arrays(BOX.vertices, faces, name="thing")


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb", "off", "3mf"])
def test_a_sparse_file_of_many_gigabytes(ending, tmp_path):
    path = tmp_path / f"huge.{ending}"
    path.write_bytes(b"solid")
    os.truncate(path, 50 * 2**30)
    refused(path, "too large: expected at most 512 MiB, got 50 GiB")


def test_an_stl_of_too_many_triangles(tmp_path):
    path = tmp_path / "fine.stl"
    path.write_bytes(bytes(80) + struct.pack("<I", 5_000_000))
    os.truncate(path, 84 + 50 * 5_000_000)
    refused(path, "at most 2097152 triangles, got 5000000")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_ply_that_announces_too_much(form, tmp_path):
    path = tmp_path / "fine.ply"
    path.write_text(
        f"ply\nformat {form} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 100000000\nproperty list uchar int vertex_indices\nend_header\n"
    )
    refused(path, "at most 2097152 triangles, got 100000000")


def test_a_gltf_that_announces_too_much(tmp_path):
    """An accessor without data stands for zeros: a hundred bytes ask for any amount of memory."""
    header = {"asset": {"version": "2.0"}, "accessors": [{"componentType": 5126, "count": 10**11, "type": "VEC3"}]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    (tmp_path / "fine.glb").write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunk)) + chunk)
    (tmp_path / "fine.gltf").write_bytes(text)
    refused(tmp_path / "fine.glb", "accessors: expected at most", "lists 100000000000")
    refused(tmp_path / "fine.gltf", "accessors: expected at most", "lists 100000000000")


def test_a_scene_that_repeats_a_mesh_too_often(tmp_path, monkeypatch):
    monkeypatch.setattr("sonarjax.scene.limits.MAX_FACES", 100)
    scene = trimesh.Scene()
    for k in range(10):
        scene.add_geometry(BOX, geom_name="box", transform=trimesh.transformations.translation_matrix([k, 0, 0]))
    scene.export(tmp_path / "scene.glb")
    refused(tmp_path / "scene.glb", "at most 100 triangles, got 120")


def test_a_zip_that_unpacks_to_too_much(tmp_path):
    path = tmp_path / "bomb.3mf"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a", "w", force_zip64=True) as file:
        for _ in range(9):
            file.write(bytes(2**26))
    refused(path, "unpacked: the file is too large: expected at most 512 MiB, got 576 MiB")


def test_packed_files_are_to_be_unpacked(tmp_path):
    (tmp_path / "box.stl.gz").write_bytes(b"packed")
    refused(tmp_path / "box.stl.gz", "unpack it")


def test_few_triangles_look_at_once_as_of_a_sphere():
    """The directions are tried in parts: half of a sphere's triangles, and 10 % more, as when tried together."""
    ball = trimesh.creation.icosphere(5, 0.2)  # 20480 triangles
    count = most_front(np.asarray(ball.vertices, np.float32), np.asarray(ball.faces, np.int32))
    assert count == pytest.approx(0.55 * len(ball.faces), rel=0.03)


# What is wrong with it


def test_a_corrupt_binary_stl_says_what_its_header_announces(tmp_path):
    path = tmp_path / "box.stl"
    BOX.export(path)
    content = bytearray(path.read_bytes())
    content[80:84] = struct.pack("<I", 77)
    path.write_bytes(content)
    refused(path, "77 triangles in 3934 bytes, the file has 684")
    path.write_bytes(content[:60])
    refused(path, "not an STL file, or corrupt")


@pytest.mark.parametrize("ending", ["obj", "off", "stl"])
def test_text_that_is_not_utf8(ending, tmp_path):
    path = tmp_path / f"box.{ending}"
    BOX.export(path, **({"file_type": "stl_ascii"} if ending == "stl" else {}))
    path.write_bytes(path.read_bytes().replace(b"0", b"\xff\xfe"))
    refused(path)  # what is wrong with it depends on whether a package that guesses encodings is installed


def test_a_format_that_needs_another_package(tmp_path, monkeypatch):
    (tmp_path / "box.3mf").write_bytes(b"any")

    def absent(*_, **__):
        raise ModuleNotFoundError("No module named 'lxml'", name="lxml")

    monkeypatch.setattr(trimesh, "load", absent)
    refused(tmp_path / "box.3mf", "3MF files needs the Python package lxml")


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb", "off"])
def test_corrupt_files_give_a_mesh_or_one_line(ending, tmp_path, rng):
    path = tmp_path / f"ball.{ending}"
    trimesh.creation.icosphere(1, 0.1).export(path)
    whole = path.read_bytes()
    for trial in range(60):
        content = bytearray(whole)
        if trial % 3 == 0:
            content = content[: int(rng.integers(1, len(whole)))]
        else:
            first = 200 if trial % 3 == 1 else len(content)
            for at in rng.integers(0, min(first, len(content)), 8):
                content[at] = rng.integers(256)
        path.write_bytes(content)
        try:
            Mesh.load(path)
        except SonarjaxError as error:
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
            assert "No module named" not in str(error)
