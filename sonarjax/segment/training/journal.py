"""The records of a run for people to read: TensorBoard events, a line of metrics for each epoch, sample pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import numpy as np

from sonarjax.io import JsonLines, write_png, write_text
from sonarjax.segment.training.run import METRICS


class Journal:
    """The records of one run in its folder; a context manager. Only the first process keeps records."""

    def __init__(self, folder: Path, step: int, *, writes: bool = True) -> None:
        """Continue after `step` steps: what a killed run recorded beyond them is dropped."""
        self._folder = folder
        self._events = None
        if not writes:
            return
        from tensorboardX import SummaryWriter  # takes half a second to import, and only training needs it

        _forget_after(folder / METRICS, step)
        self._lines = JsonLines(folder / METRICS)
        self._events = SummaryWriter(str(folder / "events"), purge_step=step + 1 if step else None)

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        """Record numbers by name, as points of curves."""
        if self._events is not None:
            for name, value in values.items():
                self._events.add_scalar(name, value, step)

    def epoch(self, number: int, step: int, metrics: Mapping[str, float], sheet: np.ndarray) -> None:
        """Record the end of an epoch: its metrics, and sample pictures as one grey image (row, column)."""
        if self._events is None:
            return
        self.scalars({f"validation/{name}": value for name, value in metrics.items()}, step)
        self._events.add_image("samples", sheet[None], step)
        self._events.flush()
        self._lines.write({"epoch": number, "step": step, **metrics})
        write_png(self._folder / "samples" / f"epoch_{number:04d}.png", sheet)

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._events is not None:
            self._events.close()
            self._lines.close()


def _forget_after(path: Path, step: int) -> None:
    """Drop the lines of later steps, and a line that was cut short."""
    if not path.exists():
        return
    kept = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            if json.loads(line)["step"] <= step:
                kept.append(line + "\n")
        except (ValueError, KeyError, TypeError):
            continue
    write_text(path, "".join(kept))
