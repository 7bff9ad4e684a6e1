"""One page of HTML with everything that has run: tables, figures, settings, versions; it loads nothing from outside.

Every experiment with a finished run is on it. What other code left in `runs`, or an experiment that is no longer
there, costs its own part of the page alone.
"""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Callable
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib import rc_context

import sonarjax as sj
from experiments.common.paper import ANGLES_DEG
from experiments.common.runs import RESULTS, Run, git_hash, has_run, load
from experiments.reproduce_paper import BESIDE, HEADS
from paper_figs import index, style, tab03, tab04
from paper_figs.matrix import blocks
from paper_figs.readme import origin, own_table

TEMPLATE = Path(__file__).with_name("report.html")
MAIN = "reproduce_paper"
SMOKE = f' <span class="smoke">{style.SMOKE}</span>'
NUMBER = re.compile(r"–?|[+−-]?[\d.,]+(e[+-]?\d+)?[°%]?")
DPI = 160
FACTS = {"preset": "preset", "seed": "seed", "date": "date", "git": "commit", "code": "code", "device": "device",
         "seconds": "time [s]", "command": "command"}  # fmt: skip
"""What the table of runs tells of each, and how it is headed there; a run of other code may lack some of it."""


class Page(NamedTuple):
    """What is told of all runs."""

    html: str
    """The page."""
    main: str | None
    """The main experiment's own table in Markdown, for the terminal; None where it has not run."""


def page(runs: Path) -> Page:
    """The page. Raises SonarjaxError when no experiment has run."""
    found = finished(runs)
    if not found:
        raise sj.SonarjaxError(f"{runs}: no finished run; `{index.command(MAIN)}` makes one")
    own = {name: or_why(partial(own_table, name, run.report)) for name, run in found.items()}
    mark = f"\n\n{style.SMOKE}" if MAIN in found and found[MAIN].smoke else ""
    return Page(html(runs, found, own), own[MAIN] + mark if MAIN in own else None)


def finished(runs: Path) -> dict[str, Run]:
    """The newest run of each experiment that has one: those of figures in the figures' order, the others by name."""
    drawn = [name for name in index.experiments() if has_run(runs, name)]
    there = {path.parent.parent.name for path in runs.glob(f"*/*/{RESULTS}")}
    others = sorted(there - {name.split()[0] for name in drawn})
    return {name: load(runs, name) for name in (*drawn, *others) if has_run(runs, name)}


def or_why(make: Callable[[], str], put: Callable[[str], str] = str) -> str:
    """What `make` gives; or why it cannot, as `put` puts it, when other code made the run or the experiment is gone."""
    try:
        return make()
    except sj.SonarjaxError as error:
        return put(str(error))
    except Exception as error:  # a run of other code may hold anything
        return put(f"Made by other code, this one cannot show it: {error!r}")


def paragraph(text: str) -> str:
    """A line of text as HTML."""
    return f"<p>{escape(text)}</p>"


def html(runs: Path, found: dict[str, Run], own: dict[str, str]) -> str:
    """The page of the runs `found` and their `own` tables, with the figures of `runs`."""
    main = or_why(partial(numbers, found[MAIN]), paragraph) if MAIN in found else lacking([MAIN])
    sections = [
        ("numbers", "The paper's numbers and ours", main),
        ("figures", "The paper's figures and tables", figures(runs, ("fig", "tab", "sec"))),
        ("own", "Beyond the paper", figures(runs, ("ext",))),
        ("tables", "What the experiments print", printed(found, own)),
        ("runs", "Runs", settings(found)),
        ("missing", "Not run", absent(runs)),
    ]
    links = " ".join(f'<a href="#{key}">{escape(title)}</a>' for key, title, _ in sections)
    body = "\n".join(f'<section id="{key}"><h2>{escape(title)}</h2>\n{text}</section>' for key, title, text in sections)
    facts = f"sonarjax {sj.__version__}, drawn from {len(found)} experiments at commit {git_hash() or 'unknown'}"
    text = TEMPLATE.read_text(encoding="utf-8")
    for key, value in (("FACTS", escape(facts)), ("LINKS", links), ("BODY", body)):
        text = text.replace(f"<!-- {key} -->", value)
    return text


def lacking(names: list[str]) -> str:
    """What to run."""
    return "".join(f"<p>Not run: <code>{escape(index.command(name))}</code></p>" for name in names)


def numbers(run: Run) -> str:
    """The paper's numbers beside ours, the segmenters, Tables 3 and 4."""
    mark = SMOKE if run.smoke else ""
    parts = [f"<p>{escape(origin([run.report]).replace('`', ''))}{mark}</p>", named_table(run.report["rows"], BESIDE)]
    parts += ["<h3>Segmenters</h3>", named_table(run.report["segmenters"], HEADS)]
    for script, key in ((tab03, "tab03"), (tab04, "tab04")):
        table = run.report["tables"][key]
        parts.append(f"<h3>{script.ITEM}</h3><p>{escape(script.CAPTION)} Here: {table['threshold']:.3f}.</p>")
        parts.append(correlations(table, script.PAPER))
    return "\n".join(parts)


def html_table(head: list[str], rows: list[list[Any]]) -> str:
    """A table that scrolls by itself where the window is narrow; columns of numbers stand to the right."""
    text = [[index.shown(v) if v is None or isinstance(v, float) else str(v) for v in row] for row in rows]
    right = [all(NUMBER.fullmatch(row[k]) for row in text) for k in range(len(head))]

    def line(tag: str, values: list[str]) -> str:
        ways = (' class="n"' if r else "" for r in right)
        return "".join(f"<{tag}{way}>{escape(v)}</{tag}>" for way, v in zip(ways, values, strict=True))

    top, lines = line("th", head), "\n".join(f"<tr>{line('td', row)}</tr>" for row in text)
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead>\n<tbody>{lines}</tbody></table></div>'


def named_table(rows: list[dict[str, Any]], heads: dict[str, str]) -> str:
    """A table of rows by name."""
    return html_table(list(heads.values()), [[row.get(key) for key in heads] for row in rows])


def correlations(table: dict[str, Any], said: dict[str, Any]) -> str:
    """Table 3 or 4: the paper's columns, then ours; below a zero the number that Otsu's threshold took, in grey."""
    head = "".join(f'<th class="n">{angle}°</th>' for angle in ANGLES_DEG)
    lines = []
    for kind, theirs, ours, shown in blocks(table, **said):
        for k, angle in enumerate(ANGLES_DEG):
            paper = "".join(
                _value(theirs[k, n], theirs[k, n]) if theirs is not None else "<td>–</td>" for n in range(4)
            )
            mine = "".join(_value(ours[k, n], shown[k, n]) for n in range(4))
            lines.append(f'<tr><td>{kind if k == 0 else ""}</td><td class="n">{angle}°</td>{paper}{mine}</tr>')
    top = '<tr><th colspan="2">image</th><th colspan="4">paper, template</th><th colspan="4">ours, template</th></tr>'
    lead = f"<thead>{top}<tr><th></th><th></th>{head}{head}</tr></thead>"
    return f'<div class="wide"><table class="pair">{lead}<tbody>{"".join(lines)}</tbody></table></div>'


def _value(value: float, shown: float) -> str:
    if shown > 0:
        return f'<td class="n">{value:.4f}</td>'
    under = f'<br><span class="under">{value:.4f}</span>' if value > 0 else ""
    return f'<td class="n">0{under}</td>'


def figures(runs: Path, kinds: tuple[str, ...]) -> str:
    """The figures of some kinds whose experiments have run."""
    parts = []
    for name, script in index.scripts().items():
        if name.startswith(kinds) and not index.missing(script, runs):
            mark = SMOKE if index.is_smoke(script, runs) else ""
            shown = or_why(partial(picture, name, runs), paragraph)
            text = f"<b>{escape(script.ITEM)}</b> {escape(script.CAPTION)}{mark}"
            parts.append(f'<figure id="{name}">{shown}<figcaption>{text}</figcaption></figure>')
    return "\n".join(parts) or "<p>None of them has run.</p>"


def picture(name: str, runs: Path) -> str:
    """An item as an image in PNG, itself in the page."""
    file = io.BytesIO()
    with rc_context(style.RC):
        index.drawn(name, runs).savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img alt="{escape(index.scripts()[name].ITEM)}" src="data:image/png;base64,{data}">'


def printed(found: dict[str, Run], own: dict[str, str]) -> str:
    """Each experiment's own tables, folded up."""
    parts = []
    for name, run in found.items():
        mark = SMOKE if run.smoke else ""
        parts.append(f"<details><summary>{escape(name)}{mark}</summary>{from_markdown(own[name])}</details>")
    return "\n".join(parts)


def from_markdown(text: str) -> str:
    """Tables and lines of text of an experiment as HTML."""
    parts: list[str] = []
    for piece in re.split(r"((?:^\|.*\n?)+)", text, flags=re.MULTILINE):
        lines = [line for line in piece.split("\n") if line]
        if piece.startswith("|"):
            head, _, *rows = [line[2:-2].split(" | ") for line in lines]  # as `markdown` writes them
            parts.append(html_table(head, rows))
        else:
            parts += map(paragraph, lines)
    return "\n".join(parts)


def settings(found: dict[str, Run]) -> str:
    """How each run was made."""
    rows, more = [], []
    for name, run in found.items():
        told = (run.report.get(key) for key in FACTS)
        rows.append([name, *(f"{value:.0f}" if isinstance(value, float) else value for value in told)])
        versions = ", ".join(f"{key} {value}" for key, value in dict(run.report.get("versions", {})).items())
        chosen = json.dumps(run.report.get("settings"), ensure_ascii=False)
        more.append(f"<p><b>{escape(name)}</b> {escape(versions)}<br><code>{escape(chosen)}</code></p>")
    made = f'<div class="runs">{html_table(["experiment", *FACTS.values()], rows)}</div>'
    return f"{made}<details><summary>settings and versions</summary>{''.join(more)}</details>"


def absent(runs: Path) -> str:
    """Items without a run, and the command that makes it."""
    rows: list[list[Any]] = [
        [script.ITEM, name, "; ".join(index.command(one) for one in index.missing(script, runs))]
        for name, script in index.scripts().items()
        if index.missing(script, runs)
    ]
    return html_table(["item", "script", "command"], rows) if rows else "<p>Everything has run.</p>"
