"""How compiled functions are run. `Engine` is plain JAX; `sonarjax.cpu.CpuEngine` replaces it where speed matters.

Host functions such as `template_bank` and `Recognizer` take an engine and run their compiled parts through it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any


class Engine:
    """Plain JAX: functions compile when they are first called, and items are processed one after another."""

    @property
    def at_once(self) -> int:
        """How many items `map` processes at the same time."""
        return 1

    def run(self, function: Callable[..., Any], *args: Any, **static: Any) -> Any:
        """Call a function. This engine leaves compiling to JAX; another may do it itself, and keep the result.

        Args:
            function: A function under `jax.jit`, or a plain one.
            *args: Its arguments.
            **static: Its static arguments, by name.

        Returns:
            What the function returns.
        """
        return function(*args, **static)

    def prepare(self, function: Callable[..., Any], *args: Any, **static: Any) -> None:
        """Announce that `run` will be called with arguments of these shapes.

        This engine does nothing about it.

        Args:
            function: The function under `jax.jit` that `run` will call.
            *args: Arguments of the same shapes and types.
            **static: Its static arguments, by name.
        """

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Call a function for each item.

        Args:
            function: Called with an item.
            items: The items.

        Returns:
            The results, in the order of the items.
        """
        return [function(item) for item in items]

    def stream(self, function: Callable[[Any, Any, Engine], Any], shared: Any, items: Iterable[Any]) -> Iterator[Any]:
        """Yield the result for each item, few at a time, so that memory does not grow with the number of items.

        Args:
            function: Called as `function(shared, item, engine)`. It must be defined in a module, because an engine may
                run it in another process. `engine` is then that process's own.
            shared: First argument of every call.
            items: Second argument of each call.

        Yields:
            The results, in the order of the items.
        """
        return (function(shared, item, self) for item in items)


PLAIN = Engine()
"""The engine that is used if no other is given. It holds no state."""
