"""`sonarjax render`: FRAME.npz to the letter, the picture, and every file that cannot be used."""

import os

import numpy as np
import pytest
from PIL import Image

from sonarjax.io import read_frames

SHAPE = (64, 24)
POSE = ["--x", 2.2, "--y", 0.15, "--yaw-deg", 30]
READ_ONLY = "/proc/sonarjax.npz"  # not even root can create it


def test_frame_npz_holds_what_the_contract_lists(rendered):
    with np.load(rendered, allow_pickle=False) as frame:
        assert set(frame) == {
            "image", "intensity", "highlight", "shadow", "labels", "azimuth_deg", "range_edges_m"
        }  # fmt: skip
        for key in ("image", "intensity", "highlight", "shadow"):
            assert (frame[key].shape, frame[key].dtype) == (SHAPE, np.float32)
        assert (frame["labels"].shape, frame["labels"].dtype) == (SHAPE, np.uint8)
        assert set(np.unique(frame["labels"])) == {0, 1, 2}
        h, s = frame["highlight"], frame["shadow"]
        np.testing.assert_allclose(frame["image"], 0.5 * (1 + h - s * (1 - h)), atol=1e-6)
        np.testing.assert_allclose(frame["azimuth_deg"], (np.arange(24) - 11.5) * 29 / 24, atol=1e-5)
        np.testing.assert_allclose(frame["range_edges_m"], np.linspace(1.5, 4.0, 65), atol=1e-12)
        # 0.15 m to port at 2.2 m: 3.9°, in the image a little more to the axis; echoes from 2.2 m to 2.5 m.
        rows, columns = np.nonzero(frame["labels"] == 1)
        assert 2 < frame["azimuth_deg"][columns].mean() < 5
        assert 2.15 < frame["range_edges_m"][rows].mean() < 2.5


def test_frame_npz_is_read_back_as_a_frame(rendered):
    (frame,) = read_frames(rendered)
    assert frame.shape == SHAPE
    assert frame.geometry["range_max_m"] == 4.0


def test_picture_is_a_png(rendered):
    with Image.open(rendered.with_suffix(".png")) as picture:
        assert picture.format == "PNG"
        assert min(picture.size) > 1000


def test_object_outside_the_view_is_noted_and_no_error(command, place, rendered, tmp_path):
    out = tmp_path / "far.npz"
    arguments = ["--sonar", place / "sonar.toml", "--x", -50, "--y", 0, "--yaw-deg", 0, "--out", out]
    code, _, err = command("render", place / "brick.stl", *arguments)
    assert code == 0
    assert err.startswith("sonarjax: note: ")
    assert "behind the sonar" in err
    with np.load(out) as frame:
        assert (frame["image"] == 0.5).all()


@pytest.mark.parametrize(
    ("place_of_it", "reasons"),
    [
        (("--x", 0.3, "--y", 0), ["nearer than the range window (", "it begins at 1.5 m", "below the aperture"]),
        (("--x", 1.2, "--y", 0), ["it is below the aperture"]),
        (("--x", 6, "--y", 0), ["farther than the range window (", "it ends at 4 m", "above the aperture"]),
        (("--x", 2.2, "--y", 3), ["it is beside the field of view, to port"]),
        (("--x", 2.2, "--y", -3), ["it is beside the field of view, to starboard"]),
        (("--x", 2.2, "--y", 0.15, "--unit-m", 0.003), ["it is too small"]),
    ],
)
def test_note_tells_why_nothing_is_seen(command, place, tmp_path, place_of_it, reasons):
    arguments = ["--sonar", place / "sonar.toml", *place_of_it, "--yaw-deg", 0, "--out", tmp_path / "f.npz"]
    code, _, err = command("render", place / "brick.stl", *arguments)
    assert code == 0 and all(reason in err for reason in reasons), err
    assert err.count(" and ") == len(reasons) // 3


@pytest.mark.parametrize(("option", "name"), [("--out", "f.png"), ("--out", "f"), ("--png", "f.jpg")])
def test_output_of_another_format_is_refused(complaint, place, tmp_path, option, name):
    files = {"--out": tmp_path / "f.npz", option: tmp_path / name}
    arguments = [part for pair in files.items() for part in pair]
    said = complaint(2, "render", place / "brick.stl", "--sonar", place / "sonar.toml", *POSE, *arguments)
    wanted = ".npz" if option == "--out" else ".png or .pdf or .svg"
    assert f"{option}: '{tmp_path / name}': expected a name that ends in {wanted}\n" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("mesh", "options", "said"),
    [
        ("absent.stl", [], "absent.stl: no such mesh"),
        (".", [], "folder"),
        ("a.npz", [], "a.npz"),
        ("brick_mm.stl", [], "millimetres"),
        ("brick.stl", ["--unit-m", "0"], "unit_m"),
        ("brick.stl", ["--unit-m", "1e4"], "millimetres"),
    ],
)
def test_a_mesh_that_cannot_be_used(complaint, place, tmp_path, mesh, options, said):
    out = tmp_path / "f.npz"
    arguments = ["--sonar", place / "sonar.toml", *POSE, "--out", out, *options]
    assert said in complaint(2, "render", place / mesh, *arguments)
    assert not out.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "no such file"),
        ("tilt_deg = = 3", "expected a TOML file"),
        ('preset = "didson-hf"\ntilt = 3', "unknown key 'tilt'"),
        ('preset = "sidson"', "sidson"),
        ("tilt_deg = 3", "missing"),
        ('preset = "didson-hf"\nrange_min_m = 5.0', "range_min_m must be less than range_max_m"),
        ('preset = "didson-hf"\nheight_m = "high"', "height_m must be a number"),
        ("\udcff", "TOML"),
    ],
)
def test_a_sonar_that_cannot_be_used(complaint, place, tmp_path, text, said):
    sonar = tmp_path / "sonar.toml"
    if text is not None:
        sonar.write_bytes(text.encode("utf-8", "surrogateescape"))
    message = complaint(2, "render", place / "brick.stl", "--sonar", sonar, *POSE, "--out", tmp_path / "f.npz")
    assert said in message
    assert str(sonar) in message


@pytest.mark.parametrize("option", ["--out", "--png"])
@pytest.mark.parametrize("target", ["absent/f.npz", ".", READ_ONLY, "/dev/full"])
def test_output_that_cannot_be_used(complaint, place, rendered, tmp_path, option, target):
    if target.startswith("/") and not os.path.exists(os.path.dirname(target)):
        pytest.skip(f"needs {target}")
    if target == "/dev/full" and not os.path.exists(target):
        pytest.skip("needs /dev/full")
    files = {"--out": tmp_path / "f.npz", "--png": tmp_path / "f.png", option: tmp_path / target}
    arguments = [part for pair in files.items() for part in pair]
    message = complaint(2, "render", place / "brick.stl", "--sonar", place / "sonar.toml", *POSE, *arguments)
    assert str(tmp_path / target) in message
    assert not list(tmp_path.glob(".sonarjax*"))


def test_an_old_frame_survives_a_failed_render(complaint, place, tmp_path):
    out = tmp_path / "f.npz"
    out.write_bytes(b"old")
    complaint(2, "render", place / "absent.stl", "--sonar", place / "sonar.toml", *POSE, "--out", out)
    assert out.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("out", "png"), [("brick.stl", None), ("sonar.toml", None), ("n.npz", "n.npz"), ("n", "brick.stl")]
)
def test_outputs_that_name_an_input_or_each_other(complaint, place, out, png):
    before = {name: (place / name).read_bytes() for name in ("brick.stl", "sonar.toml")}
    picture = [] if png is None else ["--png", place / png]
    arguments = ["--sonar", place / "sonar.toml", *POSE, "--out", place / out, *picture]
    assert "expected another file" in complaint(2, "render", place / "brick.stl", *arguments)
    assert before == {name: (place / name).read_bytes() for name in before}
    assert not (place / "n.npz").exists() and not (place / "n").exists()
