"""`Mesh`: files through trimesh, clear errors, padding that keeps the surface, and the bound on crossings."""

import math
import os
import zipfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from sonarjax.io.errors import SonarjaxError
from sonarjax.scene import Mesh, objects, stack_meshes

PIPE = Path(os.environ.get("SONARJAX_REAL_DATA", "absent")) / "pipe" / "pipe.stl"
TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def surface(mesh):
    """The mesh in trimesh, padding included."""
    return trimesh.Trimesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces), process=False)


def two_boxes():
    """Two boxes apart, the second inside out."""
    one = trimesh.creation.box((0.2, 0.1, 0.1))
    other = trimesh.creation.box((0.1, 0.1, 0.3), trimesh.transformations.translation_matrix([0.4, 0.1, 0.0]))
    other.invert()
    return trimesh.util.concatenate([one, other])


# Files


@pytest.mark.parametrize("extension", ["stl", "obj", "ply", "glb", "off"])
@pytest.mark.parametrize("solid", [trimesh.creation.box((0.19, 0.09, 0.057)), trimesh.creation.icosphere(2, 0.11)])
def test_round_trip_through_a_file(extension, solid, tmp_path):
    solid.export(tmp_path / f"solid.{extension}")
    mesh = Mesh.load(tmp_path / f"solid.{extension}")
    assert mesh.closed
    assert surface(mesh).area == pytest.approx(solid.area, rel=1e-5)
    assert surface(mesh).volume == pytest.approx(solid.volume, rel=1e-5)
    np.testing.assert_allclose(surface(mesh).bounds, solid.bounds, atol=1e-6)


def test_ascii_stl_and_a_path_as_text(tmp_path):
    trimesh.creation.box((0.2, 0.1, 0.1)).export(tmp_path / "box.stl", file_type="stl_ascii")
    assert Mesh.load(str(tmp_path / "box.stl")).closed


def test_a_scene_is_one_surface_with_its_transforms(tmp_path):
    box, scene = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.Scene()
    for x in (0.0, 0.5):
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    scene.export(tmp_path / "scene.glb")
    mesh = Mesh.load(tmp_path / "scene.glb")
    np.testing.assert_allclose(surface(mesh).extents, [0.6, 0.1, 0.1], rtol=1e-5)
    assert surface(mesh).volume == pytest.approx(2e-3, rel=1e-5)


def test_millimetres_are_noticed_and_unit_m_scales(tmp_path):
    path = tmp_path / "brick.stl"
    trimesh.creation.box((190, 90, 57)).export(path)
    with pytest.raises(SonarjaxError, match=r"brick.stl: the mesh is 190 m long; expected metres.*unit_m=0.001"):
        Mesh.load(path)
    np.testing.assert_allclose(surface(Mesh.load(path, unit_m=1e-3)).extents, [0.19, 0.09, 0.057], rtol=1e-5)


@pytest.mark.parametrize("unit", [0.0, -0.001, math.nan, math.inf])
def test_impossible_units(unit, tmp_path):
    trimesh.creation.box((0.2, 0.1, 0.1)).export(tmp_path / "box.stl")
    with pytest.raises(SonarjaxError, match="unit_m must be a positive number"):
        Mesh.load(tmp_path / "box.stl", unit_m=unit)


@pytest.mark.parametrize(
    ("unit", "scale"),
    [("mm", 1e-3), ("millimeters", 1e-3), ("inches", 0.0254), ("0.0254 * meters", 0.0254), (None, 1.0)],
)
def test_the_units_of_the_file_are_used(unit, scale, tmp_path, monkeypatch):
    solid = trimesh.creation.box((1.0, 2.0, 3.0))
    solid.units = unit
    monkeypatch.setattr(trimesh, "load", lambda *_, **__: solid)
    (tmp_path / "box.any").write_text("read by the line above")
    extents = surface(Mesh.load(tmp_path / "box.any")).extents
    np.testing.assert_allclose(extents, np.multiply([1, 2, 3], scale), rtol=1e-5)
    assert surface(Mesh.load(tmp_path / "box.any", unit_m=0.5)).extents[0] == pytest.approx(0.5)  # the caller wins
    solid.units = "cubits"
    refused(tmp_path / "box.any", "holds lengths in 'cubits', expected a known unit")
    assert surface(Mesh.load(tmp_path / "box.any", unit_m=0.5)).extents[0] == pytest.approx(0.5)


def test_3mf_is_in_millimetres_by_default(tmp_path):
    pytest.importorskip("lxml")  # trimesh reads 3MF with it
    solid = trimesh.creation.box((190, 90, 57))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in solid.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in solid.faces)
    model = (
        '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>'
        '</object></resources><build><item objectid="1"/></build></model>'
    )
    with zipfile.ZipFile(tmp_path / "brick.3mf", "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
    np.testing.assert_allclose(surface(Mesh.load(tmp_path / "brick.3mf")).extents, [0.19, 0.09, 0.057], rtol=1e-5)


def refused(path, message):
    with pytest.raises(SonarjaxError) as caught:
        Mesh.load(path)
    text = str(caught.value)
    assert message in text
    assert text.startswith(f"{path}: ")
    assert "\n" not in text


def test_missing_folder_and_empty_file(tmp_path):
    refused(tmp_path / "none.stl", "no such mesh file")
    refused(tmp_path, "is a folder")
    (tmp_path / "empty.stl").touch()
    refused(tmp_path / "empty.stl", "the mesh file is empty")


@pytest.mark.parametrize("file_type", ["stl", "stl_ascii"])
@pytest.mark.parametrize("keep", [0.05, 0.5, 0.97])
def test_truncated_stl(file_type, keep, tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((0.2, 0.1, 0.1)).export(path, file_type=file_type)
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    refused(path, "")


@pytest.mark.parametrize("extension", ["ply", "glb", "off", "obj"])
def test_other_truncated_files(extension, tmp_path):
    path = tmp_path / f"box.{extension}"
    trimesh.creation.box((0.2, 0.1, 0.1)).export(path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    refused(path, "")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("garbage.stl", "garbage garbage\n", ""),
        ("note.txt", "hello", "cannot be read as a mesh"),
        ("noextension", "hello", "cannot be read as a mesh"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "expected a surface"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "expected a surface"),
        ("points.xyz", "0 0 0\n1 1 1\n", "expected a surface"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
        ("index.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", ""),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "zero area"),
    ],
)
def test_files_that_hold_no_surface(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    refused(tmp_path / name, message)


@pytest.mark.parametrize(
    ("name", "removed", "message"),
    [
        ("two.stl", b"endsolid", "an `endsolid` for each `solid`, got 1 for 2"),
        ("two.ply", b"3 ", "could read 23 triangles"),
        ("two.off", b"3 ", "could read 23 triangles"),
        ("two.obj", b" ", "expected three or more corners"),
    ],
)
def test_text_files_that_lack_their_last_part(name, removed, message, tmp_path):
    """Cut before the last word of this kind; trimesh reads the rest as if it were all."""
    text = {"stl": {"file_type": "stl_ascii"}, "ply": {"encoding": "ascii"}}.get(name[-3:], {})
    parts = [two_boxes().split()[k].export(file_type="stl_ascii") for k in (0, 1)] if name == "two.stl" else []
    content = "".join(parts) if parts else two_boxes().export(file_type=name[-3:], **text)
    content = (content if isinstance(content, bytes) else content.encode()).rstrip()
    (tmp_path / name).write_bytes(content)
    assert Mesh.load(tmp_path / name).n_faces == 24
    (tmp_path / name).write_bytes(content[: content.rindex(removed)])
    refused(tmp_path / name, message)


def test_relative_vertex_numbers_count_from_the_line_of_their_face(tmp_path):
    """Each triangle right after its corners, as some exporters write."""
    corners = two_boxes().triangles
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for triangle in corners for x, y, z in triangle]
    faces = ["f -3/-1 -2/-1 -1/-1"] * len(corners)
    text = [line for k, face in enumerate(faces) for line in (*lines[3 * k : 3 * k + 3], face)]
    (tmp_path / "relative.obj").write_text("\n".join(text))
    assert np.allclose(surface(Mesh.load(tmp_path / "relative.obj")).bounds, two_boxes().bounds, atol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("v ", "\tv ", 1),
        lambda text: text.replace(" ", "\t"),
        lambda text: "".join(f"{line} # {k}\n" for k, line in enumerate(text.splitlines())),
        lambda text: text.replace("f 1 3 2\n", "f 1 3 \\\n 2\n"),
    ],
    ids=["BOM", "indented", "tabs", "comments", "continued"],
)
def test_an_obj_is_the_same_surface_however_it_is_written(change, tmp_path):
    """One vertex more than is used, so that a line that is not read moves the others instead of failing."""
    corners = [(0, 0, 0), (0.3, 0, 0), (0, 0.2, 0), (0, 0, 0.1), (9, 9, 9)]
    faces = ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 3 1 4"]
    text = "\n".join([*(f"v {x} {y} {z}" for x, y, z in corners), *faces, ""])
    (tmp_path / "a.obj").write_text(change(text), encoding="utf-8")
    found = surface(Mesh.load(tmp_path / "a.obj"))
    assert found.volume == pytest.approx(0.3 * 0.2 * 0.1 / 6, rel=1e-5) and found.bounds[1].max() < 0.31


@pytest.mark.parametrize("face", ["f 0 1 2", "f -5 -2 -1"])
def test_numbers_of_no_vertex_are_refused(face, tmp_path):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n{face}\n")
    refused(tmp_path / "a.obj", f"face '{face}': expected numbers of vertices from 1 on, or from -1 back to -4")


def test_a_name_that_no_file_can_have_is_refused():
    refused("a" * 300 + ".stl", "cannot be read")


def test_polygons_are_read_where_a_fan_suits_them(tmp_path):
    """A convex pentagon as one face; an L, whose fan would fill the notch, is refused."""
    angles = np.linspace(0, 2 * np.pi, 5, endpoint=False)
    outlines = {
        "convex": np.stack([np.cos(angles), np.sin(angles)], axis=1),
        "concave": np.array([[1, 0], [1, 1], [0.5, 1], [0.5, 0.5], [0, 0.5], [0, 0]]),
    }
    for name, outline in outlines.items():
        text = [f"v {x} {y} 0" for x, y in outline] + ["f " + " ".join(map(str, range(1, len(outline) + 1)))]
        (tmp_path / f"{name}.obj").write_text("\n".join(text))
    area = surface(Mesh.load(tmp_path / "convex.obj")).area
    assert area == pytest.approx(2.5 * np.sin(2 * np.pi / 5), rel=1e-5)
    refused(tmp_path / "concave.obj", "expected a convex polygon")


def test_a_missing_reader_is_named(tmp_path, monkeypatch):
    """trimesh keeps the error of a failed import, and raises it anew without the module's name."""

    def without_lxml(*_, **__):
        raise ModuleNotFoundError("No module named 'lxml'")

    monkeypatch.setattr(trimesh, "load", without_lxml)
    (tmp_path / "box.3mf").write_bytes(b"PK")
    refused(tmp_path / "box.3mf", "reading 3MF files needs the Python package lxml")


def test_microns_are_a_unit_of_3mf(tmp_path, monkeypatch):
    solid = trimesh.creation.box((1e5, 2e5, 3e5))
    solid.units = "micron"
    monkeypatch.setattr(trimesh, "load", lambda *_, **__: solid)
    (tmp_path / "box.any").write_text("read by the line above")
    np.testing.assert_allclose(surface(Mesh.load(tmp_path / "box.any")).extents, [0.1, 0.2, 0.3], rtol=1e-5)


def test_a_point_cloud_is_no_surface(tmp_path):
    trimesh.PointCloud(np.random.default_rng(0).random((20, 3))).export(tmp_path / "cloud.ply")
    refused(tmp_path / "cloud.ply", "PointCloud, expected a surface")


# Arrays


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (TRIANGLE * [[1, 1, 1], [1, 1, 1], [1, np.nan, 1]], [[0, 1, 2]], "NaN or infinite"),
        (TRIANGLE + [[0, 0, np.inf]], [[0, 1, 2]], "NaN or infinite"),
        (TRIANGLE, [[0, 1, 3]], "a vertex that does not exist"),
        (TRIANGLE, [[0, 1, -1]], "a vertex that does not exist"),
        (TRIANGLE, [[0, 1, 2.5]], "faces: expected whole vertex numbers"),
        (TRIANGLE, [[0, 1, np.nan]], "faces: expected whole vertex numbers"),
        (TRIANGLE, [[0, 1, np.inf]], "a vertex that does not exist"),
        (TRIANGLE, np.zeros((0, 3)), "is empty"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "is empty"),
        (TRIANGLE[:, :2], [[0, 1, 2]], "expected vertices (n, 3)"),
        (TRIANGLE, [0, 1, 2], "expected vertices (n, 3)"),
        (TRIANGLE, [[0, 1, 1], [0, 0, 0]], "every triangle has zero area"),
        (TRIANGLE * 200, [[0, 1, 2]], "200 m long"),
    ],
)
def test_arrays_that_are_no_surface(vertices, faces, message):
    with pytest.raises(SonarjaxError) as caught:
        Mesh.from_arrays(vertices, faces, name="thing")
    assert str(caught.value).startswith("thing: ")
    assert message in str(caught.value)


def test_whole_vertex_numbers_may_be_floats():
    assert Mesh.from_arrays(TRIANGLE, [[0.0, 1.0, 2.0]]).faces[0].tolist() == [0, 1, 2]


def test_degenerate_triangles_are_dropped():
    box = trimesh.creation.box((0.2, 0.1, 0.1))
    faces = np.concatenate([box.faces, [[0, 0, 1], [2, 2, 2]]])
    mesh = Mesh.from_arrays(box.vertices, faces)
    assert mesh.closed
    assert np.count_nonzero(surface(mesh).area_faces) == 12


def test_a_vertex_that_no_triangle_uses_changes_nothing():
    box = trimesh.creation.box((0.2, 0.1, 0.1))
    mesh = Mesh.from_arrays(np.concatenate([box.vertices, [[500.0, 0, 0]]]), box.faces)
    assert mesh.radius < 0.2
    assert np.abs(mesh.vertices).max() < 0.2


def test_watertight_or_not():
    box = trimesh.creation.box((0.2, 0.1, 0.1))
    assert Mesh.from_arrays(box.vertices, box.faces).closed
    assert not Mesh.from_arrays(box.vertices, box.faces[:-1]).closed
    assert not Mesh.from_arrays(TRIANGLE, [[0, 1, 2]]).closed


def test_normals_of_every_closed_body_point_out():
    mixed = trimesh.creation.icosphere(2, 0.1)
    mixed.faces[::3] = mixed.faces[::3, ::-1]  # a third of the triangles wound the wrong way
    assert surface(Mesh.from_arrays(mixed.vertices, mixed.faces)).volume == pytest.approx(4.0e-3, rel=0.06)
    boxes = two_boxes()
    mesh = Mesh.from_arrays(boxes.vertices, boxes.faces)
    assert mesh.closed
    assert surface(mesh).volume == pytest.approx(2e-3 + 3e-3, rel=1e-5)


@pytest.mark.parametrize("inside_out", [False, True])
def test_normals_around_a_cavity_point_into_it(inside_out):
    """A room with thick walls and a box in it; the box inside out is one part of a file that has all bodies right."""
    outer, inner = trimesh.creation.box((7, 5, 3)), trimesh.creation.box((6.8, 4.8, 2.8))
    box = trimesh.creation.box((0.3, 0.3, 0.3), trimesh.transformations.translation_matrix([2.0, 1.0, 0.0]))
    inner.invert()
    wall, room = 7 * 5 * 3 - 6.8 * 4.8 * 2.8, trimesh.util.concatenate([outer, inner, box])
    alike = trimesh.util.concatenate([outer, box])  # a part within a housing is no cavity
    if inside_out:
        room.invert()
        alike.invert()
    for solid, volume in ((room, wall + 0.027), (alike, 7 * 5 * 3 + 0.027)):
        mesh = Mesh.from_arrays(solid.vertices, solid.faces)
        assert mesh.closed and surface(mesh).volume == pytest.approx(volume, rel=1e-4)


def test_a_face_that_occurs_on_both_sides_counts_once():
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    both = Mesh.from_arrays(box.vertices, np.concatenate([box.faces, box.faces[:, ::-1]]))
    once = Mesh.from_arrays(box.vertices, box.faces)
    assert both.closed and both.crossings == once.crossings and set(np.asarray(both.crease)) == set(range(8))


@pytest.mark.parametrize("count", [1, 7, 8, 9, 12, 13, 50, 300])
def test_padding_keeps_the_surface(count):
    rng = np.random.default_rng(count)
    soup = trimesh.Trimesh(rng.uniform(-0.5, 0.5, (3 * count, 3)), np.arange(3 * count).reshape(-1, 3), process=False)
    mesh = Mesh.from_arrays(soup.vertices, soup.faces)
    padded = surface(mesh)
    assert count <= mesh.n_faces <= max(8, 2 * count)
    assert padded.area == pytest.approx(soup.area, rel=1e-5)
    np.testing.assert_allclose(padded.bounds, soup.bounds, atol=1e-6)
    assert 0 <= padded.faces.min() <= padded.faces.max() < len(padded.vertices)
    np.testing.assert_allclose(padded.area_faces[:count], soup.area_faces, rtol=1e-4, atol=1e-7)
    assert not padded.area_faces[count:].any()


def test_creases_are_the_sharp_edges():
    box = objects.brick()
    assert set(np.asarray(box.crease).tolist()) == set(range(8))
    ball = objects.ball()
    assert set(np.asarray(ball.crease).tolist()) == {0}  # smooth: padding only
    rims = {int(i) for i in objects.concrete_cylinder().crease}
    heights = np.asarray(objects.concrete_cylinder().vertices)[sorted(rims), 2]
    assert np.all(np.isclose(heights, 0.0) | np.isclose(heights, 0.15))


def test_the_foot_of_a_fin_on_a_sheet_is_a_crease():
    """Three triangles meet there, and the sheet is flat; the other vertices are at open edges."""
    sheet = [[x, y, 0.0] for x in range(3) for y in range(3)]
    fin = [[1.0, y, 1.0] for y in range(3)]
    quads = [[0, 3, 4, 1], [1, 4, 5, 2], [3, 6, 7, 4], [4, 7, 8, 5], [3, 4, 10, 9], [4, 5, 11, 10]]
    faces = [[a, b, c] for a, b, c, _ in quads] + [[a, c, d] for a, _, c, d in quads]
    mesh = Mesh.from_arrays(sheet + fin, faces)
    middle = np.flatnonzero((np.asarray(mesh.vertices) == [1, 1, 0]).all(axis=1))[0]
    assert middle in np.asarray(mesh.crease)


# The pytree


def test_what_was_measured_of_one_mesh_is_no_key_of_compiled_code():
    mesh = objects.target()
    leaves = {str(path[-1]): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(mesh)}
    assert set(leaves) == {".vertices", ".faces", ".crease", ".closed", ".radius", ".top"}
    assert all(isinstance(leaf, jax.Array) for leaf in leaves.values())


def test_new_vertices_are_measured_again_where_they_are_known():
    mesh = objects.target()
    larger = mesh.with_vertices(2 * mesh.vertices)
    np.testing.assert_array_equal(larger.vertices, 2 * mesh.vertices)
    assert larger.faces is mesh.faces
    for name in ("radius", "top"):
        assert float(getattr(larger, name)) == pytest.approx(2 * float(getattr(mesh, name)), abs=0.011)
    kept = jax.jit(lambda v: mesh.with_vertices(v))(2 * mesh.vertices)
    assert float(kept.radius) == float(mesh.radius)
    with pytest.raises(SonarjaxError, match="vertices: expected shape"):
        mesh.with_vertices(mesh.vertices[:-1])
    with pytest.raises(SonarjaxError, match="vertices: hold NaN"):
        mesh.with_vertices(mesh.vertices.at[0, 0].set(jnp.nan))


def test_a_mirrored_body_still_faces_outwards():
    brick = objects.target()
    mirrored = brick.with_vertices(brick.vertices * jnp.array([1.0, -1.0, 1.0]))
    assert surface(mirrored).volume == pytest.approx(surface(brick).volume, rel=1e-5)
    again = mirrored.with_vertices(brick.vertices)
    np.testing.assert_array_equal(again.faces, brick.faces)
    sheet = Mesh.from_arrays(TRIANGLE, [[0, 1, 2]])  # is seen from both sides
    assert sheet.with_vertices(-sheet.vertices).faces is sheet.faces


def test_new_vertices_of_a_stack_go_through_vmap():
    stack = stack_meshes([objects.brick()] * 2)
    moved = jax.vmap(lambda mesh: mesh.with_vertices(2 * mesh.vertices))(stack)
    np.testing.assert_array_equal(moved.vertices, 2 * stack.vertices)


def test_room_only_grows_and_not_beyond_the_faces():
    mesh = objects.target()
    same = mesh.with_room(0, 0)
    assert (same.crossings, same.front) == (mesh.crossings, mesh.front)
    roomy = mesh.with_room(mesh.crossings + 1, 10**6)
    assert roomy.crossings > mesh.crossings and roomy.front <= mesh.n_faces


def test_stacked_meshes_keep_their_surfaces():
    meshes = [objects.target(), objects.brick(), objects.concrete_cylinder()]
    batch = stack_meshes(meshes)
    assert batch.closed.shape == batch.radius.shape == (3,)
    assert (batch.crossings, batch.front) == tuple(max(getattr(m, n) for m in meshes) for n in ("crossings", "front"))
    for k, mesh in enumerate(meshes):
        one = surface(jax.tree.map(lambda v, k=k: v[k], batch))
        assert one.volume == pytest.approx(surface(mesh).volume, rel=1e-5)
        np.testing.assert_allclose(one.bounds, surface(mesh).bounds, atol=1e-6)
    with pytest.raises(SonarjaxError, match="at least one mesh"):
        stack_meshes([])


def test_meshes_of_like_size_share_compiled_code():
    traced = []

    @jax.jit
    def total(mesh):
        traced.append(mesh.n_faces)
        return mesh.vertices.sum()

    total(objects.brick())
    total(objects.brick(0.185, 0.088, 0.055))
    assert len(traced) == 1


# The bound on crossings


def brute_force_crossings(mesh, planes, rng):
    """Most triangles (front faces only where closed) that random vertical half-planes from a sonar cross."""
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]  # (face, corner, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners, normals = corners[np.any(normals != 0, axis=1)], normals[np.any(normals != 0, axis=1)]
    most = 0
    for _ in range(planes):
        bearing, distance = rng.uniform(0, 2 * math.pi), rng.uniform(1.5, 4.0)
        sonar = distance * np.array([math.cos(bearing), math.sin(bearing), 0]) + [0, 0, rng.uniform(0.1, 1.5)]
        aim = rng.uniform(-1, 1, 2) * float(mesh.radius) - sonar[:2]
        sides = (corners[..., :2] - sonar[:2]) @ np.array([-aim[1], aim[0]])  # (face, corner)
        crossed = (sides.min(axis=1) <= 0) & (sides.max(axis=1) >= 0)
        front = np.einsum("fk,fk->f", normals, sonar - corners[:, 0]) > 0
        most = max(most, int(np.sum(crossed & front if bool(mesh.closed) else crossed)))
    return most


def soup(count=200):
    vertices = np.random.default_rng(5).uniform(-0.3, 0.3, (3 * count, 3))
    return Mesh.from_arrays(vertices, np.arange(3 * count).reshape(-1, 3))


def fine_ball():
    sphere = trimesh.creation.icosphere(4, 0.2)
    return Mesh.from_arrays(sphere.vertices, sphere.faces)


@pytest.mark.parametrize(
    "build",
    [objects.brick, objects.target, objects.non_target, objects.concrete_cylinder, objects.ball, soup, fine_ball],
)
def test_no_vertical_plane_crosses_more_triangles_than_promised(build):
    mesh = build()
    most = brute_force_crossings(mesh, 3000, np.random.default_rng(0))
    assert 0 < most <= mesh.crossings <= mesh.n_faces
    assert mesh.crossings <= max(8, 3 * most)  # a bound worth having


@pytest.mark.skipif(not PIPE.exists(), reason="the real frames are not here")
def test_the_real_mesh():
    mesh = Mesh.load(PIPE)
    assert surface(mesh).area == pytest.approx(trimesh.load(PIPE).area, rel=1e-4)
    assert brute_force_crossings(mesh, 1000, np.random.default_rng(0)) <= mesh.crossings
