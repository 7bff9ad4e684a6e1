"""How every experiment is started: `launch` makes a frozen dataclass of settings its command line, and runs it.

`--preset smoke` is a run of seconds, `--seeds 0 1 2` several runs and their spread. Every field of the settings is an
option; the string under the field is its help.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, fields, is_dataclass
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from experiments.common.frames import VALIDATION_SEED
from experiments.common.runs import Files, Job, circumstances, files_digest, run_folder
from experiments.common.share import Work, measured_seeds, shared_parts
from sonarjax.cluster import connect
from sonarjax.cpu import tune
from sonarjax.engine import Engine
from sonarjax.io import SonarjaxError, silence_stdout

Report = dict[str, Any]
Run = Callable[[Any, Job], Report]


class Skipped(SonarjaxError):
    """What an experiment needs beside the project is not here: data, or a library to compare with."""


def launch(
    run: Run,
    settings: type,
    table: Callable[[Report], str],
    *,
    smoke: Mapping[str, Any],
    arguments: Sequence[str] | None = None,
) -> list[Report]:
    """Run an experiment from its command line: `run(settings, job)` for each seed, `table(report)` to the terminal.

    `smoke` are the settings of `--preset smoke`. Leaves by SystemExit: 2 for arguments, 1 for a SonarjaxError, 130 when
    interrupted, 141 when nobody reads stdout any more. Of Skipped, `--preset smoke` leaves a line that says so, and 0.
    """
    module = inspect.getmodule(run)
    assert module is not None and module.__file__ is not None
    name = Path(module.__file__).stem
    chosen, common = parse(settings, module.__doc__ or "", smoke, arguments)
    if common.cluster and name.startswith("bench_"):
        print(f"{name}: --cluster: cannot be used, because a benchmark times one machine", file=sys.stderr)
        raise SystemExit(2)
    tune()  # before anything is computed
    reports = []
    facts = {"experiment": name, "preset": common.preset, "changed": common.changed}
    try:
        with connect(common.cluster) if common.cluster else nullcontext() as engine:
            work = Work(_module_name(run), run.__name__, settings.__qualname__, asdict(chosen))
            share = shared_parts(engine, work) if engine and len(common.seeds) == 1 else None
            folders = {seed: run_folder(Path(common.runs), name, asdict(chosen), seed) for seed in common.seeds}
            read = files_digest(asdict(chosen))
            jobs = [Job(folder, seed, share and share(seed), read) for seed, folder in folders.items()]
            for job, report in zip(jobs, _reports(run, chosen, jobs, facts, engine, work), strict=True):
                reports.append(report)
                print(f"\n{table(report)}\n\n{job.folder}: {report['seconds']:.0f} s", flush=True)
        if len(reports) > 1:
            _print_spread(reports, common.seeds, table)
    except Skipped as error:
        if common.preset != "smoke":
            raise SystemExit(f"{name}: {error}") from error
        print(f"skipped: {error}", flush=True)
    except SonarjaxError as error:
        raise SystemExit(f"{name}: {error}") from error
    except KeyboardInterrupt:
        print(f"{name}: interrupted; run the same command again to continue", file=sys.stderr)
        raise SystemExit(130) from None
    except BrokenPipeError:  # whoever read the tables has gone
        silence_stdout()
        raise SystemExit(141) from None
    return reports


def _print_spread(reports: Sequence[Report], seeds: Sequence[int], table: Callable[[Report], str]) -> None:
    """The mean over the seeds, and how far they are from it."""
    print(f"\nmean of seeds {', '.join(map(str, seeds))}\n{table(combined(reports, _mean))}")
    about = "largest deviation from this mean; whole numbers that are the same in all seeds stand as they are"
    print(f"\n{about}\n{table(combined(reports, _deviation))}", flush=True)


def _reports(
    run: Run, chosen: Any, jobs: list[Job], facts: Report, engine: Engine | None, work: Work
) -> Iterator[Report]:
    """Each seed's report in turn; of an interrupted command, the seeds that were done before are not run again.

    Several seeds are each run on a worker of the `engine`, if there is one.
    """
    interrupted = any(job.begun for job in jobs)
    kept = {job.seed: job.finished if interrupted else None for job in jobs}
    for job in jobs:
        if kept[job.seed]:
            job.drop_parts()
    left = [job.seed for job in jobs if not kept[job.seed]]
    elsewhere = measured_seeds(engine, work, left) if engine and len(jobs) > 1 else None
    for job in jobs:
        yield kept[job.seed] or _one(run if elsewhere is None else _fetched(elsewhere), chosen, job, facts)


def _fetched(elsewhere: Iterator[tuple[Report, Files]]) -> Run:
    """A run that takes the next report, and the files beside it, from where they were made."""

    def run(settings: Any, job: Job) -> Report:
        report, files = next(elsewhere)
        job.put(files)
        return report

    return run


def _module_name(run: Run) -> str:
    """The module's name for an import, also where it is the one that was started."""
    module = inspect.getmodule(run)
    spec = getattr(module, "__spec__", None)
    return str(spec.name if spec else run.__module__)


def _one(run: Run, settings: Any, job: Job, facts: Report) -> Report:
    started = time.perf_counter()
    facts = facts | {"seed": job.seed, "settings": asdict(settings)} | circumstances()
    report = facts | run(settings, job)
    report["seconds"] = time.perf_counter() - started
    job.finish(report)
    return report


def parse(
    settings: type, about: str, smoke: Mapping[str, Any], arguments: Sequence[str] | None = None
) -> tuple[Any, argparse.Namespace]:
    """The settings that a command line asks for, and what all experiments take: preset, seeds, runs.

    With them `changed`: the options that were given another value than the preset's.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--preset", choices=("full", "smoke"), default="full", help="smoke: a test run of seconds")
    seeds = f"root seeds below {VALIDATION_SEED}, one run each (default: 0)"
    parser.add_argument("--seeds", type=_seed, nargs="+", default=[0], help=seeds)
    parser.add_argument("--runs", default="runs", help="folder of the results (default: runs)")
    cluster = "share parts, or several seeds, among Dask workers: a scheduler's ADDRESS, or local[:N] (extra cluster)"
    parser.add_argument("--cluster", default=None, help=cluster)
    helps, kinds = field_docstrings(settings), get_type_hints(settings)
    for option in fields(settings):
        text = f"{' '.join(helps[option.name].split())} (default: {_shown(option.default)})".replace("%", "%%")
        parser.add_argument(
            f"--{option.name.replace('_', '-')}", default=None, help=text, **_kind(kinds[option.name], option.default)
        )
    given = vars(parser.parse_args(arguments))
    common = argparse.Namespace(**{name: given.pop(name) for name in ("preset", "seeds", "runs", "cluster")})
    start = dict(smoke) if common.preset == "smoke" else {}
    asked = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items() if v is not None}
    try:
        chosen, preset = settings(**start | asked), settings(**start)
        common.changed = [v.name for v in fields(settings) if getattr(chosen, v.name) != getattr(preset, v.name)]
        return chosen, common
    except ValueError as error:
        parser.error(str(error))


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= VALIDATION_SEED:
        expected = f"a whole number below {VALIDATION_SEED}, where validation's begin"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    return int(text)


def _kind(kind: Any, default: Any) -> dict[str, Any]:
    """What argparse needs to read a field of type `kind`."""
    if kind is bool:
        return {"action": argparse.BooleanOptionalAction}
    if get_origin(kind) is Literal:
        return {"choices": get_args(kind)}
    if isinstance(default, tuple):
        first = get_args(kind)[0]
        one: dict[str, Any] = {"choices": get_args(first)} if get_origin(first) is Literal else {"type": first}
        return one | {"nargs": "+"}
    return {"type": kind}


def _shown(default: Any) -> str:
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def field_docstrings(settings: type) -> dict[str, str]:
    """The string under each field of a dataclass and of those it is made from. A field that has none has no key."""
    kinds = [kind for kind in settings.__mro__ if is_dataclass(kind)]
    bodies = [ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body for kind in kinds]  # type: ignore[attr-defined]
    return {
        ast.unparse(field.target): str(below.value.value)
        for body in bodies
        for field, below in pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
    }


def combined(values: Sequence[Any], merge: Callable[[list[float]], Any]) -> Any:
    """Reports of several seeds as one: numbers merged, `True` only if it is so in all, all else as in the first.

    Rows of a table are found by the words before their first number; those that a seed lacks are left out. Other lists
    keep the shortest length. A number that some seeds lack (None) is merged from the others. What is the same whole
    number in all stays one.
    """
    first = values[0]
    if isinstance(first, dict):
        return {k: combined([v[k] for v in values], merge) for k in first if all(k in v for v in values)}
    if isinstance(first, list):
        return [combined(rows, merge) for rows in _side_by_side(values)]
    numbers = [v for v in values if v is not None]
    if numbers and all(isinstance(v, bool) for v in numbers):
        return all(numbers)
    if not numbers or any(isinstance(v, bool) or not isinstance(v, int | float) for v in numbers):
        return first
    if all(isinstance(v, int) and v == numbers[0] for v in numbers):
        return numbers[0]
    return merge(numbers)


def _side_by_side(lists: Sequence[list[Any]]) -> list[tuple[Any, ...]]:
    """The same row of each list: by name if rows have names and no two the same, else by place."""
    named = [{_name_of(row): row for row in rows} for rows in lists]
    if any(None in rows or len(rows) < len(of) for rows, of in zip(named, lists, strict=True)):
        return list(zip(*lists, strict=False))
    return [tuple(rows[name] for rows in named) for name in named[0] if all(name in rows for rows in named)]


def _name_of(row: Any) -> tuple[str, ...] | None:
    """The words with which a row begins; None without."""
    words = takewhile(lambda value: isinstance(value, str), row.values() if isinstance(row, dict) else ())
    return tuple(words) or None


def mean_and_spread(values: list[float]) -> Any:
    """Mean ± the largest deviation from it; the number itself where all are the same to what a table shows."""
    mean, most = _mean(values), _deviation(values)
    if most < 5e-4:
        return values[0]
    digits = 2 if abs(mean) >= 10 else 3
    return f"{mean:.{digits}f} ± {most:.{digits}f}"


def _mean(values: list[float]) -> float:
    return values[0] if min(values) == max(values) else sum(values) / len(values)  # no 0.8000000000000002 of 0.8


def _deviation(values: list[float]) -> float:
    return max(abs(value - _mean(values)) for value in values)
