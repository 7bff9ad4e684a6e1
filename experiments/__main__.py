"""What experiments are there, and does each still run?

python -m experiments                        lists them: name and question
python -m experiments --smoke [NAME ...]     runs each one's smoke preset into a temporary folder [--workers 2]
"""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
TAIL = 20  # lines of stderr shown of an experiment that failed


def questions() -> dict[str, str]:
    """The question of each experiment, its first docstring line, by name; nothing is imported."""
    trees = {path.stem: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(HERE.glob("*.py"))}
    return {
        name: (ast.get_docstring(tree) or "?").splitlines()[0] for name, tree in trees.items() if _is_experiment(tree)
    }


def _is_experiment(tree: ast.Module) -> bool:
    """Whether a file launches something."""
    calls = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    return any(isinstance(function, ast.Name) and function.id == "launch" for function in calls)


def smoke(name: str, runs: Path) -> tuple[str, str]:
    """`ok`, `skipped` or `failed` of an experiment's smoke preset, and what there is to say about it."""
    command = [sys.executable, "-m", f"experiments.{name}", "--preset", "smoke", "--runs", str(runs)]
    done = subprocess.run(command, cwd=HERE.parent, capture_output=True, text=True, check=False)
    if done.returncode:
        return "failed", "\n".join(done.stderr.splitlines()[-TAIL:])
    said = [line for line in done.stdout.splitlines() if line.startswith("skipped: ")]
    return ("skipped", said[0].removeprefix("skipped: ")) if said else ("ok", "")


def smoke_all(names: Sequence[str], workers: int = 1) -> list[str]:
    """Run them, `workers` at a time, print a line each; returns the tails of what failed."""
    failed, width = [], max(map(len, names))

    def timed(name: str) -> tuple[str, str, float]:
        started = time.perf_counter()
        return *smoke(name, Path(folder)), time.perf_counter() - started

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        for name, (state, text, seconds) in zip(names, pool.map(timed, names), strict=True):
            print(f"{name:<{width}} {seconds:>6.1f} s  {state}{': ' + text if state == 'skipped' else ''}", flush=True)
            failed += [f"{name}:\n{text}"] if state == "failed" else []
    return failed


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line. Leaves by SystemExit: 2 for arguments, 1 when something failed."""
    known = questions()
    parser = argparse.ArgumentParser(prog="python -m experiments", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--smoke", nargs="*", metavar="NAME", help="run the smoke preset of these experiments, or of all"
    )
    parser.add_argument(
        "--workers", type=int, default=1, metavar="N", help="experiments that run at a time (default 1)"
    )
    options = parser.parse_args(arguments)
    names = options.smoke
    if names is None:
        width = max(map(len, known))
        print("\n".join(f"{name:<{width}}  {question}" for name, question in known.items()))
        return
    unknown = [name for name in names if name not in known]
    if unknown:
        parser.error(f"unknown experiment {unknown[0]!r}, expected some of: {', '.join(known)}")
    if options.workers < 1:
        parser.error(f"--workers: expected 1 or more, got {options.workers}")
    failed = smoke_all(names or list(known), options.workers)
    if failed:
        print("\n" + "\n\n".join(failed), file=sys.stderr)
        raise SystemExit(1)


if __name__ == "__main__":
    main()
