"""The command on two processes that talk as two machines would, beside the command on one: the same losses."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from sonarjax.io import SonarjaxError
from sonarjax.segment.training.devices import join_processes
from tests.segment.training_runs import PROJECT, QUICK, recorded


def begin(run: Path, *options: str, **environment: str) -> subprocess.Popen[str]:
    """`sonarjax train --preset smoke` on one device of this computer."""
    usual = {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": QUICK, "PYTHONPATH": str(PROJECT)}
    return subprocess.Popen(
        [sys.executable, "-m", "sonarjax", "train", "--preset", "smoke", "--run-dir", str(run), *options],
        cwd=PROJECT,
        env=os.environ | usual | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str], code: int = 0) -> str:
    """Wait for a process that must end with `code`; returns what it said on stderr."""
    _, said = process.communicate(timeout=560)
    assert process.returncode == code, said[-3000:]
    return said


def free_address() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


@pytest.mark.slow
def test_two_processes_train_the_smoke_recipe_as_one_does(tmp_path: Path) -> None:
    shared = {"SONARJAX_COORDINATOR": free_address(), "SONARJAX_PROCESSES": "2"}
    both = [begin(tmp_path / "two", SONARJAX_PROCESS=str(number), **shared) for number in range(2)]
    for process in both:
        finish(process)
    finish(begin(tmp_path / "one"))
    found, wanted = recorded(tmp_path / "two"), recorded(tmp_path / "one")
    assert [line["step"] for line in found] == [line["step"] for line in wanted] == [4, 8]
    losses = [name for name in wanted[0] if name.startswith("loss_")]
    assert len(losses) >= 3
    for line, truth in zip(found, wanted, strict=True):
        for name in losses:  # sums over a batch are made in another order: float32's rounding, grown over the steps
            np.testing.assert_allclose(line[name], truth[name], rtol=1e-3, err_msg=name)
    one, two = (load_file(tmp_path / name / "weights.safetensors") for name in ("one", "two"))
    assert one.keys() == two.keys()
    worst = max(float(np.abs(one[name].astype(np.float32) - two[name]).max()) for name in one)
    print(f"largest difference of a weight: {worst:.2g}")
    assert worst < 1e-2
    finish(begin(tmp_path / "two", "--resume"))  # the checkpoint of two serves one
    after = load_file(tmp_path / "two" / "weights.safetensors")
    assert all((after[name] == two[name]).all() for name in two)


NUMBERS = "expected numbers in SONARJAX_PROCESSES and SONARJAX_PROCESS"


def test_a_coordinator_without_numbers_is_one_line(tmp_path: Path) -> None:
    error = finish(begin(tmp_path / "run", SONARJAX_COORDINATOR="127.0.0.1:1"), 2)
    assert NUMBERS in error and error.count("\n") == 1 and not (tmp_path / "run").exists()


@pytest.mark.parametrize("numbers", [{}, {"PROCESSES": "two", "PROCESS": "0"}, {"PROCESSES": "2"}])
def test_numbers_of_processes_that_cannot_be_used(numbers: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ({"COORDINATOR": "127.0.0.1:1"} | numbers).items():
        monkeypatch.setenv(f"SONARJAX_{name}", value)
    with pytest.raises(SonarjaxError, match=NUMBERS):
        join_processes()


@pytest.mark.slow
def test_batch_that_cannot_be_shared(tmp_path: Path) -> None:
    """Three devices in all, four pairs a step."""
    shared = {"SONARJAX_COORDINATOR": free_address(), "SONARJAX_PROCESSES": "3"}
    three = [begin(tmp_path / "run", SONARJAX_PROCESS=str(number), **shared) for number in range(3)]
    for process in three:
        assert "batch: expected a multiple of the 3 devices, got 4" in finish(process, 2)
