"""How compiled functions use the processor: compiler options, and a batch spread over the cores.

XLA runs the small operations of one view on one core only, and takes seconds to compile them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

# The emitters of XLA's older CPU compiler take half the time for the renderer, and what they make is no slower. Newer
# compilers know the option no more.
QUICK: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
"""Compiler options of a function that renders or matches. See `quick_jit`."""
SINGLE_CORE = QUICK | {"xla_cpu_multi_thread_eigen": False}
"""Those of one that `on_all_cores` calls too: its small kernels only lose by being shared out."""


def quick_jit(function: F, options: dict[str, Any] = QUICK, **how: Any) -> F:
    """`jax.jit(function, **how)` with compiler `options` where it is the outermost compiled function.

    Inside of another one, or while it is being differentiated, JAX allows none: it is then compiled as all else there.
    """
    alone, inside = jax.jit(function, compiler_options=options, **how), jax.jit(function, **how)

    @wraps(function)
    def compiled(*args: Any, **named: Any) -> Any:
        return (inside if is_traced(args, named) else alone)(*args, **named)

    return cast(F, compiled)


def is_traced(*trees: Any) -> bool:
    """True where a leaf of these pytrees is being traced: a function around this one is compiled or differentiated."""
    return any(isinstance(v, jax.core.Tracer) for v in jax.tree.leaves(trees))


def on_all_cores(function: Callable[[Any], Any], batch: Any, most: int | None = None) -> Any:
    """`function(batch)` for a compiled function of a pytree whose leaves lead with the batch axis, as its result does.

    On a CPU the batch is cut into parts, one for each core or more, of one size that is at most `most` (so that batches
    of several sizes share compiled code). On an accelerator, and inside a trace, there is one part.
    """
    leaves = jax.tree.leaves(batch)
    count = len(leaves[0])
    if count == 1 or jax.default_backend() != "cpu" or is_traced(leaves):
        return function(batch)
    parts = max(min(_cores(), count), -(-count // (most or count)))
    size = -(-count // parts)
    index = np.minimum(np.arange(parts * size), count - 1).reshape(parts, size)  # the last part may repeat an element
    batch = jax.tree.map(np.asarray, batch)  # NumPy takes and joins parts of any number without compiling anything
    found = side_by_side(lambda rows: function(jax.tree.map(lambda v: v[rows], batch)), list(index))
    return jax.tree.map(lambda *v: jnp.asarray(np.concatenate(v)[:count]), *found)


def side_by_side(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """[function(item) for item in items], with a thread for each core of a CPU; each waits for its results."""
    if len(items) < 2 or _cores() < 2 or jax.default_backend() != "cpu":
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(_cores(), len(items))) as pool:
        return list(pool.map(lambda item: jax.block_until_ready(function(item)), items))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
