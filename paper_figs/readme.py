"""The tables of README.md and docs/, from the experiments' own results: what stands between markers is replaced.

`<!-- reproduce_paper:begin -->` and `<!-- reproduce_paper:end -->`, each on a line of its own, hold the table of
`experiments.reproduce_paper`, and so for any other experiment. A name may have settings behind it: `train_paper recipe
paper` is `train_paper --recipe paper`. The results themselves are kept in docs/results, so that a test can make every
table again and compare each digit. The block `baseline` is the table of `paper_figs.baseline`.
"""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import Any

from experiments.common.launch import combined, mean_and_spread
from experiments.common.runs import RESULTS, ROOT, Run, has_run, load, load_report
from paper_figs import baseline
from paper_figs.index import command
from sonarjax.io import SonarjaxError, write_text

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
KEPT = ROOT / "docs" / "results"
"""Folder of the results behind the tables, a file for each experiment: a list of reports, one for each seed."""
LEFT_OUT = ("per_frame", "sheets", "told")
"""Parts of reports that no table shows, and that are large."""
NAME = r"\w[\w ./-]*"
"""A block's name, as a regular expression: an experiment and its settings, which may name a file."""
BEGIN = re.compile(rf"^<!-- ({NAME}):begin -->$", re.MULTILINE)


def update(pages: tuple[Path, ...], runs: Path, kept: Path = KEPT) -> None:
    """Keep the newest results of the experiments that have run, and fill every block of some Markdown files.

    Raises SonarjaxError, and leaves a file as it was, where a block cannot be filled.
    """
    texts = {page: _read(page) for page in pages}
    for name in dict.fromkeys(name for text in texts.values() for name in BEGIN.findall(text)):
        if name != baseline.NAME and has_run(runs, _as_in_command(name)):
            keep(name, runs, kept)
    for page, text in texts.items():
        write_text(page, with_blocks(text, page, kept))


def keep(name: str, runs: Path, kept: Path) -> None:
    """Copy the results of an experiment, over all seeds that were run. Raises SonarjaxError for a smoke run."""
    run = load(runs, _as_in_command(name))
    if run.smoke:
        wanted = command(_as_in_command(name))
        raise SonarjaxError(f"{run.folder}: a run of preset smoke cannot go into README; run {wanted}")
    reports = [{key: value for key, value in report.items() if key not in LEFT_OUT} for report in of_all_seeds(run)]
    kept.mkdir(parents=True, exist_ok=True)
    write_text(kept / _file_of(name), json.dumps(_rounded(reports), indent=1) + "\n")


def with_blocks(text: str, page: Path, kept: Path = KEPT) -> str:
    """The text of a page with all its blocks made anew from the results that are kept."""
    for name in BEGIN.findall(text):
        text = filled(text, name, block(name, kept), page)
    return text


def block(name: str, kept: Path = KEPT) -> str:
    """An experiment's table, over all seeds that were run, and where it comes from.

    Raises SonarjaxError where its results are not kept.
    """
    if name == baseline.NAME:
        return baseline.table(kept)
    try:
        reports = json.loads((kept / _file_of(name)).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SonarjaxError(
            f"{kept / _file_of(name)}: expected the results of {command(_as_in_command(name))}: {error}"
        ) from error
    return f"{spaced(own_table(name, combined(reports, mean_and_spread)))}\n\n*{origin(reports)}*"


def _as_in_command(name: str) -> str:
    """`train_paper recipe paper`, as it stands between a page's markers, as `train_paper --recipe paper`."""
    experiment, *options = name.split()
    return " ".join([experiment, *(word if k % 2 else f"--{word}" for k, word in enumerate(options))])


def _file_of(name: str) -> str:
    return f"{re.sub('[ /]', '_', name)}.json"


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise SonarjaxError(f"{path}: cannot be read: {error.strerror}") from error


def _rounded(value: Any) -> Any:
    """Floats to six digits: more than any table shows, and fewer bytes."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def filled(text: str, name: str, content: str, path: Path) -> str:
    """`text` with `content` between the markers of `name`. Raises SonarjaxError unless each stands there once."""
    begin, end = (f"<!-- {name}:{side} -->" for side in ("begin", "end"))
    lines = text.split("\n")
    if lines.count(begin) != 1 or lines.count(end) != 1 or lines.index(begin) > lines.index(end):
        raise SonarjaxError(f"{path}: expected one line {begin}, and below it one line {end}")
    first, last = lines.index(begin), lines.index(end)
    return "\n".join([*lines[: first + 1], "", content, "", *lines[last:]])


def of_all_seeds(run: Run) -> list[dict[str, Any]]:
    """The reports of a run and of the same settings and code with other seeds, by seed."""
    settings = run.folder.name.rpartition("-s")[0]
    folders = [path.parent for path in run.folder.parent.glob(f"{settings}-s*/{RESULTS}")]
    reports = [report for report in map(load_report, folders) if report["code"] == run.report["code"]]
    return sorted(reports, key=lambda report: report["seed"])


def own_table(name: str, report: dict[str, Any]) -> str:
    """What the experiment prints; its summary, where it has one. `name` may have settings behind it."""
    module = importlib.import_module(f"experiments.{name.split()[0]}")
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
