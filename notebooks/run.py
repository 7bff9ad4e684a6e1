"""Executes the notebooks, each from top to bottom in a fresh kernel: `python -m notebooks.run [NAME...]`.

A NAME is a notebook's name or the beginning of one (`04`); without any, all are executed. The kernel is the interpreter
that runs this. Prints the seconds each took; what was executed lies in runs/notebooks/, the notebooks themselves stay
as they are. Exits with 1 when a cell fails, having named the cell and its error; with 2 for an unknown NAME.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import nbformat
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

FOLDER = Path(__file__).resolve().parent
OUT = FOLDER.parent / "runs" / "notebooks"
CELL_SECONDS = 600
COLOURS = re.compile(r"\x1b\[[0-9;]*m")


class ThisInterpreter(AsyncKernelManager):
    """Starts the kernel of this very interpreter, whatever kernels a user has registered under the same name."""

    def _kernel_spec_manager_default(self) -> KernelSpecManager:
        return KernelSpecManager(kernel_dirs=[])


def main(names: Sequence[str]) -> int:
    """Execute the notebooks of these names, or all; returns the exit code."""
    chosen = find(names)
    if not chosen:
        print(f"no notebook is called {' or '.join(names)}", file=sys.stderr)
        return 2
    OUT.mkdir(parents=True, exist_ok=True)
    failed = 0
    for path in chosen:
        started = time.perf_counter()
        error = execute(path)
        seconds = time.perf_counter() - started
        print(f"{path.stem:32s} {seconds:6.1f} s{'' if error is None else '  FAILED'}", flush=True)
        if error is not None:
            print(error, file=sys.stderr, flush=True)
            failed = 1
    return failed


def find(names: Sequence[str]) -> list[Path]:
    """The notebooks whose names begin with one of `names`, in their order; none when one of the names is unknown."""
    paths = sorted(FOLDER.glob("*.ipynb"))
    wanted = [Path(name).name.removesuffix(".ipynb") for name in names]
    if any(not any(path.stem.startswith(name) for path in paths) for name in wanted):
        return []
    return [path for path in paths if not wanted or any(path.stem.startswith(name) for name in wanted)]


def execute(path: Path) -> str | None:
    """Execute one notebook and keep the result in OUT; returns what went wrong, None if nothing did."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=CELL_SECONDS,
        kernel_name="python3",
        kernel_manager_class=ThisInterpreter,
        resources={"metadata": {"path": str(OUT)}},
        extra_arguments=["--IPKernelApp.log_level=40"],  # errors only: else each kernel warns of its local sockets
    )
    stopped = None
    try:
        client.execute()
    except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
        stopped = f"{path.name}: {type(error).__name__}: {error}"
    nbformat.write(notebook, OUT / path.name)
    return next(failures(notebook, path.name), stopped)


def failures(notebook: Any, name: str) -> Iterator[str]:
    """Errors in the outputs of an executed notebook: of cells, and of widgets, whose errors stop no cell."""
    for number, cell in enumerate(notebook.cells):
        for error in _errors(cell.get("outputs", [])):
            yield f"{name}: cell {number}:\n{cell.source}\n\n{error}"
    widgets = notebook.metadata.get("widgets", {})
    for kind in widgets.values():
        for widget in kind["state"].values():
            for error in _errors(widget["state"].get("outputs", [])):
                yield f"{name}: a widget:\n{error}"


def _errors(outputs: Sequence[Any]) -> Iterator[str]:
    for output in outputs:
        if output["output_type"] == "error":
            yield COLOURS.sub("", "\n".join(output["traceback"]) or f"{output['ename']}: {output['evalue']}")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
