"""Meshes of very many triangles at the command line: what is said, what stays, and tolerances that cannot be."""

import numpy as np
import pytest
import trimesh

HOW = ["--x", "2.2", "--y", "0", "--yaw-deg", "0"]


@pytest.fixture(scope="module")
def fine(tmp_path_factory):
    """A ball of 5,120 triangles standing on the floor, as a file."""
    ball = trimesh.creation.icosphere(4, 0.12)
    ball.apply_translation([0, 0, 0.12])
    path = tmp_path_factory.mktemp("fine") / "ball.stl"
    ball.export(path)
    return path


@pytest.mark.slow
def test_one_line_says_what_was_reduced(command, fine, place, tmp_path):
    rest = ["--sonar", place / "sonar.toml", *HOW]
    code, out, err = command("render", fine, *rest, "--out", tmp_path / "a.npz")
    assert (code, out) == (0, "") and err.count("\n") == 1
    assert err.startswith(f"sonarjax: note: {fine}: 5120 triangles reduced to ")
    assert " m (asked for: " in err and "--mesh-tolerance 0 keeps all" in err
    code, _, err = command("render", fine, *rest, "--out", tmp_path / "b.npz", "--mesh-tolerance", "0")
    assert (code, err) == (0, "")
    reduced, full = (np.load(tmp_path / name)["labels"] for name in ("a.npz", "b.npz"))
    assert (reduced == full).mean() > 0.995


def test_small_meshes_are_not_mentioned(command, place, tmp_path):
    for options in ([], ["--mesh-tolerance", "0.01"]):
        rest = ["--sonar", place / "sonar.toml", *HOW, "--out", tmp_path / "c.npz", *options]
        assert command("render", place / "brick.stl", *rest) == (0, "", "")


def test_a_mesh_that_does_not_stand_is_noted_and_made_to(command, complaint, place, tmp_path):
    low = tmp_path / "low.stl"
    trimesh.load_mesh(place / "brick.stl").apply_translation([0.3, 0, -0.04]).export(low)
    rest = ["--sonar", place / "sonar.toml", *HOW]
    code, _, err = command("render", low, *rest, "--out", tmp_path / "e.npz")
    assert code == 0 and err.count("\n") == 1
    assert err.startswith(f"sonarjax: note: {low}: the floor is its z = 0, but its lowest point is 0.04 m below")
    assert command("render", low, *rest, "--stand", "--out", tmp_path / "f.npz") == (0, "", "")
    assert command("render", place / "brick.stl", *rest, "--stand", "--out", tmp_path / "g.npz") == (0, "", "")
    stood, usual = (np.load(tmp_path / name)["labels"] for name in ("f.npz", "g.npz"))
    np.testing.assert_array_equal(stood, usual)
    fit = ["calibrate", place / "a.npz", "--target", low, "--sonar", place / "sonar.toml", "--out", tmp_path / "f.toml"]
    assert f"error: {low}: expected a mesh above the floor, its z = 0, but its lowest" in complaint(2, *fit)
    frames = ["dataset", low, "--count", "1", "--sonar", place / "sonar.toml", "--out", tmp_path / "set"]
    assert "low: expected a mesh around its origin" in command(*frames)[2]


@pytest.mark.parametrize("given", ["-0.001", "nan", "inf", "far", "2"])
def test_a_tolerance_that_is_no_length(complaint, place, tmp_path, given):
    out = tmp_path / "d.npz"
    for name in ("render", "recognize", "calibrate", "dataset"):
        options = {
            "render": [place / "brick.stl", *HOW],
            "recognize": [place / "a.npz", "--target", place / "brick.stl"],
            "calibrate": [place / "a.npz", "--target", place / "brick.stl"],
            "dataset": [place / "brick.stl", "--count", "1"],
        }[name]
        said = complaint(2, name, *options, "--sonar", place / "sonar.toml", "--out", out, "--mesh-tolerance", given)
        assert f"argument --mesh-tolerance: expected a number from 0 to 1, got '{given}'" in said
    assert not out.exists()


@pytest.mark.parametrize("name", ["render", "recognize", "calibrate", "dataset"])
def test_help_names_the_option(command, name):
    assert "--mesh-tolerance M" in command(name, "--help")[1]
