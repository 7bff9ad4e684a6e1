"""`sonarjax recognize` with several targets: which one is found, and targets that cannot be used."""

import json
import math

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.cli.targets import mesh_files
from sonarjax.io import SonarjaxError


@pytest.fixture
def meshes(place, tmp_path):
    """A folder with `brick.stl`, a `post.stl` three times as high and half as long, and a file that is no mesh."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    text = (place / "brick.stl").read_text()
    (folder / "brick.stl").write_text(text)
    (folder / "post.STL").write_text(text.replace("0.057", "0.171").replace("0.095", "0.0475"))
    (folder / "notes.txt").write_text("words")
    return folder


@pytest.mark.parametrize("refined", [pytest.param(True, marks=pytest.mark.slow), False])
def test_several_targets_are_told_apart(command, meshes, place, rendered, tmp_path, refined):
    out = tmp_path / "r.jsonl"
    how = ["--sonar", place / "sonar.toml", "--out", out, "--segmenter", "none", *["--no-refine"][refined:]]
    code, stdout, _ = command("recognize", rendered, "--target", meshes, *how)
    (record,) = [json.loads(line) for line in out.read_text().splitlines()]
    assert (code, stdout) == (0, ""), record
    assert (record["target"], record["runner_up"]) == ("brick", "post")
    assert 0 < record["margin"] <= 1
    assert (record["schema"], record["converged"]) == (2, True)
    assert record["x_m"] == pytest.approx(2.2, abs=0.05)


def test_targets_that_cannot_be_used(complaint, meshes, place, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "notes.txt").write_text("words")
    (tmp_path / "word.stl").write_text("words")
    rest = ["--sonar", place / "sonar.toml", "--out", tmp_path / "r.jsonl"]
    brick = place / "brick.stl"
    for given, said in {
        (brick, meshes): f"--target: {brick} and {meshes / 'brick.stl'} are both called 'brick'",
        (empty,): f"--target: {empty}: expected a folder of meshes, found no .stl, ",
        (brick, tmp_path / "word.stl"): "word.stl: not an STL file",
        (brick, "absent.obj"): "absent.obj: no such mesh",
        ("",): "--target: expected a mesh file or a folder of meshes, got ''",
        (brick, place / "brick_mm.stl"): "brick_mm.stl: the mesh is ",
    }.items():
        options = [argument for one in given for argument in ("--target", one)]
        assert said in complaint(2, "recognize", place / "a.npz", *options, *rest)
    several = ["--target", meshes, "--track"]
    assert "--track: expected a single --target, got 2" in complaint(2, "recognize", place / "a.npz", *several, *rest)
    assert not (tmp_path / "r.jsonl").exists()


def test_a_name_that_no_result_can_hold_is_refused_at_once(tmp_path):
    """On Linux a file name may be any bytes; those that are no UTF-8 are read as surrogates."""
    with pytest.raises(SonarjaxError, match=r"MESH: 'b\\udcffx.stl': expected a file name in UTF-8"):
        mesh_files(["b\udcffx.stl"], "MESH")
    assert mesh_files(["Köder.stl"], "MESH") == {"Köder": "Köder.stl"}


@pytest.mark.slow
def test_the_margin_is_the_lead_over_the_runner_up():
    azimuth = np.radians((np.arange(24) - 11.5) * 29 / 24).astype(np.float32)
    sonar = sj.Sonar.preset(
        "didson-hf", tilt=math.radians(20), azimuth=azimuth, n_ranges=96, range_min=2.0, range_max=3.0
    )
    meshes = {"pile": sj.objects.target(), "brick": sj.objects.brick()}
    image = np.asarray(sj.render(meshes["pile"], sj.Pose(2.3, 0.05, 0.8), sonar).semantic())
    how = {"segmenter": "none", "refine": None, "search": sj.SearchConfig(yaw_bins=12)}
    both = sj.Recognizer(meshes, sonar, **how)(image, threshold=0.5)
    alone = {name: sj.Recognizer(mesh, sonar, **how)(image, threshold=0.5).score_bank for name, mesh in meshes.items()}
    assert (both.target, both.runner_up) == ("pile", "brick")
    assert both.margin == pytest.approx(alone["pile"] - alone["brick"], abs=0.02)
