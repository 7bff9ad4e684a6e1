"""Arguments: help without what only one command needs, one line for each mistake, and a stdout that may fail."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from sonarjax.segment import SEGMENTERS

ROOT = Path(__file__).parents[2]
COMMANDS = ("render", "segment", "recognize", "train", "info", "convert", "export")
RENDER = ["render", "m.stl", "--sonar", "s.toml", "--x", "2", "--y", "0", "--yaw-deg", "0", "--out", "f.npz"]


def process(*arguments, **options):
    """Run Python in a fresh process from the repository."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "SONARJAX_NO_CACHE": "1"}
    return subprocess.run(
        [sys.executable, *map(str, arguments)], env=environment, text=True, timeout=120, check=False, **options
    )


@pytest.mark.parametrize("command_name", ["", *COMMANDS])
def test_help_names_what_the_contract_lists(command, command_name):
    code, out, err = command(*[command_name][: bool(command_name)], "--help")
    assert (code, err) == (0, "")
    expected = {
        "": COMMANDS,
        "render": ("MESH", "--sonar", "--x", "--y", "--yaw-deg", "--out", "--png"),
        "segment": ("FRAME", "--out-dir", "--segmenter"),
        "recognize": ("FRAME", "--target", "--sonar", "--out", "--segmenter", "--no-refine", "--threshold"),
        "train": ("smoke,cpu,paper", "--run-dir", "--weights", "--resume"),
        "info": ("FILE",),
        "export": ("--onnx", "--segmenter"),
        "convert": (
            "FILE",
            "--out",
            "--sonar",
            "--opening-deg",
            "--range-min",
            "--range-max",
            "--bins",
            "--beams",
            "--width",
        ),
    }[command_name]
    assert all(word in out for word in expected)


@pytest.mark.parametrize("command_name", COMMANDS)
def test_help_fits_on_one_screen(command, command_name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert len(command(command_name, "--help")[1].splitlines()) <= 40


def test_help_names_every_segmenter(command):
    for name in ("recognize", "segment"):
        _, out, _ = command(name, "--help")
        assert ",".join(SEGMENTERS) + ";" in "".join(out.split())  # a name may be broken at its hyphen


def test_help_says_that_results_are_appended(command):
    assert "appended" in command("recognize", "--help")[1]


def test_help_and_mistakes_draw_and_plot_nothing():
    code = (
        "import sys; from sonarjax.cli import main; assert main(['recognize', '--help']) == 0; "
        "assert main(['render', 'x.stl', '--x', 'far']) == 2; print('matplotlib.figure' in sys.modules)"
    )
    result = process("-c", code, capture_output=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == "False"


def test_module_runs_as_a_command(place):
    result = process("-m", "sonarjax", "info", place / "sonar.toml", capture_output=True)
    assert (result.returncode, result.stderr) == (0, "")
    assert "tilt_deg" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "COMMAND"),
        (["fly"], "fly"),
        (["render"], "MESH"),
        (["info"], "FILE"),
        ([*RENDER, "--speed", "3"], "--speed"),
        ([*RENDER, "--x", "far"], "--x: expected a number"),
        ([*RENDER, "--x", "nan"], "--x: expected a number"),
        ([*RENDER, "--y", "1e30"], "--y: expected a number"),
        ([*RENDER, "--sub-beams", "0"], "--sub-beams: expected a number from 1"),
        ([*RENDER, "--sub-beams", "1.5"], "whole number"),
        (["recognize", "f.npz", "--target", "m.stl", "--out", "r.jsonl"], "--sonar"),
        (["recognize", "f", "--target", "m", "--sonar", "s", "--out", "r", "--threshold", "2"], "--threshold"),
        (["recognize", "--target", "m", "--sonar", "s", "--out", "r"], "FRAME"),
        (
            ["recognize", "f", "--target", "m", "--sonar", "s", "--out", "r", "--motion", "standing"],
            "used with --track",
        ),
        (["segment", "f.npz"], "--out-dir"),
        (["export", "--segmenter", "pix2pix"], "--onnx"),
        (["train", "--preset", "huge", "--run-dir", "r"], "huge"),
        (["recognize", "f", "--targ", "m", "--sonar", "s", "--out", "r"], "--target"),
    ],
)
def test_wrong_arguments_give_one_line_and_2(complaint, arguments, said):
    assert said in complaint(2, *arguments)


def test_negative_numbers_are_numbers(complaint, place):
    for number in ("-0.1", "-1e-3", "-.5", "-3"):
        rest = ["--sonar", place / "sonar.toml", *RENDER[4:], "--y", number]
        assert "m.stl: no such mesh" in complaint(2, "render", "m.stl", *rest)


def test_train_refuses_a_folder_that_cannot_be(complaint, place):
    assert "cannot be used for" in complaint(2, "train", "--preset", "smoke", "--run-dir", place / "a.npz" / "run")


def test_a_reader_that_left_is_no_error(place):
    code = (
        "import os, sys; from sonarjax.cli import main; read, write = os.pipe(); os.close(read); os.dup2(write, 1); "
        f"sys.exit(main(['info', {str(place / 'a.npz')!r}]))"
    )
    result = process("-c", code, stderr=subprocess.PIPE)
    assert (result.returncode, result.stderr) == (141, "")


@pytest.mark.parametrize("closed", [(2,), (0, 1, 2)])
def test_closed_streams_are_ignored(place, tmp_path, closed):
    """As a daemon closes them, before Python starts."""
    out = tmp_path / "labels"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "SONARJAX_NO_CACHE": "1"}
    for frame, code in (("a.npz", 0), ("none.npz", 1)):
        words = [sys.executable, "-m", "sonarjax", "segment", place / frame, "--segmenter", "otsu", "--out-dir", out]
        line = f"{shlex.join(map(str, words))} {' '.join(f'{number}>&-' for number in closed)}"
        assert subprocess.run(line, shell=True, env=environment, timeout=120, check=False).returncode == code
    assert [path.name for path in out.iterdir()] == ["labels_a.npz"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_stdout_is_one_line(place):
    with open("/dev/full", "w") as full:
        result = process("-m", "sonarjax", "info", place / "a.npz", stdout=full, stderr=subprocess.PIPE)
    assert result.returncode == 2
    assert result.stderr.startswith("sonarjax: error: stdout")
    assert result.stderr.count("\n") == 1


def test_lack_of_memory_or_device_is_one_line(complaint, place, monkeypatch):
    def fail():
        raise RuntimeError("Unable to initialize backend 'cuda':\n no device")

    monkeypatch.setattr("sonarjax.cli.render.start_jax", fail)
    assert "render: RuntimeError: Unable to initialize" in complaint(2, *RENDER)
