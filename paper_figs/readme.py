"""The tables of README.md, from the experiments' own runs: what stands between markers is replaced.

`<!-- reproduce_paper:begin -->` and `<!-- reproduce_paper:end -->`, each on a line of its own, hold the table of
`experiments.reproduce_paper`, and so for any other experiment.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

from experiments.common.runs import ROOT
from paper_figs.index import command
from paper_figs.shared import load
from sonarjax.io import SonarjaxError, write_text

PATH = ROOT / "README.md"
NEEDED = ("reproduce_paper", "evaluate_segmenters")
BEGIN = re.compile(r"^<!-- (\w+):begin -->$", re.MULTILINE)


def update(path: Path, runs: Path) -> None:
    """Fill every block of a Markdown file. Raises SonarjaxError, and leaves it as it was, where one cannot be."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SonarjaxError(f"{path}: cannot be read: {error.strerror}") from error
    for name in dict.fromkeys((*NEEDED, *BEGIN.findall(text))):
        text = filled(text, name, block(name, runs), path)
    write_text(path, text)


def filled(text: str, name: str, content: str, path: Path) -> str:
    """`text` with `content` between the markers of `name`. Raises SonarjaxError unless each stands there once."""
    begin, end = (f"<!-- {name}:{side} -->" for side in ("begin", "end"))
    lines = text.split("\n")
    if lines.count(begin) != 1 or lines.count(end) != 1 or lines.index(begin) > lines.index(end):
        raise SonarjaxError(f"{path}: expected one line {begin} and below it one line {end}")
    first, last = lines.index(begin), lines.index(end)
    return "\n".join([*lines[: first + 1], "", content, "", *lines[last:]])


def block(name: str, runs: Path) -> str:
    """An experiment's table and where it comes from. Raises SonarjaxError without a full run."""
    run = load(runs, name)
    if run.smoke:
        raise SonarjaxError(f"{run.folder}: a run of preset smoke is nothing for README; run {command(name)}")
    return f"{spaced(own_table(name, run.report))}\n\n*{origin(run.report)}*"


def own_table(name: str, report: dict[str, Any]) -> str:
    """What the experiment prints."""
    return str(importlib.import_module(f"experiments.{name}").table(report))


def origin(report: dict[str, Any]) -> str:
    """Command, seed, date and code of a run."""
    code = f"commit {report['git']}" if report["git"] else f"code {report['code']}"
    return f"`{report['command']}`, seed {report['seed']}, {report['date']}, {code}"


def spaced(text: str) -> str:
    """Text with an empty line around each table, which Markdown wants, and between its other lines."""
    kept: list[str] = []
    for line in filter(None, text.split("\n")):
        if kept and not (kept[-1].startswith("|") and line.startswith("|")):
            kept.append("")
        kept.append(line)
    return "\n".join(kept)
