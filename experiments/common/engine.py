"""The engine that experiments compute with."""

from __future__ import annotations

from functools import cache

import jax

import sonarjax as sj
from sonarjax.cpu import CpuEngine


@cache
def engine() -> sj.Engine:
    """One engine for the process: it holds the compiled programs. `launch` tunes the process before anyone asks."""
    return CpuEngine() if jax.default_backend() == "cpu" else sj.Engine()
