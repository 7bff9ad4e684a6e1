"""What a fresh clone is built from: versions that agree, pins without addresses, a cache that never gets in the way."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import sonarjax
from sonarjax.cpu import cores

PROJECT = Path(__file__).resolve().parent.parent
PYPROJECT = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONSTRAINTS = [
    line
    for line in (PROJECT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]
PIN = re.compile(r'([a-z0-9-]+)==[0-9][0-9a-z.]*( ; python_version (<|>=) "3\.12")?')


def pinned(line: str) -> str | None:
    """The package that a line of constraints.txt pins, None where it is anything but a version."""
    match = PIN.fullmatch(line)
    return match[1] if match else None


def test_version_is_the_same_everywhere() -> None:
    version = PYPROJECT["version"]
    assert f"\nversion: {version}\n" in (PROJECT / "CITATION.cff").read_text(encoding="utf-8")
    assert version == sonarjax.__version__
    heading = "Unreleased" if version.endswith(".dev0") else version
    assert f"\n## [{heading}]" in (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_unreleased_changes_are_not_called_by_the_last_release() -> None:
    released = re.findall(r"^## \[(\d\S*)\]", (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    if PYPROJECT["version"].endswith(".dev0"):
        assert PYPROJECT["version"].removesuffix(".dev0") not in released
    else:
        assert PYPROJECT["version"] == released[0]


def test_constraints_are_versions_only() -> None:
    assert [line for line in CONSTRAINTS if pinned(line) is None] == []


@pytest.mark.parametrize(
    "line", ["jax", "jax>=0.10", "jax @ https://example.org/jax.whl", "jax==0.10 --hash=sha256:00", "-e ."]
)
def test_constraint_check_sees(line: str) -> None:
    assert pinned(line) is None


def test_every_dependency_is_pinned() -> None:
    extras = PYPROJECT["optional-dependencies"]
    wanted = [
        *PYPROJECT["dependencies"],
        *extras["test"],
        *extras["notebooks"],
        *extras["bench"],
        *extras["onnx"],
        *extras["docs"],
    ]
    names = {re.split(r"[^A-Za-z0-9_-]", spec)[0] for spec in wanted}
    assert names - {pinned(line) for line in CONSTRAINTS} == set()


def test_extras() -> None:
    assert {"cuda", "test", "notebooks", "bench", "docs", "onnx"} <= set(PYPROJECT["optional-dependencies"])


@pytest.mark.parametrize("name", ["LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff", "sonarjax/py.typed"])
def test_file_is_there(name: str) -> None:
    assert (PROJECT / name).is_file()


def test_ci_runs_the_tests() -> None:
    script = PROJECT / ".ci" / "run"
    assert script.stat().st_mode & stat.S_IXUSR
    assert "\nmake test\n" in script.read_text(encoding="utf-8")


def test_workflows_run_what_the_makefile_has() -> None:
    yaml = pytest.importorskip("yaml")
    ci, release = (
        yaml.safe_load((PROJECT / ".github" / "workflows" / name).read_text(encoding="utf-8"))
        for name in ("ci.yml", "release.yml")
    )
    assert ci["jobs"]["test"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    versions = [c.rsplit(" ", 1)[-1] for c in PYPROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)]
    assert versions == ci["jobs"]["test"]["strategy"]["matrix"]["python"]
    runs = [step.get("run", "") for job in (*ci["jobs"].values(), *release["jobs"].values()) for step in job["steps"]]
    makefile = (PROJECT / "Makefile").read_text(encoding="utf-8")
    targets = [word for line in runs for word in re.findall(r"\bmake (\S+)", line)]
    assert {"test", "docs"} <= set(targets)
    assert [target for target in targets if not re.search(rf"^{target}:", makefile, re.MULTILINE)] == []
    files = [word for line in runs for word in re.findall(r"\btests/\S+", line)]
    assert files and all((PROJECT / file).is_file() for file in files)
    assert release["jobs"]["publish"]["permissions"] == {"id-token": "write"}


def test_pre_commit_has_the_pinned_versions() -> None:
    text = (PROJECT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    pins = dict(line.split("==") for line in CONSTRAINTS if " ; " not in line)
    for name in ("ruff", "codespell"):
        assert re.search(rf"repo: \S*{name}\S*\n    rev: v{re.escape(pins[name])}\n", text)


def test_map_of_the_house_names_every_folder() -> None:
    table = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    folders = {f"sonarjax/{p.parent.name}" for p in (PROJECT / "sonarjax").glob("*/__init__.py")}
    assert [
        name
        for name in folders | {"experiments", "paper_figs", "notebooks", "docs", "tests"}
        if f"| `{name}`" not in table
    ] == []


# The compilation cache, each time in a process of its own: JAX reads these settings once.

SHOW = """
import sys, jax
from sonarjax.cpu import enable_compilation_cache
print(enable_compilation_cache(), jax.config.jax_compilation_cache_dir, sep="|")
"""


def cache_of(tmp_path: Path, code: str = SHOW, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `code` with a home of its own and none of this process's cache settings."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("SONARJAX_", "JAX_", "XDG_"))}
    return subprocess.run(
        [sys.executable, "-W", "error", "-W", "ignore:JAXopt is no longer:DeprecationWarning", "-c", code],
        env={**kept, "HOME": str(tmp_path), **environment},
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )


def test_cache_is_in_the_users_cache_folder(tmp_path: Path) -> None:
    returned, configured = cache_of(tmp_path).stdout.strip().split("|")
    assert returned == configured
    assert Path(configured).parent == tmp_path / ".cache" / "sonarjax" / "xla"
    assert stat.S_IMODE(Path(configured).stat().st_mode) == 0o700


@pytest.mark.slow
def test_cache_follows_the_environment(tmp_path: Path) -> None:
    assert cache_of(tmp_path, SONARJAX_CACHE_DIR=f"{tmp_path}/a b").stdout.startswith(f"{tmp_path}/a b/jax-")
    assert cache_of(tmp_path, XDG_CACHE_HOME=f"{tmp_path}/xdg").stdout.startswith(f"{tmp_path}/xdg/sonarjax/xla/jax-")


def test_cache_can_be_off(tmp_path: Path) -> None:
    assert cache_of(tmp_path, SONARJAX_NO_CACHE="1").stdout.strip() == "None|None"
    assert not (tmp_path / ".cache").exists()


@pytest.mark.slow
def test_cache_of_the_user_is_left_alone(tmp_path: Path) -> None:
    own = str(tmp_path / "own")
    assert cache_of(tmp_path, JAX_COMPILATION_CACHE_DIR=own).stdout.strip() == f"{own}|{own}"


@pytest.mark.slow
def test_no_cache_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")  # also stops root, whom a mode does not
    assert cache_of(tmp_path, SONARJAX_CACHE_DIR=f"{tmp_path}/file/cache").stdout.strip() == "None|None"
    assert cache_of(tmp_path, HOME="/dev/null").stdout.strip() == "None|None"


COMPILE = """
import jax, jax.numpy as jnp
from jax import monitoring
from sonarjax.cpu import enable_compilation_cache
enable_compilation_cache()
events = []
monitoring.register_event_listener(lambda event, **_: events.append(event.rsplit("/", 1)[-1]))
jax.jit(lambda x: jnp.sort(x @ x.T, axis=0))(jnp.ones((8, 8))).block_until_ready()
print(events.count("cache_hits") > 0)
"""


@pytest.mark.slow
def test_second_run_reads_the_cache_and_says_nothing(tmp_path: Path) -> None:
    # JAX's own threshold in the environment wins over ours, which lets a small function into the cache.
    first, second = (cache_of(tmp_path, COMPILE, JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0") for _ in range(2))
    assert [first.stdout.strip(), second.stdout.strip()] == ["False", "True"]
    assert first.stderr == second.stderr == ""


ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
"""


@pytest.mark.slow
@pytest.mark.skipif(cores() < 2 or not hasattr(os, "sched_setaffinity"), reason="needs two cores, and a choice of them")
def test_code_that_was_compiled_on_another_number_of_cores_is_not_read(tmp_path: Path) -> None:
    every, one = COMPILE, ONE_CORE + COMPILE
    codes = (every, one, every, one)
    said = [cache_of(tmp_path, code, JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0").stdout.strip() for code in codes]
    assert said == ["False", "False", "True", "True"]
