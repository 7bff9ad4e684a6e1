"""What every test shares: checked annotations, fixed precision and seeds, a compilation cache, the real data."""

from __future__ import annotations

import os
import random
from pathlib import Path

import jax
import jaxtyping
import numpy as np
import pytest

# Before sonarjax is imported by anything: every array argument and result is checked against its annotation.
jaxtyping.install_import_hook("sonarjax", "beartype.beartype")

# JAX writes cache entries in place, so a worker reading what another is writing would warn: one folder for each.
PROJECT = Path(__file__).resolve().parent.parent
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "main")
os.environ["SONARJAX_CACHE_DIR"] = str(PROJECT / ".pytest_cache" / f"xla-{WORKER}")

from sonarjax import cpu  # noqa: E402

cpu.use_quick_compiler()
cpu.enable_compilation_cache()
jax.config.update("jax_enable_x64", False)


@pytest.hookimpl(tryfirst=True)  # before the fixtures of a module, which compile too
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave code without optimisation, which halves the time of most tests: they compile more than they compute.

    Tests marked `computes` have their code optimised, but for what an earlier test of the same process has compiled.
    The processes that a test starts do as it does.
    """
    quick = item.get_closest_marker("computes") is None
    jax.config.update("jax_disable_most_optimizations", quick)
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(quick))


@pytest.fixture(autouse=True)
def _seeds() -> None:
    """The same draw in every run, for what draws without a key or a generator of its own (libraries do)."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002


@pytest.fixture
def key() -> jax.Array:
    """A fixed JAX random key."""
    return jax.random.key(0)


@pytest.fixture
def rng() -> np.random.Generator:
    """A fixed NumPy generator."""
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real sonar files; tests that use it skip where SONARJAX_REAL_DATA does not name one."""
    folder = os.environ.get("SONARJAX_REAL_DATA", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("SONARJAX_REAL_DATA names no folder of real sonar files")
    return Path(folder)
