"""How compiled functions are run. `Engine` is plain JAX; `sonarjax.cpu.CpuEngine` replaces it where speed matters.

Host functions such as `template_bank` and `Recognizer` take an engine and run their compiled parts through it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any


class Engine:
    """Plain JAX: functions compile when they are first called, and items are processed one after another."""

    def run(self, function: Callable[..., Any], *args: Any, **static: Any) -> Any:
        """Call `function(*args, **static)`, a function under `jax.jit` whose static arguments are passed by name."""
        return function(*args, **static)

    def prepare(self, function: Callable[..., Any], *args: Any, **static: Any) -> None:
        """Announce that `run` will be called with arguments of these shapes. This engine does nothing about it."""

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Compute [function(item) for item in items]."""
        return [function(item) for item in items]

    def stream(self, function: Callable[[Any, Any, Engine], Any], shared: Any, items: Iterable[Any]) -> Iterator[Any]:
        """Yield `function(shared, item, engine)` for each item in order, few at a time, so that memory does not grow
        with them.

        `function` must be defined in a module, because an engine may run it in another process. `engine` is then that
        process's own.
        """
        return (function(shared, item, self) for item in items)


PLAIN = Engine()
"""The engine that is used if no other is given. It holds no state."""
