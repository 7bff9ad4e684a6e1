"""Draw the paper's figures from runs/.

Examples: python -m paper_figs fig08 tab03; python -m paper_figs --all; python -m paper_figs --report report.html
The report comes last, and before its path the table of reproduce_paper, if that has run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from paper_figs import index, readme, report
from sonarjax.io import SonarjaxError, write_text
from sonarjax.io.outputs import make_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0, or 1 when what was asked for cannot be drawn."""
    parser = argparse.ArgumentParser(prog="python -m paper_figs", description=__doc__.splitlines()[0])
    parser.add_argument("items", nargs="*", metavar="ITEM", help=" ".join(one.split("_")[0] for one in index.scripts()))
    parser.add_argument("--all", action="store_true", help="draw every item whose experiments have run")
    parser.add_argument("--report", metavar="FILE", type=Path, help="write one HTML page with everything that has run")
    parser.add_argument("--index", action="store_true", help="put what has run into paper_figs/README.md")
    parser.add_argument("--readme", action="store_true", help="fill the tables of README.md and docs/")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of the results (default: runs)")
    parser.add_argument("--out", type=Path, default=index.FOLDER / "drawn", help="folder of the figures")
    chosen = parser.parse_args(arguments)
    if not (chosen.items or chosen.all or chosen.report or chosen.index or chosen.readme):
        parser.error("expected items, --all, --report, --index or --readme")
    try:
        return _do(chosen)
    except SonarjaxError as error:
        _complain(error)
        return 1


def _do(chosen: argparse.Namespace) -> int:
    for name in map(index.find, chosen.items):
        _say(index.write_figure(name, chosen.runs, chosen.out)[0])
    drawn = _draw_all(chosen) if chosen.all else True
    if chosen.index:
        page = index.FOLDER / "README.md"
        write_text(page, index.text(chosen.runs, page.read_text(encoding="utf-8") if page.exists() else ""))
        _say(page)
    if chosen.readme:
        readme.update(readme.PAGES, chosen.runs)
        for page in readme.PAGES:
            _say(page)
    if chosen.report:
        found = report.page(chosen.runs)
        make_folder(str(chosen.report.parent))
        write_text(chosen.report, found.html)
        if found.main is not None:
            print(f"\n{found.main}\n")
        _say(chosen.report)
    return 0 if drawn else 1


def _draw_all(chosen: argparse.Namespace) -> bool:
    """Draw every item whose experiments have run. Returns False if one of them cannot be drawn, which is told."""
    drawn = True
    for name, script in index.scripts().items():
        absent = index.missing(script, chosen.runs)
        if absent:
            print(f"{name}: not run: {', '.join(map(index.command, absent))}")
            continue
        try:
            _say(index.write_figure(name, chosen.runs, chosen.out)[0])
        except SonarjaxError as error:  # what other code left in `runs` costs its own item alone
            _complain(error)
            drawn = False
    return drawn


def _complain(error: SonarjaxError) -> None:
    print(f"paper_figs: {error}", file=sys.stderr)


def _say(path: Path) -> None:
    print(path, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
