"""Make XLA write the result of a stage to memory, so that it is computed only once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def materialised(stage: Callable[..., Any], *slabs: Any) -> Any:
    """Compute `stage(*slabs)` in two halves, for arrays whose first axis is the slab.

    XLA fuses a cheap stage into each of its uses, and into gathers, where it is computed many times over: on a CPU a
    render takes twice as long. The result of a loop is written to memory once, hence the two halves. Use it only for
    values that carry no gradient, or only by a number that is seldom free.
    """
    count = len(jax.tree.leaves(slabs)[0])
    half = -(-count // 2)

    def split(values: Any) -> Any:
        padded = jnp.pad(values, ((0, 2 * half - count),) + ((0, 0),) * (values.ndim - 1), mode="edge")
        return padded.reshape(2, half, *values.shape[1:])

    out = jax.lax.map(lambda part: stage(*part), jax.tree.map(split, slabs))
    return jax.tree.map(lambda v: v.reshape(2 * half, *v.shape[2:])[:count], out)
