"""Products of matrices in full float32, on every device.

GPUs and TPUs multiply float32 matrices after rounding their entries to 10 bits or fewer, unless told otherwise
(`jax.default_matmul_precision`). That suits networks, but it moves a point 5 m away by millimetres.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax

F = TypeVar("F", bound=Callable[..., Any])


def full_precision(function: F) -> F:
    """Make a function multiply matrices in full float32.

    What JAX derives from the function, such as its gradient, does so too.

    Args:
        function: The function.

    Returns:
        The same function in full float32.
    """

    @wraps(function)
    def exact(*args: Any, **kwargs: Any) -> Any:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return exact  # type: ignore[return-value]
