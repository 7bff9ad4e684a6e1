"""Parts or seeds of an experiment, measured by the workers of a cluster, which need this project's folder.

What measures a part is a function inside `run`, with all that `run` made before: it cannot travel. A worker therefore
runs the experiment itself, with what was measured before it, up to the parts that it is to measure. Runs depend on
settings and seed alone, so that what a worker measures is what one process would have.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from experiments.common.runs import PARTS, Files, Job, Share
from sonarjax.cluster import ClusterEngine
from sonarjax.engine import Engine
from sonarjax.io.jsonlines import plain


@dataclass(frozen=True)
class Work:
    """An experiment and its settings, in a form that travels."""

    module: str
    """Where it is imported from."""
    run: str
    """Name of its function there."""
    settings: str
    """Name of its dataclass there."""
    values: Mapping[str, Any]
    """The dataclass's fields."""

    def start(self, job: Job) -> dict[str, Any]:
        """Run it."""
        module = importlib.import_module(self.module)
        return getattr(module, self.run)(getattr(module, self.settings)(**self.values), job)


class Asked(NamedTuple):
    """What a worker is to measure."""

    work: Work
    """The experiment."""
    seed: int
    """Its seed."""
    known: dict[str, Any]
    """Values of the parts that were measured before."""


def shared_parts(engine: ClusterEngine, work: Work) -> Callable[[int], Share]:
    """By seed, what measures the parts of a run on the workers: as many groups of neighbours as there are threads."""

    def of_seed(seed: int) -> Share:
        def share(parts: list[str], known: dict[str, Any]) -> Iterable[tuple[dict[str, Any], Files]]:
            size = -(-len(parts) // max(1, engine.threads()))
            groups = [parts[k : k + size] for k in range(0, len(parts), size)]
            return engine.stream(measured_parts, Asked(work, seed, known), groups)

        return share

    return of_seed


def measured_parts(asked: Asked, parts: Sequence[str], engine: Engine) -> tuple[dict[str, Any], Files]:
    """On a worker: the values of some parts of one call of `Job.map` by name, and the files they left."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            asked.work.start(_Replay(Path(folder), asked.seed, asked.known, parts))
        except _Measured as found:
            return found.values, _files(Path(folder))
    raise RuntimeError(
        f"{asked.work.module}: expected a part called {parts[0]!r}: its parts depend on more than seed and settings"
    )


def measured_seeds(engine: Engine, work: Work, seeds: Sequence[int]) -> Iterator[tuple[dict[str, Any], Files]]:
    """Each seed's report, and the files of its folder by name, in the order of the seeds."""
    return engine.stream(measured_seed, work, seeds)


def measured_seed(work: Work, seed: int, engine: Engine) -> tuple[dict[str, Any], Files]:
    """On a worker: the whole run of a seed."""
    with tempfile.TemporaryDirectory() as folder:
        report = work.start(Job(Path(folder), seed))
        return plain(report), _files(Path(folder))


def _files(folder: Path) -> Files:
    """What a run left in its folder, but for the measured parts."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != PARTS]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


class _Measured(BaseException):
    """Leaves a run whose parts have been measured; no `except Exception` of an experiment catches it."""

    def __init__(self, values: dict[str, Any]) -> None:
        super().__init__()
        self.values = values


class _Replay(Job):
    """A job that knows what was measured before, and leaves the run once the wanted parts are."""

    def __init__(self, folder: Path, seed: int, known: dict[str, Any], wanted: Sequence[str]) -> None:
        super().__init__(folder, seed)
        self._done, self._wanted = dict(known), set(wanted)

    def map(self, measure: Callable[[Any], Any], cases: Any, title: str) -> dict[str, Any]:
        named: dict[str, Any] = dict(cases) if isinstance(cases, Mapping) else {name: name for name in cases}
        wanted = {name: case for name, case in named.items() if f"{title}/{name}" in self._wanted}
        if wanted:
            raise _Measured({f"{title}/{name}": plain(measure(case)) for name, case in wanted.items()})
        return {name: self._done[f"{title}/{name}"] for name in named}
