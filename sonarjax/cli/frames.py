"""What several commands share: every frame in the order given, and setting up JAX."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from sonarjax.io import Frame, SonarjaxError, complain, iter_records, split_spec

CLUSTER_HELP = "share the work among Dask workers: a scheduler's ADDRESS, or local[:N] for N processes on this machine"
BINS_APART = 3
"""Range bins by which a frame's header may differ from the sonar: a header rounds its window."""
Lazy = Any  # a type of a module that is imported inside the function: the docstring names it


def each_frame(specs: Sequence[str]) -> Iterator[tuple[str, Lazy]]:
    """Name and io.Frame of every frame in the order given; for one that cannot be read, the exception that says why.

    A progress bar is shown if stderr is a terminal.
    """
    from tqdm import tqdm

    with tqdm(total=len(specs), unit="frame", file=sys.stderr, disable=not sys.stderr.isatty()) as bar:
        for spec in specs:
            first = True
            try:
                for number, frame in enumerate(iter_records(spec)):
                    if isinstance(frame, SonarjaxError):
                        yield _damaged(spec, number, frame), frame  # the recording's other frames follow
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


def _damaged(spec: str, number: int, error: SonarjaxError) -> str:
    """The name of a damaged frame, record `number` of those that `spec` names: with its own number, as others have."""
    begins = str(error).partition(": ")[0]  # for a bag also with the topic: a bag's error begins with the frame's name
    asked = split_spec(spec).number
    if begins.endswith(f":{number if asked is None else asked}"):
        return begins
    return f"{spec}:{number}" if asked is None else spec


def frames_for(sonar: Lazy, specs: Sequence[str], toml: str) -> Iterator[tuple[str, Lazy]]:
    """As `each_frame`, for a Sonar that was read from the file `toml`.

    Instead of a frame of another shape there is a SonarjaxError. A note on stderr names each file whose header
    contradicts the sonar; its frames are used nevertheless.
    """
    noted = set[str]()
    for name, frame in each_frame(specs):
        if isinstance(frame, Exception):
            yield name, frame
            continue
        if frame.shape != sonar.shape:
            yield name, SonarjaxError(_misfit(frame, sonar, toml))
            continue
        path, contradiction = split_spec(frame.source).path, header_contradiction(frame, sonar)
        if contradiction and path not in noted:
            noted.add(path)
            complain(f"{path}: its header contradicts {toml}, which is used: {contradiction}", kind="note: ")
        yield name, frame


def _misfit(frame: Frame, sonar: Lazy, toml: str) -> str:
    """What to say of a frame that has not the shape of the sonar's frames."""
    hint = f"; a fan picture needs `sonarjax convert FAN.png --sonar {toml} --out FRAME.npz` first"
    return (
        f"{frame.source}: image: expected shape {sonar.shape} (range, beam) of {toml}, got {frame.shape}"
        f"{hint if frame.geometry is None else ''}"
    )


def header_contradiction(frame: Frame, sonar: Lazy) -> str:
    """How the header of a frame contradicts the Sonar: by more than a beam or a few range bins. "" if it does not."""
    held, found = frame.geometry or {}, []
    own = np.degrees(np.asarray(sonar.azimuth, np.float64))
    if len(held.get("azimuth_deg", ())) == own.size > 1:
        apart = float(np.abs(np.asarray(held["azimuth_deg"]) - own).max())
        if apart > (own[-1] - own[0]) / (own.size - 1):
            found.append(f"beam angles differ by up to {apart:.2g} deg")
    if {"range_min_m", "range_max_m"} <= set(held):
        theirs, ours = (held["range_min_m"], held["range_max_m"]), (float(sonar.range_min), float(sonar.range_max))
        if np.abs(np.subtract(theirs, ours)).max() > BINS_APART * float(sonar.range_bin):
            found.append(f"range {theirs[0]:.4g} to {theirs[1]:.4g} m, not {ours[0]:.4g} to {ours[1]:.4g} m")
    return "; ".join(found)


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
