"""The folder of a run: its recipe, its files, and whether a run may be started or resumed there."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from pathlib import Path

import jax

from sonarjax.io import SonarjaxError, read_bytes, write_text
from sonarjax.io.files import reason
from sonarjax.segment.training.devices import anywhere
from sonarjax.segment.training.recipes import Recipe

CONFIG, METRICS, WEIGHTS, CHECKPOINTS = "config.json", "metrics.jsonl", "weights.safetensors", "checkpoints"
"""Names in the folder of a run."""
LIBRARIES = ("sonarjax", "jax", "jaxlib", "flax", "optax", "numpy")


def open_run(recipe: Recipe, run_dir: Path, resume: bool) -> None:
    """Make `run_dir` the folder of a run of `recipe`. All processes call it; the first one writes.

    If `resume` is true and the folder holds no run, a new run is started.

    Raises:
        SonarjaxError: The folder holds a run and `resume` is false, its run has another recipe, it holds such files of
            something else, or it cannot be used.
    """
    error: SonarjaxError | None = None
    if jax.process_index() == 0:
        try:
            _open(recipe, run_dir, resume)
        except SonarjaxError as caught:
            error = caught
    if anywhere(error is not None):
        raise error or SonarjaxError(f"{run_dir}: another process could not use it")


def _open(recipe: Recipe, run_dir: Path, resume: bool) -> None:
    config = run_dir / CONFIG
    try:
        begun = config.exists()
        if not begun:
            _check_unused(run_dir)
        (run_dir / "samples").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SonarjaxError(f"{run_dir}: cannot be used for a run: {reason(error)}") from error
    if begun and not resume:
        raise SonarjaxError(f"{run_dir}: already holds a run: resume it, or choose another folder")
    if begun:
        _check_same(recipe, config)
    else:
        write_text(config, json.dumps({"recipe": recipe.as_json(), "versions": versions()}, indent=2) + "\n")


def _check_unused(run_dir: Path) -> None:
    """Raise a SonarjaxError if a new run would change or continue what another program left in its folder."""
    for name in (METRICS, WEIGHTS, CHECKPOINTS):
        if (run_dir / name).exists():
            raise SonarjaxError(f"{run_dir}: holds {name} of something else (no {CONFIG}): expected another folder")


def _check_same(recipe: Recipe, config: Path) -> None:
    try:
        there = json.loads(read_bytes(config))["recipe"]
        wanted = recipe.as_json()
        differing = sorted(k for k in wanted.keys() | there.keys() if wanted.get(k) != there.get(k))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SonarjaxError(f"{config}: expected the recipe of a run") from error
    if differing:
        raise SonarjaxError(f"{config}: expected the recipe of this run, these fields differ: {', '.join(differing)}")


def versions() -> dict[str, str]:
    """Versions of Python and of the libraries on which a run's result depends."""
    found = {"python": platform.python_version(), "backend": jax.default_backend()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found
