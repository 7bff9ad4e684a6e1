"""What several commands share: every frame in the order given, and setting up JAX."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

CLUSTER_HELP = "share the work among Dask workers: a scheduler's ADDRESS, or local[:N] for N processes on this machine"
Lazy = Any  # a type of a module that is imported inside the function: the docstring names it


def each_frame(specs: Sequence[str]) -> Iterator[tuple[str, Lazy]]:
    """Name and io.Frame of every frame in the order given; for one that cannot be read, the exception that says why.

    A progress bar is shown if stderr is a terminal.
    """
    from tqdm import tqdm

    from sonarjax.io import SonarjaxError, iter_records, split_spec

    with tqdm(total=len(specs), unit="frame", file=sys.stderr, disable=not sys.stderr.isatty()) as bar:
        for spec in specs:
            first = True
            try:
                for frame in iter_records(spec):
                    if isinstance(frame, SonarjaxError):
                        yield spec, frame  # the error of a damaged frame; the recording's other frames follow
                        continue
                    if first and split_spec(spec).number is None:
                        bar.total += frame.meta["n_frames"] - 1  # not known before the first frame is read
                    first = False
                    yield frame.source, frame
                    bar.update()
            except BrokenPipeError:
                raise
            except Exception as error:
                yield spec, error
                bar.update()


def start_jax() -> None:
    """Set the process up for a CPU, before anything is compiled."""
    from sonarjax import cpu

    cpu.tune()


@contextmanager
def engine_of(cluster: str | None) -> Iterator[Lazy]:
    """The engine of a command: this machine's usual one, or a `ClusterEngine` of the Dask workers at `cluster`.

    Raises SonarjaxError if there is no such cluster, or the package for it is missing.
    """
    if cluster is None:
        from sonarjax.cpu import usual_engine

        yield usual_engine()
        return
    from sonarjax.cluster import connect

    with connect(cluster) as engine:
        yield engine
