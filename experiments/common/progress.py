"""Progress bars that say what is being computed, and for how long: one part may compile for a minute."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

PERIOD_S = 3.0
"""How often a bar is drawn again while a part is computed."""


class Progress:
    """A bar over parts, some of which may be computed side by side. A context manager."""

    def __init__(self, title: str, total: int, *, initial: int = 0, unit: str = "part", leave: bool = True) -> None:
        """`initial` of the `total` parts are done already."""
        self._bar = tqdm(total=total, initial=initial, desc=title, unit=unit, leave=leave, smoothing=0.0)
        self._begun: dict[str, float] = {}
        self._ended = threading.Event()
        self._heart = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Progress:
        """Start to say what is computed."""
        self._heart.start()
        return self

    def __exit__(self, *_: Any) -> None:
        """Close the bar."""
        self._ended.set()
        self._heart.join()
        self._bar.set_postfix_str("", refresh=False)
        self._bar.close()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Around what computes the part of this name; it is done when no exception leaves it."""
        self._begun[name] = time.monotonic()
        self._say(refresh=False)
        try:
            yield
        finally:
            del self._begun[name]
        self._bar.update()

    def done(self) -> None:
        """A part is done that was computed elsewhere."""
        self._bar.update()

    def _beat(self) -> None:
        while not self._ended.wait(PERIOD_S):
            self._say()

    def _say(self, refresh: bool = True) -> None:
        """What has been computed longest; which part of that is compiling nobody knows."""
        running = sorted(self._begun.copy().items(), key=lambda one: one[1])
        if running:
            name, begun = running[0]
            seconds = time.monotonic() - begun
            self._bar.set_postfix_str(f"compiling and computing {name}, {seconds:.0f} s", refresh=refresh)
