"""`sonarjax dataset`: arguments, what it leaves, and a real process killed with SIGKILL."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.files import content


@pytest.fixture
def arguments(place, tmp_path):
    options = ["--sonar", place / "sonar.toml", "--count", 20, "--out", tmp_path / "set"]
    return ["dataset", *options, "--license", "none", place / "brick.stl"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--format", "tiff"], "invalid choice: 'tiff'"), (["--count", "0"], "expected a number from 1"),
        (["--count", "2.5"], "whole number"), (["--shard", "3/2"], "expected I/N"), (["--shard", "x"], "expected I/N"),
        (["--scenes", "0"], "from 1 to 32"), (["--severity", "-1"], "from 0 to 10"),
        (["--seed", "0.5"], "whole number"),
        (["--sensor", "best"], "invalid choice"), (["--cluster", "somewhere"], "expected local, local:N"),
        (["--cluster", "tcp://127.0.0.1:1"], "no scheduler answers"),
    ],
)  # fmt: skip
def test_bad_arguments_end_with_2_and_write_nothing(complaint, arguments, tmp_path, monkeypatch, options, said):
    monkeypatch.setattr("sonarjax.cluster.CONNECT_S", 0.5)
    if options[0] == "--cluster":
        pytest.importorskip("distributed")
    assert said in complaint(2, *arguments, *options)
    assert not (tmp_path / "set").exists()


def test_bad_files_end_with_2_and_write_nothing(complaint, place, arguments, tmp_path):
    assert "brick_mm.stl: the mesh is 190 m long" in complaint(2, *arguments, place / "brick_mm.stl")
    assert "absent.stl: no such mesh file" in complaint(2, *arguments, place / "absent.stl")
    assert "are both called 'brick'" in complaint(2, *arguments, place / "brick.stl")
    sky = tmp_path / "sky.toml"
    sky.write_text((place / "sonar.toml").read_text().replace("tilt_deg = 20.0", "tilt_deg = -20.0"))
    assert "sees no floor" in complaint(2, *arguments, "--sonar", sky)
    assert not (tmp_path / "set").exists()


def test_without_dask_one_line_names_the_extra(complaint, arguments, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "pip install 'sonarjax[cluster]'" in complaint(2, *arguments, "--cluster", "local")


def start(arguments: list, *options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "sonarjax", *map(str, arguments), *map(str, options)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> None:
    _, err = process.communicate(timeout=500)
    assert process.returncode == 0, err


@pytest.mark.slow
def test_killed_again_and_again_nothing_is_lost_or_double(place, arguments, tmp_path):
    options = ["--count", "200", "--scenes", "3", "--format", "coco"]
    finish(start(arguments, *options, "--out", tmp_path / "whole"))
    out = tmp_path / "cut"
    for parts in (1, 4, 8):
        process = start(arguments, *options, "--out", out)
        deadline = time.monotonic() + 300
        while len(list((out / "parts").glob("0*.jsonl"))) < parts and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert not (out / "annotations.json").exists()
    finish(start(arguments, *options, "--out", out))
    assert content(out) == content(tmp_path / "whole")
    numbers = [json.loads(line)["number"] for line in (out / "manifest.jsonl").read_text().splitlines()]
    assert numbers == list(range(200))
    images = {image["file_name"] for image in json.loads((out / "annotations.json").read_text())["images"]}
    assert images == {str(path.relative_to(out)) for path in Path(out, "images").iterdir()}
