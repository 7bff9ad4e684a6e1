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


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0, or 1 when what was asked for cannot be drawn."""
    parser = argparse.ArgumentParser(prog="python -m paper_figs", description=__doc__.splitlines()[0])
    parser.add_argument("items", nargs="*", metavar="ITEM", help=" ".join(one.split("_")[0] for one in index.scripts()))
    parser.add_argument("--all", action="store_true", help="draw every item whose experiments have run")
    parser.add_argument("--report", metavar="FILE", type=Path, help="write one HTML page with everything that has run")
    parser.add_argument("--index", action="store_true", help="write paper_figs/README.md")
    parser.add_argument("--readme", action="store_true", help="fill the tables of README.md and docs/")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of the results (default: runs)")
    parser.add_argument("--out", type=Path, default=index.FOLDER / "drawn", help="folder of the figures")
    chosen = parser.parse_args(arguments)
    if not (chosen.items or chosen.all or chosen.report or chosen.index or chosen.readme):
        parser.error("expected items, --all, --report, --index or --readme")
    try:
        _do(chosen)
    except SonarjaxError as error:
        print(f"paper_figs: {error}", file=sys.stderr)
        return 1
    return 0


def _do(chosen: argparse.Namespace) -> None:
    for name in map(index.find, chosen.items):
        _say(index.write_figure(name, chosen.runs, chosen.out)[0])
    for name, script in index.scripts().items() if chosen.all else ():
        absent = index.missing(script, chosen.runs)
        if absent:
            print(f"{name}: not run: {', '.join(map(index.command, absent))}")
        else:
            _say(index.write_figure(name, chosen.runs, chosen.out)[0])
    if chosen.index:
        write_text(index.FOLDER / "README.md", index.text(chosen.runs))
        _say(index.FOLDER / "README.md")
    if chosen.readme:
        readme.update(readme.PAGES, chosen.runs)
        for page in readme.PAGES:
            _say(page)
    if chosen.report:
        page = report.page(chosen.runs)
        chosen.report.parent.mkdir(parents=True, exist_ok=True)
        write_text(chosen.report, page.html)
        if page.main is not None:
            print(f"\n{page.main}\n")
        _say(chosen.report)


def _say(path: Path) -> None:
    print(path, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
