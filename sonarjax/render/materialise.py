"""Running a part of the renderer so that its results are written to memory once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def materialised(stage: Callable[..., Any], *slabs: Any) -> Any:
    """`stage(*slabs)` for arrays that all lead with the slab axis, one half of the slabs after the other.

    XLA fuses a cheap stage into each of its uses, and into gathers, where it is then computed many times over (twice
    the time of a render on a CPU). What a loop returns is written to memory once. For what carries no gradient.
    """
    count = len(jax.tree.leaves(slabs)[0])
    half = -(-count // 2)

    def split(values: Any) -> Any:
        padded = jnp.pad(values, ((0, 2 * half - count),) + ((0, 0),) * (values.ndim - 1), mode="edge")
        return padded.reshape(2, half, *values.shape[1:])

    out = jax.lax.map(lambda part: stage(*part), jax.tree.map(split, slabs))
    return jax.tree.map(lambda v: v.reshape(2 * half, *v.shape[2:])[:count], out)
