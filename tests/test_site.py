"""The documentation site: its examples run, dead links are seen, a new user gets through its first steps."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

PROJECT = Path(__file__).resolve().parent.parent
DOCS = PROJECT / "docs"
WITH_EXAMPLES = sorted(
    path.relative_to(PROJECT).with_suffix("").as_posix().replace("/", ".")
    for path in (PROJECT / "sonarjax").rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_in_docstrings(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 0 and found.failed == 0


def test_there_are_examples() -> None:
    assert len(WITH_EXAMPLES) >= 7


def by_path(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SITE = {
    "index.html": '<a href="docs/a.html#there">a</a> <a href="https://example.org/none">out</a> <img src="b.png">',
    "docs/a.html": '<h1 id="there">A</h1> <a href="../index.html">up</a> <a href="#there">here</a> <a href="..">up</a>',
    "b.png": "",
}


@pytest.mark.parametrize(
    ("old", "new", "dead"),
    [
        ("", "", []),
        ('id="there"', 'id="gone"',
         ["index.html: docs/a.html#there: no such anchor", "docs/a.html: #there: no such anchor"]),
        ("docs/a.html#there", "docs/c.html", ["index.html: docs/c.html: no such file"]),
        ("b.png", "c.png", ["index.html: c.png: no such file"]),
    ],
)  # fmt: skip
def test_link_checker_sees(old: str, new: str, dead: list[str], tmp_path: Path) -> None:
    for name, text in SITE.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text.replace(old, new) if old else text)
    checker = by_path(DOCS / "check_links.py")
    assert sorted(checker.dead_links(tmp_path)) == sorted(dead)
    assert checker.main(tmp_path) == bool(dead)


def test_link_checker_wants_a_site(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert by_path(DOCS / "check_links.py").main(tmp_path) == 2
    assert "there is no index.html" in capsys.readouterr().err


def test_every_page_of_docs_is_in_the_site(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    pages = dict(by_path(DOCS / "conf.py").contents())["Guide"].split()
    found = {f"/docs/{path.stem}" for path in DOCS.glob("*.md")} - {"/docs/README"}
    assert set(pages) == found and len(pages) == len(found)


@pytest.mark.parametrize(
    ("plain", "marked"),
    [
        ("shape `*batch` and *batch", r"shape ``*batch`` and \*batch"),
        ("a | b and c|d, name_ here", r"a | b and c\|d, name\_ here"),
        ("Twice.\n\n>>> f(*a)\n1", "Twice.\n\n>>> f(*a)\n1"),
    ],
)
def test_docstrings_keep_their_stars(plain: str, marked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert by_path(DOCS / "conf.py").plain_markup(plain) == marked


@pytest.mark.slow
def test_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("myst_nb", reason="the extra `docs` is not installed")
    sphinx = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", "-b", "html"]
    done = subprocess.run(
        [*sphinx, "-d", tmp_path / "trees", "-c", DOCS, PROJECT, tmp_path / "html"], cwd=PROJECT, timeout=560,
        env={k: v for k, v in os.environ.items() if k != "SONARJAX_NOTEBOOKS"}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    assert list(by_path(DOCS / "check_links.py").dead_links(tmp_path / "html")) == []
    api = (tmp_path / "html" / "docs" / "api" / "sonarjax.html").read_text(encoding="utf-8")
    import sonarjax

    assert [name for name in sonarjax.__all__ if name != "objects" and f'id="sonarjax.{name}"' not in api] == []


# The first steps, as a new user takes them: every block of the page that is marked as run, in its order.

FIRST_STEPS = (DOCS / "first_steps.md").read_text(encoding="utf-8")
RUN = re.compile(r"\*runs\*:\n\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL | re.IGNORECASE)


def test_blocks_are_found() -> None:
    assert [kind for kind, _ in RUN.findall(FIRST_STEPS)] == [
        "toml",
        "python",
        "sh",
        "sh",
        "python",
        "sh",
        "python",
        "sh",
    ]
    assert len(re.findall(r"\*runs\*", FIRST_STEPS, re.IGNORECASE)) == 9  # the page's first lines speak of it


@pytest.mark.slow
def test_first_steps(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "sonarjax"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m sonarjax "$@"\n')
    command.chmod(0o755)
    environment = os.environ | {"PYTHONPATH": str(PROJECT), "PATH": f"{command.parent}:{os.environ['PATH']}"}
    for kind, text in RUN.findall(FIRST_STEPS):
        if kind == "toml":
            (tmp_path / "sonar.toml").write_text(text)
            continue
        how = [sys.executable, "-c"] if kind == "python" else ["/bin/sh", "-e", "-c"]
        done = subprocess.run(
            [*how, text], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=580, check=False
        )
        assert done.returncode == 0, f"{text}\n{done.stderr[-3000:]}"
    found = (tmp_path / "found.jsonl").read_text()
    assert '"identified": true' in found
    fitted = tomllib.loads((tmp_path / "fitted.toml").read_text())
    np.testing.assert_allclose([fitted["tilt_deg"], fitted["height_m"]], [20.0, 0.9], atol=0.02)
    assert '"segmenter": "RUN/weights.safetensors"' in (tmp_path / "own.jsonl").read_text()
