"""README and docs: their tables are made of the results that are kept, and no measured number is typed by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from paper_figs import readme
from sonarjax.data import import_pairs
from sonarjax.data.folder import STORED
from sonarjax.segment import SEGMENTERS, load_segmenter

PROJECT = Path(__file__).resolve().parents[1]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]
README = PAGES[0].read_text(encoding="utf-8")

MARKED = re.compile(rf"^<!-- ({readme.NAME}):(?:begin|end) -->$", re.MULTILINE)
TABLE = re.compile(r"^\|.+\|\n\|[-:| ]+\|\n\|.+\|$", re.MULTILINE)  # head, rule and a row


def lacks(text: str, name: str) -> list[str]:
    """What the block `name` of a Markdown text lacks."""
    block = re.search(rf"^<!-- {name}:begin -->\n(.*?)^<!-- {name}:end -->$", text, re.MULTILINE | re.DOTALL)
    held = block[1] if block else ""
    origin = re.search(rf"^\*`python -m experiments\.{name}\b[^`\n]*`.+\*$", held, re.MULTILINE)
    wanted = {"both markers": block, "a table": TABLE.search(held), "its command, in italics": origin}
    return [what for what, found in wanted.items() if not found]


@pytest.mark.parametrize("name", sorted(set(MARKED.findall(README))))
def test_block_of_readme_is_filled(name: str) -> None:
    assert lacks(README, name) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_made_of_the_results_that_are_kept(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert readme.with_blocks(text, page) == text


BLOCKS = re.compile(rf"^<!-- ({readme.NAME}):begin -->\n.*?^<!-- \1:end -->$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
MEASURED = re.compile(r"(?<![\d.-])\d+\.\d+(?!\.?\d)|\b\d+ ?(?:%|ms\b|s a frame|times as)")
# Of the method, not of a run: version numbers, settings, and what the real data's own README says of its truth.
SETTINGS = {"README.md": {"3.11", "0.25", "68 %"}, "results.md": {"0.2", "95 %", "90 %"}, "speed.md": {"0.10"}}
SETTINGS["calibrate.md"] = {"0.1", "0.3", "1 %", "2 %"}  # the height's search, and how far devices are off
SETTINGS["install.md"] = {"3.11"}
SETTINGS["export.md"] = {"0.5", "0.17"}  # the grey of background, a version
SETTINGS["glossary.md"] = SETTINGS["renderer.md"] = {"0.5"}
SETTINGS["training.md"] = {"3.1"}  # the paper's section
SETTINGS["track.md"] = SETTINGS["recognize.md"] = SETTINGS["outside_runs.md"] = {"68 %"}  # what an error bar is to hold
SETTINGS["outside.md"] = {"0.75", "1.5", "68 %", "95 %"}  # least grey of highlight, a severity, a normal's shares


def typed_numbers(text: str) -> set[str]:
    """Numbers of a Markdown text that look measured and stand outside of the tables that are made, and of code."""
    return set(MEASURED.findall(CODE.sub("", BLOCKS.sub("", text))))


# Defaults and devices, in tables that tests/sonar/test_page.py holds to the code.
SONAR_TABLES = re.findall(r"^\|.+\|$", (PROJECT / "docs" / "sonar.md").read_text(encoding="utf-8"), re.MULTILINE)
SETTINGS["sonar.md"] = typed_numbers("\n".join(SONAR_TABLES))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_measured_number_is_typed_by_hand(page: Path) -> None:
    assert typed_numbers(page.read_text(encoding="utf-8")) - SETTINGS.get(page.name, set()) == set()


def test_typed_numbers_are_seen() -> None:
    text = "It takes 0.5 s and 43 ms, is right in 98 % and 3 times as fast; `0.7`, version 0.1.0\n"
    text += "\n<!-- a:begin -->\n0.9\n<!-- a:end -->\n"
    assert typed_numbers(text) == {"0.5", "43 ms", "98 %", "3 times as"}


BLOCK = "<!-- a:begin -->\n\n| x |\n| --- |\n| 1 |\n\n*`python -m experiments.a --n 1`, seed 0*\n\n<!-- a:end -->\n"


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("", "", 0), ("| 1 |\n", "", 1), ("*`", "`", 1), ("experiments.a", "experiments.ab", 1), ("a:end", "b:end", 3),
        (BLOCK, "<!-- a:begin -->\n<!-- a:end -->\n", 2),
    ],
)  # fmt: skip
def test_block_check_sees(old: str, new: str, wanted: int) -> None:
    assert len(lacks(BLOCK.replace(old, new, 1), "a")) == wanted


@pytest.mark.parametrize("file", ["README.md", "experiments/README.md"])
def test_experiments_that_are_named_are_there(file: str) -> None:
    named = re.findall(r"python -m\s+experiments\.(\w+)", (PROJECT / file).read_text(encoding="utf-8"))
    assert named
    assert [name for name in named if not (PROJECT / "experiments" / f"{name}.py").is_file()] == []


def test_docstrings_say_what_the_pages_rely_on() -> None:
    named = set(re.findall(r"^    - `([\w-]+)`:", load_segmenter.__doc__ or "", re.MULTILINE))
    assert named == set(SEGMENTERS)
    pairs_text = " ".join((import_pairs.__doc__ or "").split())
    first_steps = (PROJECT / "docs" / "first_steps.md").read_text(encoding="utf-8")
    background, highlight, shadow = STORED
    assert f"{shadow} shadow, {background} background, {highlight} highlight" in pairs_text
    assert f"{shadow} for shadow, {background} for background and {highlight} for highlight" in first_steps
    assert all('{"image": "a.png", "labels": "a_labels.png"}' in text for text in (pairs_text, first_steps))
