"""Which item is drawn by which script from which experiment, and what the paper says and we get."""

from __future__ import annotations

import importlib
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from matplotlib import rc_context
from matplotlib.figure import Figure

import sonarjax as sj
from experiments.common.metrics import markdown
from experiments.common.runs import Run, has_run, load
from paper_figs import ablations, style
from paper_figs.shared import Line, Number, Take

FOLDER = Path(__file__).resolve().parent
SCRIPT = re.compile(r"(fig|tab|sec|ext)\d\d\w*")
KINDS = ("fig", "tab", "sec", "ext")
HEAD = ("item", "script", "experiment", "what", "paper", "ours")
MADE = ("command", "seed", "date", "code")
NOT_RUN, DRAWN = "not run", "drawn"
ABOUT = """# Figures

The paper's figures, tables and numbers, and our own, drawn from what experiments left in `runs/`: nothing is
simulated or trained here. This table is written by `python -m paper_figs --index`, which leaves what has no run in
`runs/` as it was. Its numbers and pictures are those of the runs named at its end. Those from before 2026-11-26 used an
earlier network, and tables in docs/ may come from newer runs.

```
python -m experiments.reproduce_paper    # the experiment that an item needs: see the table
python -m paper_figs fig08 tab03         # these items, PDF and PNG, to paper_figs/drawn
python -m paper_figs --all               # all items whose experiments have run
python -m paper_figs --report FILE.html  # one page with everything
python -m paper_figs --index             # this table
```

"""


class Script(Protocol):
    """What each figure script has; and NUMBERS, where there are some that no row of its reports calls by its ITEM."""

    ITEM: str
    CAPTION: str
    EXPERIMENTS: tuple[str, ...]

    def draw(self, *runs: Run) -> Figure:
        """The figure, from a run of each of them."""


@cache
def scripts() -> dict[str, Script]:
    """All scripts by name: the paper's figures, tables and sections, then our own. `ablations` has several."""
    names = [path.stem for path in FOLDER.glob("*.py") if SCRIPT.fullmatch(path.stem)]
    found = {name: importlib.import_module(f"paper_figs.{name}") for name in names} | ablations.SCRIPTS
    return dict(sorted(found.items(), key=lambda one: (KINDS.index(one[0][:3]), one[0])))  # type: ignore[arg-type]


def find(name: str) -> str:
    """The script whose name is or begins with `name`, such as ext01. Raises SonarjaxError when there is none."""
    found = [script for script in scripts() if script == name] or [one for one in scripts() if one.startswith(name)]
    if len(found) != 1:
        raise sj.SonarjaxError(f"{name}: expected one of {', '.join(one.split('_')[0] for one in scripts())}")
    return found[0]


def missing(script: Script, runs: Path) -> list[str]:
    """Experiments that a script needs and that have no finished run."""
    return [name for name in script.EXPERIMENTS if not has_run(runs, name)]


def is_smoke(script: Script, runs: Path) -> bool:
    """Whether any run that a script draws from was a short one."""
    return any(load(runs, name).smoke for name in script.EXPERIMENTS if has_run(runs, name))


def numbers(script: Script, runs: Path) -> list[Number]:
    """The rows of its item in the newest runs' reports, and its NUMBERS, of which ours is None where there is none."""
    reports = {name: load(runs, name).report for name in script.EXPERIMENTS if has_run(runs, name)}
    rows = [row for report in reports.values() for row in report.get("rows", ()) if row.get("item") == script.ITEM]
    lines: Sequence[Line] = getattr(script, "NUMBERS", ())
    return [Number(row["what"], row["paper"], row["ours"]) for row in rows] + [
        Number(what, paper, _taken(take, reports.get((*of, script.EXPERIMENTS[0])[0])))
        for what, paper, take, *of in lines
    ]


def _taken(take: Take, report: dict[str, Any] | None) -> float | None:
    try:
        value = None if report is None else take(report)
    except (KeyError, IndexError, StopIteration):  # the run left this part out
        return None
    return None if value is None else float(value)


def command(experiment: str) -> str:
    """What makes a run."""
    return f"python -m experiments.{experiment}"


def drawn(name: str, runs: Path) -> Figure:
    """The figure of an item, marked where it shows a short run. Raises SonarjaxError when it cannot be drawn."""
    script = scripts()[name]
    try:
        figure = script.draw(*(load(runs, one) for one in script.EXPERIMENTS))
    except (KeyError, IndexError, StopIteration) as error:
        made = " and ".join(command(one) for one in script.EXPERIMENTS)
        raise sj.SonarjaxError(f"{name}: the run lacks {error!r}, which this figure shows; run {made} again") from error
    if is_smoke(script, runs):
        style.mark_smoke(figure)
    return figure


def write_figure(name: str, runs: Path, out: Path) -> list[Path]:
    """Draw an item as PNG and PDF into a folder. Raises SonarjaxError when it cannot be drawn."""
    paths = [out / f"{name}.{kind}" for kind in ("png", "pdf")]
    with rc_context(style.RC):
        figure = drawn(name, runs)
        for path in paths:
            style.save(figure, path)
    return paths


def rows(runs: Path) -> list[list[str]]:
    """The table's cells: a row for each number, or one for an item that has none."""
    table = []
    for script in scripts().values():
        short = f" ({style.SMOKE})" if is_smoke(script, runs) else ""
        where = [f"`{_file_of(script)}.py`", "<br>".join(f"`{command(one)}`" for one in script.EXPERIMENTS)]
        lines: Sequence[Number | None] = numbers(script, runs) or [None]
        for line in lines:
            state = NOT_RUN if missing(script, runs) else DRAWN + short
            if line is None:
                table.append([script.ITEM, *where, "picture", "–", state])
            else:
                ours = NOT_RUN if line.ours is None else shown(line.ours) + short
                table.append([script.ITEM, *where, line.what, shown(line.paper), ours])
    return table


def shown(value: float | None) -> str:
    """A number as it is read best: shares with four decimals, a dash for none."""
    if value is None:
        return "–"
    if value == int(value) and abs(value) != 1:
        return f"{value:.0f}"
    return f"{value:.4f}" if abs(value) <= 1 else f"{value:.2f}"


def experiments() -> list[str]:
    """All experiments that an item is drawn from."""
    return list(dict.fromkeys(name for script in scripts().values() for name in script.EXPERIMENTS))


def text(runs: Path, before: str = "") -> str:
    """paper_figs/README.md; of items and experiments without a run, what it said `before`."""
    cells = [line.strip("| ").split(" | ") for line in before.splitlines() if line.startswith("| ")]
    table, own = [], rows(runs)
    for script in scripts().values():
        item = [row for row in own if row[:2] == [script.ITEM, f"`{_file_of(script)}.py`"]]
        kept = [row for row in cells if len(row) == len(HEAD) and row[:2] == item[0][:2]]
        table += kept if kept and missing(script, runs) else item
    made: list[list[Any]] = []
    for name in experiments():
        if has_run(runs, name):
            run = load(runs, name).report
            made.append([f"`{run['command']}`", run["seed"], run["date"], run["git"] or run["code"]])
        else:
            made += [row for row in cells if len(row) == len(MADE) and re.match(rf"`{command(name)}[ `]", row[0])]
    return f"{ABOUT}{markdown(HEAD, table)}\n\nDrawn from:\n\n{markdown(MADE, made)}\n"


def _file_of(script: Script) -> str:
    return script.draw.__module__.removeprefix("paper_figs.")
