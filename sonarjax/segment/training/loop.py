"""`train`: follow a recipe from its first step, or from the last checkpoint, to weights that can be shipped.

A run is a pure function of its recipe: the state after k steps does not depend on how often it was interrupted.
"""

from __future__ import annotations

import math
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.random import fold_in
from jax.sharding import Mesh
from tqdm import tqdm

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind
from sonarjax.io.outputs import check_folder
from sonarjax.segment.generator import Generator
from sonarjax.segment.step import GanState, create_state, with_generator
from sonarjax.segment.tiled import TILE
from sonarjax.segment.training.batches import Batches, Stored
from sonarjax.segment.training.checkpoint import Checkpoints
from sonarjax.segment.training.devices import (
    anywhere,
    copied,
    device_mesh,
    join_processes,
    local_copy,
    make_step,
    place_batch,
    place_state,
)
from sonarjax.segment.training.evaluate import contact_sheet, predict_all, score
from sonarjax.segment.training.journal import Journal
from sonarjax.segment.training.recipes import Recipe, find_recipe
from sonarjax.segment.training.run import CHECKPOINTS, WEIGHTS, open_run, versions
from sonarjax.segment.training.signals import StopWish
from sonarjax.segment.weights import INPUT, GeneratorWeights, load_generator, save_generator

FIRST_WEIGHTS, DROPOUT = 11, 12  # folded into the seed's key; 1 to 3 are those of pairs


@dataclass(frozen=True)
class TrainResult:
    """How a run ended."""

    step: int
    """Number of steps done."""
    finished: bool
    """False if the run was asked to stop before its last step."""
    metrics: dict[str, float]
    """Validation metrics after the last epoch; empty before the first."""
    weights: Path | None
    """File of the averaged generator; None before the last step."""


def train(
    preset: str | Recipe, run_dir: str | os.PathLike[str], resume: bool = False, *, engine: Engine = PLAIN
) -> TrainResult:
    """Train the networks of a recipe, and leave checkpoints, records and weights in `run_dir`.

    Runs on all devices and, if set up as in `devices`, on all processes. Ctrl-C or SIGTERM ends the run after the
    current step, with a checkpoint. On a CPU, `sonarjax.cpu.keep_memory()` before the first step saves a third of the
    time.

    Args:
        preset: A recipe, or its name in `PRESETS`.
        run_dir: Folder of the run. For a new run it may hold other files, but none that a run would write over.
        resume: Continue a run from its last checkpoint, to the same weights.
        engine: Makes the pairs: on a CPU use `sonarjax.cpu.CpuEngine()`.

    Returns:
        How the run ended.

    Raises:
        SonarjaxError: The recipe or the folder cannot be used; or a loss is not finite or has diverged, in which case
            the last checkpoint before that is kept.
    """
    recipe = find_recipe(preset)
    check_kind(engine, Engine, "engine")
    check_folder(run_dir, "run_dir")
    join_processes()
    folder = Path(run_dir)
    first = _initial_weights(recipe)
    with StopWish() as wish, Batches(recipe, engine) as batches:  # a folder of pairs is read before the run begins
        open_run(recipe, folder, resume)
        with Checkpoints(folder / CHECKPOINTS) as checkpoints:
            return _Run(recipe, folder, checkpoints, batches, wish, first).finish()


def _initial_weights(recipe: Recipe) -> GeneratorWeights | None:
    """The generator that training begins with; None for a random one.

    Raises SonarjaxError if the file cannot be read, or holds a network other than the recipe's.
    """
    file = recipe.initial_weights
    if file is None:
        return None
    first = load_generator(file)
    wanted, got = _properties(recipe.networks.generator()), _properties(first.module)
    for name, value in wanted.items():
        if got[name] != value:
            raise SonarjaxError(f"{os.fspath(file)}: {name}: expected {value}, as in the recipe, got {got[name]}")
    return first


def _properties(network: Generator) -> dict[str, object]:
    """What two networks must share for the weights of one to fit the other."""
    channels = [network.width * multiplier for multiplier in network.multipliers]
    return {"channels": channels, "head": network.head, "skips": network.skips, "inputs": network.inputs}


class _Run:
    """One call of `train`: the state of training and the folder where it is kept."""

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        checkpoints: Checkpoints,
        batches: Batches,
        wish: StopWish,
        first: GeneratorWeights | None,
    ) -> None:
        self.recipe, self.folder, self.checkpoints, self.batches, self.wish = recipe, folder, checkpoints, batches, wish
        self.mesh: Mesh = device_mesh(recipe.batch)
        key = jax.random.key(recipe.run_seed)
        self.dropout = np.asarray(jax.random.key_data(fold_in(key, DROPOUT)))
        self.state = self._first_state(first, key)
        self.step = int(local_copy(self.state.step))
        self.losses: dict[str, float] = {}
        self.metrics: dict[str, float] = {}
        self.validation: Stored | None = None

    def _first_state(self, first: GeneratorWeights | None, key: jax.Array) -> GanState:
        state = create_state(self.recipe.networks, key=fold_in(key, FIRST_WEIGHTS))
        if self.checkpoints.latest is not None:
            return self.checkpoints.restore(state, copied(self.mesh))
        return place_state(state if first is None else with_generator(state, first.variables), self.mesh)

    def finish(self) -> TrainResult:
        """Train up to the last step, or until a stop is requested."""
        recipe, chief = self.recipe, jax.process_index() == 0
        advance = make_step(recipe, self.mesh)
        if self.step == recipe.steps:  # the run was killed after its last step
            self.metrics = self._evaluate()[0]
        with (
            Journal(self.folder, self.step, writes=chief) as journal,
            tqdm(
                total=recipe.steps, initial=self.step, unit="step", file=sys.stderr, disable=not chief,
                mininterval=0.5 if sys.stderr.isatty() else 30.0, desc=recipe.name,
            ) as bar,
        ):  # fmt: skip
            started, first = time.perf_counter(), self.step
            while self.step < recipe.steps:
                batch = place_batch(self.batches.batch(self.step), self.mesh)
                self.state, losses = advance(self.state, *batch, self.dropout)
                self.step += 1
                bar.update()
                if self._due(recipe.log_steps):
                    self.losses = self._look_at(losses)
                    rate = (self.step - first) * recipe.batch / (time.perf_counter() - started)
                    bar.set_postfix({k: f"{v:.3f}" for k, v in self.losses.items()} | {"images/s": f"{rate:.0f}"})
                    curves = {f"loss/{k}": v for k, v in self.losses.items()}
                    journal.scalars(curves | {"images_per_second": rate}, self.step)
                if self._mark(journal, losses):
                    break
        finished = self.step == recipe.steps
        return TrainResult(self.step, finished, self.metrics, self._write_weights() if finished else None)

    def _due(self, every: int) -> bool:
        return self.step % every == 0 or self.step % self.recipe.epoch_steps == 0

    def _mark(self, journal: Journal, losses: dict[str, jax.Array]) -> bool:
        """End an epoch and keep a checkpoint if they are due. Returns True if a stop is requested."""
        # Several processes must exchange a message to agree on a stop, so they ask less often.
        asks = jax.process_count() == 1 or self._due(self.recipe.log_steps)
        stop = asks and anywhere(self.wish.wished)
        if self.step % self.recipe.epoch_steps == 0:
            self.metrics, grey = self._evaluate()
            assert self.validation is not None
            epoch = self.step // self.recipe.epoch_steps
            values = {f"loss_{name}": value for name, value in self.losses.items()}
            journal.epoch(epoch, self.step, values | self.metrics, contact_sheet(grey, self.validation))
        if stop or self.step % self.recipe.checkpoint_steps == 0 or self.step == self.recipe.steps:
            self._look_at(losses)  # so that no diverged state is kept, however rarely losses are logged
            if not _all_finite(local_copy(self.state)):
                raise self._diverged("a weight is not finite")
            self.checkpoints.save(self.state, self.step)
        return stop

    def _look_at(self, losses: dict[str, jax.Array]) -> dict[str, float]:
        """The losses as numbers. Raises SonarjaxError if one is not finite or too large."""
        values = {name: float(local_copy(value)) for name, value in losses.items()}
        for name, value in values.items():
            if not math.isfinite(value) or abs(value) > self.recipe.largest_loss:
                raise self._diverged(f"the loss `{name}` is {value:g}")
        return values

    def _diverged(self, what: str) -> SonarjaxError:
        kept = self.checkpoints.latest
        last = "there is no checkpoint yet" if kept is None else f"the last good checkpoint is from step {kept}"
        advice = "resuming would fail again: start in a new folder with a lower learning_rate"
        return SonarjaxError(f"{self.folder}: training stopped at step {self.step}: {what}; {last}; {advice}")

    def _evaluate(self) -> tuple[dict[str, float], np.ndarray]:
        """Validation metrics of the averaged generator, and its semantic maps."""
        if self.validation is None:
            self.validation = self.batches.validation()
        weights = local_copy(self.state.weights())
        grey = predict_all(self.recipe.networks, weights, self.validation)
        return score(grey, self.validation), grey

    def _write_weights(self) -> Path:
        """Write the averaged generator to a file; only the first process does."""
        path = self.folder / WEIGHTS
        if jax.process_index() == 0:
            weights = jax.device_get(local_copy(self.state.weights()))
            about = {
                "recipe": self.recipe.as_json(),
                "versions": versions(),
                "metrics": self.metrics,
                "step": self.step,
                "tile": TILE,
                "input": INPUT,
            }
            save_generator(path, weights, about)
        return path


def _all_finite(tree: Any) -> bool:
    return all(bool(np.isfinite(leaf).all()) for leaf in jax.tree.leaves(jax.device_get(tree)))
