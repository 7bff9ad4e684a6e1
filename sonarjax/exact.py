"""Numbers in float32, neither coarser nor finer.

GPUs and TPUs multiply float32 matrices after rounding their entries to 10 bits or fewer, unless told otherwise
(`jax.default_matmul_precision`). That suits networks, but it moves a point 5 m away by millimetres. In JAX's 64-bit
mode some numbers become float64 and do not fit the others.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax
import numpy as np

from sonarjax.io.errors import SonarjaxError

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


def check_single_precision() -> None:
    """Check that JAX is not in its 64-bit mode, which this package does not support.

    Raises:
        SonarjaxError: It is.
    """
    if jax.dtypes.canonicalize_dtype(np.float64) == np.float64:
        raise SonarjaxError("JAX_ENABLE_X64: expected it off: call sonarjax within `with jax.enable_x64(False):`")
