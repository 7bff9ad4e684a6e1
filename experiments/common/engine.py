"""The engine that experiments compute with."""

from __future__ import annotations

from functools import cache

import sonarjax as sj
from sonarjax.cpu import usual_engine


@cache
def engine() -> sj.Engine:
    """One engine for the process: it holds the compiled programs. `launch` tunes the process before anyone asks."""
    return usual_engine()
