"""How compiled functions are run: `Engine` is plain JAX; `sonarjax.cpu.CpuEngine` replaces it where speed counts.

Host functions such as `template_bank` and `Recognizer` run their compiled parts through an engine that they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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

    def stream(self, function: Callable[[Any, Any, Engine], Any], shared: Any, items: Iterable[Any]) -> Iterator[Any]:
        """`function(shared, item, engine)` of each item in order, few at a time: the memory does not grow with them.

        `function` stands in a module, for an engine may run it in another process; `engine` is that of the process.
        """
        return (function(shared, item, self) for item in items)


PLAIN = Engine()
"""The engine of whoever names none. It holds no state."""
