"""Initial weights: pix2pix's draw of all weights, from a single draw of normal numbers.

Flax's own `init` draws each array separately. Compiling those fifty draws takes XLA half a minute.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jaxtyping import Array

DEVIATION = 0.02
"""Standard deviation of kernels around 0 and of normalisation scales around 1. Adam's step size suits it."""


def draw_variables(module: nn.Module, *inputs: Array, key: Array) -> Any:
    """Variables of `module` as `module.init` makes them for `inputs` (any shapes); random ones are drawn from `key`."""
    shapes = jax.eval_shape(module.init, key, *inputs)
    flat, tree = jax.tree_util.tree_flatten_with_path(shapes)
    names = [path[-1].key for path, _ in flat]
    sizes = [leaf.size if name in ("kernel", "scale") else 0 for name, (_, leaf) in zip(names, flat, strict=True)]
    normals = jnp.split(DEVIATION * jax.random.normal(key, (sum(sizes),)), np.cumsum(sizes)[:-1].tolist())
    constant = {"kernel": 0.0, "scale": 1.0, "var": 1.0, "bias": 0.0, "mean": 0.0}
    leaves = [
        constant[name] + (noise.reshape(leaf.shape) if size else jnp.zeros(leaf.shape))
        for name, (_, leaf), noise, size in zip(names, flat, normals, sizes, strict=True)
    ]
    return jax.tree_util.tree_unflatten(tree, leaves)
