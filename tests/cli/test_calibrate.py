"""`sonarjax calibrate`: what it refuses, what it writes and says."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate import Calibration, describe_calibration
from sonarjax.io import SonarjaxError
from sonarjax.sensor import SensorModel
from sonarjax.sonar import GeometryStd


def arguments(place, *frames, out, **options):
    named = [part for name, value in options.items() for part in (f"--{name}", value)]
    return [
        "calibrate",
        *frames,
        "--target",
        place / "brick.stl",
        "--sonar",
        place / "sonar.toml",
        "--out",
        out,
        *named,
    ]


@pytest.mark.parametrize(
    ("frame", "options", "said", "code"),
    [
        ("a.npz", {"free": "tilt,wind"}, "free: expected names from this list, each once: tilt, roll, height", 2),
        ("no.npz", {}, "no.npz: no such file", 1),
        ("a.npz", {"sonar": "no.toml"}, "no.toml: no such", 2),
    ],
)
def test_what_cannot_be_used_is_one_line(command, place, tmp_path, frame, options, said, code):
    out = tmp_path / "fitted.toml"
    found, _, err = command(*arguments(place, place / frame, out=out, **options))
    assert found == code and said in err and err.count("\n") == 1
    assert not out.exists()


def test_a_frame_of_another_shape_is_named(command, place, tmp_path):
    np.save(tmp_path / "wide.npy", np.full((64, 25), 0.5, np.float32))
    code, _, err = command(*arguments(place, tmp_path / "wide.npy", out=tmp_path / "fitted.toml"))
    assert code == 1 and err.count("\n") == 1 and not (tmp_path / "fitted.toml").exists()
    assert f"error: {tmp_path}/wide.npy: image: expected shape (64, 24) (range, beam) of {place}/sonar.toml" in err


def test_a_contradicting_header_is_noted(command, place, tmp_path, found, monkeypatch):
    axes = {"azimuth_deg": np.linspace(-10.0, 10.0, 24), "range_edges_m": np.linspace(1.5, 4.0, 65)}
    np.savez(tmp_path / "own.npz", image=np.full((64, 24), 0.5, np.float32), **axes)
    monkeypatch.setattr(sys.modules["sonarjax.calibrate"], "calibrate", lambda *_, **__: found)
    frames = [tmp_path / "own.npz"] * len(found.used)
    code, _, err = command(*arguments(place, *frames, out=tmp_path / "fitted.toml"))
    assert code == 0 and err.count(f"note: {tmp_path}/own.npz: its header contradicts") == 1


def test_a_frame_that_cannot_be_read_costs_itself_alone(command, place, tmp_path, found, monkeypatch):
    given = []
    monkeypatch.setattr(sys.modules["sonarjax.calibrate"], "calibrate", lambda f, *_, **__: given.extend(f) or found)
    (tmp_path / "bad.npy").write_bytes(b"no array")
    frames = place / "a.npz", tmp_path / "bad.npy", place / "b.npy"
    code, said, err = command(*arguments(place, *frames, out=tmp_path / "fitted.toml"))
    assert code == 1 and err.startswith(f"sonarjax: error: {tmp_path}/bad.npy: ") and err.count("\n") == 1
    assert len(given) == 2 and "b.npy: left out" in said and (tmp_path / "fitted.toml").exists()


def test_a_picture_of_another_format_is_refused(command, place, tmp_path):
    code, _, err = command(*arguments(place, place / "a.npz", out=tmp_path / "fitted.toml", png=tmp_path / "p.jpg"))
    assert code == 2 and "--png: " in err and "expected a name that ends in .png" in err


def test_an_output_may_not_be_an_input(command, place):
    found, _, err = command(*arguments(place, place / "a.npz", out=place / "sonar.toml"))
    assert found == 2 and "--out" in err


@pytest.fixture
def found() -> Calibration:
    """A calibration as if it had been made."""
    sonar = sj.Sonar.preset("didson-hf", geometry_std=GeometryStd(tilt=0.002, height=0.004))
    return Calibration(
        sonar=sonar, sensor=SensorModel(), poses=sj.Pose(np.array([2.0, 2.1]), 0.0, np.array([0.5, 1.0])),
        free=("tilt", "height"), change=np.array([math.radians(1.0), 0.0]),
        covariance=np.diag([math.radians(0.1) ** 2, 0.3**2]), determined={"tilt": True, "height": False},
        bound={"tilt": math.radians(0.08), "height": 0.29},
        singular_values=np.array([30.0, 0.2]), weakest={"tilt": 0.1, "height": -0.99}, used=np.array([True, False]),
        probability=np.array([0.9, 0.1]), residual=np.array([1.0, np.nan]), converged=True,
    )  # fmt: skip


def test_the_text_says_what_is_known_and_what_is_not(found):
    text = describe_calibration(found, sj.Sonar.preset("didson-hf"), ["a.png", "b.png"]).splitlines()
    assert text[0] == "tilt: 16°, changed by +1° ± 0.1°"
    assert text[1] == "height: not determined by these frames, left at its nominal value"
    assert text[2] == "least determined combination, in units of the priors: -0.99 height"
    assert text[3].startswith("a.png: residual 1.00, target with probability 0.90")
    assert text[4].startswith("b.png: left out")


def test_what_is_known_of_the_geometry_survives_the_file(found, tmp_path):
    path = tmp_path / "fitted.toml"
    found.sonar.to_toml(path)
    read = sj.Sonar.from_toml(path).geometry_std
    assert (read.tilt, read.height, read.roll) == pytest.approx((0.002, 0.004, 0.0))
    path.write_text(path.read_text().replace("tilt_deg = 0.1", "tilt_deg = -0.1"))
    with pytest.raises(sj.SonarjaxError, match=r"geometry_std\.tilt_deg must be 0 or more"):
        sj.Sonar.from_toml(path)
    path.write_text(path.read_text().replace("height_m = 0.004", "hight_m = 0.004"))
    with pytest.raises(sj.SonarjaxError, match=r"\[geometry_std\]: unknown key 'hight_m'"):
        sj.Sonar.from_toml(path)


@pytest.mark.parametrize("out", ["no/fitted.toml", "", "."])
def test_an_output_that_cannot_be_is_refused_before_the_fit(complaint, place, tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.modules["sonarjax.calibrate"], "calibrate", lambda *_, **__: pytest.fail("fitted"))
    assert "--out: " in complaint(2, *arguments(place, place / "a.npz", out=out))
    assert "--png: " in complaint(2, *arguments(place, place / "a.npz", out="fitted.toml", png="no/p.png"))


@pytest.mark.parametrize(("failure", "expected"), [(BrokenPipeError(), 141), (SonarjaxError("stdout: full"), 2)])
def test_a_result_is_written_even_if_it_cannot_be_said(command, place, tmp_path, found, monkeypatch, failure, expected):
    def fail(_):
        raise failure

    monkeypatch.setattr(sys.modules["sonarjax.calibrate"], "calibrate", lambda *_, **__: found)
    monkeypatch.setattr("sonarjax.cli.calibrate.say", fail)
    monkeypatch.setattr("sonarjax.cli.silence_stdout", lambda: None)
    out = tmp_path / "fitted.toml"
    assert command(*arguments(place, *[place / "a.npz"] * len(found.used), out=out))[0] == expected
    assert sj.Sonar.from_toml(out).geometry_std.tilt == pytest.approx(0.002)


def test_a_result_is_said_before_a_file_may_fail(command, place, tmp_path, found, monkeypatch):
    """It took minutes to find."""

    def full(*_):
        raise SonarjaxError("fitted.toml: cannot be written: the disk is full")

    monkeypatch.setattr(sys.modules["sonarjax.calibrate"], "calibrate", lambda *_, **__: found)
    monkeypatch.setattr(sj.Sonar, "to_toml", full)
    code, said, err = command(*arguments(place, *[place / "a.npz"] * len(found.used), out=tmp_path / "fitted.toml"))
    assert code == 2 and "the disk is full" in err
    assert "tilt" in said and "height" in said
