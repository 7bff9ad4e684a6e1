"""A stream of random numbers under jit: a single draw from a key, whose numbers are then used one by one.

Each separate draw adds some hundred instructions to compile, and a pair needs a hundred numbers.
"""

from __future__ import annotations

import contextlib
import math
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import shown

Number = Any  # a float or a traced scalar
SEEDS = 2**32
"""Seeds and numbers of frames are below it: JAX's keys have 32 bits of a seed, so that larger ones would repeat."""
TAIL = 0.5 * (1 - NormalDist().cdf(3.0))  # normal draws stop near three standard deviations, to keep scenes plausible


def key_numbers(key: Array) -> UInt32[np.ndarray, "word"]:
    """Data of one JAX key of JAX's usual kind. Raises SonarjaxError if it is something else."""
    data, usual = None, jax.random.key_data(jax.random.key(0))
    with contextlib.suppress(TypeError, ValueError):
        data = np.asarray(jax.random.key_data(key))
    if data is None or data.ndim != 1:
        raise SonarjaxError(f"key: expected one JAX key, such as jax.random.key(0), got {shown(key)}")
    if data.shape != usual.shape:
        raise SonarjaxError(f"key: expected a key of {usual.size} words, as jax.random.key(0) makes, got {data.size}")
    return data


class Stream:
    """Random numbers that are drawn at once from a key. Each method uses the next one, while the function is traced."""

    def __init__(self, count: int, *, key: Array) -> None:
        """Draw `count` numbers. Asking for more raises IndexError."""
        self._numbers = jax.random.uniform(key, (count,))
        self._next = 0

    def uniform(self) -> Float[Array, ""]:
        """A number from 0 to 1."""
        if self._next == len(self._numbers):
            raise IndexError(f"a stream of {self._next} numbers is used up")
        self._next += 1
        return self._numbers[self._next - 1]

    def between(self, low: Number, high: Number) -> Float[Array, ""]:
        """A number from `low` to `high`."""
        return low + (high - low) * self.uniform()

    def log_between(self, low: float, high: float) -> Float[Array, ""]:
        """A number from `low` to `high`, uniform in its logarithm."""
        return jnp.exp(self.between(math.log(low), math.log(high)))

    def normal(self) -> Float[Array, ""]:
        """A standard normal number, cut off near ±3."""
        return jax.scipy.special.ndtri(self.between(TAIL, 1 - TAIL))

    def pick(self, shares: tuple[float, ...]) -> Int[Array, ""]:
        """A random index, each with a probability proportional to its entry in `shares`."""
        bounds = [sum(shares[:n]) / sum(shares) for n in range(1, len(shares))]
        return (self.uniform() >= jnp.array(bounds)).sum()

    def happens(self, share: Number) -> Any:
        """True with probability `share`."""
        return self.uniform() < share

    def sometimes(self, share: float, value: Number, otherwise: Number) -> Float[Array, ""]:
        """`value` with probability `share`, else `otherwise`."""
        return jnp.where(self.happens(share), value, otherwise)
