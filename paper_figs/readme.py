"""The tables of README.md, from the experiments' own runs: what stands between markers is replaced.

`<!-- reproduce_paper:begin -->` and `<!-- reproduce_paper:end -->`, each on a line of its own, hold the table of
`experiments.reproduce_paper`, and so for any other experiment.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

from experiments.common.launch import combined, mean_and_spread
from experiments.common.runs import RESULTS, ROOT, load_report
from paper_figs.index import command
from paper_figs.shared import Run, load
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
    """An experiment's table, over all seeds that were run, and where it comes from.

    Raises SonarjaxError without a full run.
    """
    run = load(runs, name)
    if run.smoke:
        raise SonarjaxError(f"{run.folder}: a run of preset smoke is nothing for README; run {command(name)}")
    reports = of_all_seeds(run)
    return f"{spaced(own_table(name, combined(reports, mean_and_spread)))}\n\n*{origin(reports)}*"


def of_all_seeds(run: Run) -> list[dict[str, Any]]:
    """The reports of a run and of the same settings and code with other seeds, by seed."""
    settings = run.folder.name.rpartition("-s")[0]
    folders = [path.parent for path in run.folder.parent.glob(f"{settings}-s*/{RESULTS}")]
    reports = [report for report in map(load_report, folders) if report["code"] == run.report["code"]]
    return sorted(reports, key=lambda report: report["seed"])


def own_table(name: str, report: dict[str, Any]) -> str:
    """What the experiment prints; its summary, where it has one."""
    module = importlib.import_module(f"experiments.{name}")
    return str(getattr(module, "summary", module.table)(report))


def origin(reports: list[dict[str, Any]]) -> str:
    """Command with all its options and seeds, date and code of the runs, which several commands may have made."""
    report, seeds = reports[0], [str(one["seed"]) for one in reports]
    alone = re.sub(r" --seeds( \d+)+", "", report["command"])
    command = alone if seeds == ["0"] else f"{alone} --seeds {' '.join(seeds)}"
    drawn = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {', '.join(seeds)}: mean ± largest deviation"
    code = f"commit {report['git']}" if report["git"] else f"code {report['code']}"
    return f"`{command}`, {drawn}; {report['date']}, {code}"


def spaced(text: str) -> str:
    """Text with an empty line around each table, which Markdown wants, and between its other lines."""
    kept = [""]
    for line in text.split("\n"):
        goes_on = line.startswith("|") and kept[-1].startswith("|")
        if kept[-1] and not goes_on:
            kept.append("")
        if line:
            kept.append(line)
    return "\n".join(kept).strip("\n")
