"""A wheel in an environment of its own: the command recognizes with nothing of the repository beside it.

By default the new environment borrows the libraries of this one and gets sonarjax alone from the wheel, which takes
seconds. With SONARJAX_FULL_INSTALL=1 pip installs every dependency too, as constraints.txt pins them (minutes).
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from tests.cli.conftest import SONAR, brick_stl

pytestmark = pytest.mark.slow
PROJECT = Path(__file__).resolve().parent.parent
FULL = os.environ.get("SONARJAX_FULL_INSTALL") == "1"
YAW_DEG = 30.0


def run(*command: str | Path, cwd: Path, timeout: float = 300) -> str:
    """Run a command away from the repository; returns stdout, and shows stderr where it fails."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(c) for c in command], cwd=cwd, env=kept, capture_output=True, text=True, timeout=timeout, check=False
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(
        sys.executable, "-m", "pip", "wheel", PROJECT, "--no-deps", "--no-build-isolation", "--quiet",
        "--wheel-dir", folder, cwd=folder,
    )  # fmt: skip
    (path,) = folder.glob("sonarjax-*.whl")
    return path


@pytest.fixture(scope="module")
def binaries(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of a fresh environment in which the wheel is installed."""
    home = tmp_path_factory.mktemp("fresh") / "env"
    venv.create(home, with_pip=True)
    python = home / "bin" / "python"
    how = ["--constraint", PROJECT / "constraints.txt"] if FULL else ["--no-deps"]
    run(python, "-m", "pip", "install", "--quiet", *how, wheel, cwd=home, timeout=1200)
    if not FULL:
        own = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip()
        # A folder named by a .pth file comes after the environment's own, and .pth files in it are not followed:
        # an editable install over there stays unseen.
        Path(own, "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return home / "bin"


def test_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"sonarjax"}
    assert {"sonarjax/py.typed", "sonarjax/segment/weights/pix2pix.safetensors"} <= set(names)
    sources = {p.relative_to(PROJECT).as_posix() for p in (PROJECT / "sonarjax").rglob("*.py")}
    assert sources == {name for name in names if name.endswith(".py")}
    assert wheel.stat().st_size < 15e6


def test_package_comes_from_the_wheel(binaries: Path, tmp_path: Path) -> None:
    where = run(binaries / "python", "-c", "import sonarjax; print(sonarjax.__file__)", cwd=tmp_path).strip()
    assert Path(where).is_relative_to(binaries.parent)


def test_command_recognizes_what_it_rendered(binaries: Path, tmp_path: Path) -> None:
    command = binaries / "sonarjax"
    (tmp_path / "sonar.toml").write_text(SONAR)
    (tmp_path / "brick.stl").write_text(brick_stl((0.4, 0.12, 0.2)))
    place = ["--x", "2.2", "--y", "0.1", "--yaw-deg", str(YAW_DEG)]
    run(command, "render", "brick.stl", "--sonar", "sonar.toml", *place, "--out", "frame.npz", cwd=tmp_path)
    run(
        command, "recognize", "frame.npz", "--target", "brick.stl", "--sonar", "sonar.toml", "--out", "found.jsonl",
        cwd=tmp_path, timeout=580,
    )  # fmt: skip
    (found,) = [json.loads(line) for line in (tmp_path / "found.jsonl").read_text().splitlines()]
    assert found["segmenter"] == "pix2pix" and found["identified"]
    off = math.radians(found["yaw_deg"] - YAW_DEG)
    assert abs(math.degrees(math.remainder(off, math.pi))) < 5.0  # a box looks the same after half a turn
    assert math.hypot(found["x_m"] - 2.2, found["y_m"] - 0.1) < 0.05
