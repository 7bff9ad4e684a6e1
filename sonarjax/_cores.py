"""How compiled functions use the processor: compiler options, and a batch spread over the cores.

XLA runs the small operations of one view on one core only, and takes seconds to compile them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# The emitters of XLA's older CPU compiler take half the time for the renderer, and what they make is no slower; newer
# compilers know the option no more.
QUICK: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
"""Compiler options of a function that renders. JAX takes options for the outermost compiled function only."""
SINGLE_CORE = QUICK | {"xla_cpu_multi_thread_eigen": False}
"""Those of one that `on_all_cores` calls too: its small kernels only lose by being shared out."""


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
    found = side_by_side(lambda rows: function(jax.tree.map(lambda v: v[rows], batch)), list(index))
    return jax.tree.map(lambda *v: jnp.concatenate(v)[:count], *found)


def side_by_side(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """[function(item) for item in items], with a thread for each core of a CPU; each waits for its results."""
    if len(items) < 2 or _cores() < 2 or jax.default_backend() != "cpu":
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(_cores(), len(items))) as pool:
        return list(pool.map(lambda item: jax.block_until_ready(function(item)), items))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
