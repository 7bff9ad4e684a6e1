"""How compiled functions are run: `Engine` is plain JAX; `sonarjax.cpu.CpuEngine` replaces it where speed counts.

Host functions such as `template_bank` and `Recognizer` run their compiled parts through an engine that they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any


class Engine:
    """Plain JAX: functions compile when they are first called, and items are taken one after another."""

    def run(self, function: Callable[..., Any], *args: Any, **static: Any) -> Any:
        """`function(*args, **static)` of a function under `jax.jit` whose static arguments are named."""
        return function(*args, **static)

    def prepare(self, function: Callable[..., Any], *args: Any, **static: Any) -> None:
        """Note that `run` will be called with arguments of these shapes: here nothing is done about it."""

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """[function(item) for item in items]."""
        return [function(item) for item in items]


PLAIN = Engine()
"""The engine of whoever names none. It holds no state."""
