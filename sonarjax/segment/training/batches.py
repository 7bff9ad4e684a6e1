"""Batch k of a run as a pure function of the recipe and k, whatever was made before. Resuming relies on this.

Pairs are made one set at a time. Another thread makes the next set while the networks train on this one.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from types import TracebackType
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import UInt8

from sonarjax.data import Pairs, import_pairs, make_pairs, split_key
from sonarjax.data.folder import STORED
from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.training.recipes import Recipe

AT_ONCE = 64  # pairs that are made between two checks of whether the run has ended


class Stored(NamedTuple):
    """Pairs as bytes."""

    image: UInt8[np.ndarray, "pair 128 128"]
    """Images, 0 to 255."""
    labels: UInt8[np.ndarray, "pair 128 128"]
    """0 background, 1 highlight, 2 shadow."""


class Batches:
    """The batches of a recipe, by number; a context manager that ends its thread."""

    def __init__(self, recipe: Recipe, engine: Engine = PLAIN) -> None:
        """Read the recipe's folder of pairs, if it has one; pairs that `engine` makes are made later.

        Raises SonarjaxError if the folder cannot be used.
        """
        self._recipe, self._engine = recipe, engine
        self._given = None if recipe.source is None else _imported(recipe)
        self._sets: dict[int, Future[Stored]] = {}
        self._over = threading.Event()
        self._maker = ThreadPoolExecutor(1, "pairs")

    def batch(self, step: int) -> Stored:
        """The pairs of step `step`, counted from 0."""
        recipe = self._recipe
        epoch, inside = divmod(step, recipe.epoch_steps)
        pairs = self._set(epoch // recipe.passes)
        part = slice(inside * recipe.batch, (inside + 1) * recipe.batch)
        rows, mirrored, plain = (values[part] for values in _order(recipe, epoch))
        image, labels = (_chosen(mirrored, layer[rows, :, ::-1], layer[rows]) for layer in pairs)
        return Stored(_chosen(plain, STORED[labels], image), labels)

    def validation(self) -> Stored:
        """The pairs of `validation_set`."""
        return validation_set(self._recipe, self._engine) if self._given is None else self._given[1]

    def _set(self, number: int) -> Stored:
        if self._given is not None:
            return self._given[0]
        for wanted in (number, number + 1):
            if wanted not in self._sets and wanted < self._recipe.sets:
                self._sets[wanted] = self._maker.submit(_make_set, self._recipe, wanted, self._over, self._engine)
        for old in [n for n in self._sets if n < number]:
            del self._sets[old]
        return self._sets[number].result()

    def __enter__(self) -> Batches:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._maker.shutdown(cancel_futures=True)


@lru_cache(2)
def _order(recipe: Recipe, epoch: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The order of the pairs in one epoch, which of them are mirrored, and which are plain.

    They depend on the seed and the number of the epoch only.
    """
    rng = np.random.Generator(np.random.Philox(key=[recipe.run_seed, epoch]))
    mirrored, plain = (rng.random(recipe.pairs) < share for share in (recipe.mirrored, recipe.plain))
    return rng.permutation(recipe.pairs), mirrored, plain


def _chosen(which: np.ndarray, images: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Images (pair, range, beam) from the first stack where `which` (pair,) is true, else from the second."""
    return np.where(which[:, None, None], images, others)


def _make_set(recipe: Recipe, number: int, over: threading.Event, engine: Engine) -> Stored:
    return _made(recipe, "train", number * recipe.pairs, recipe.pairs, over, engine)


def validation_set(recipe: Recipe, engine: Engine = PLAIN) -> Stored:
    """The validation pairs of a run: those of the validation split, or the last ones of the recipe's folder.

    Raises:
        SonarjaxError: The folder cannot be used.
    """
    if recipe.source is not None:
        return _imported(recipe)[1]
    return _made(recipe, "validation", 0, recipe.validation_pairs, threading.Event(), engine)


def _made(recipe: Recipe, split: str, first: int, count: int, over: threading.Event, engine: Engine) -> Stored:
    key = split_key(recipe.run_seed, split)
    parts = []
    for start in range(0, count, AT_ONCE):
        if over.is_set():
            break
        size = min(AT_ONCE, count - start)
        parts.append(_stored(make_pairs(size, recipe.pair_settings, key=key, first=first + start, engine=engine)))
    return Stored(*(np.concatenate(part) for part in zip(*parts, strict=True))) if parts else Stored(*_nothing())


def _nothing() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((0, 128, 128), np.uint8), np.zeros((0, 128, 128), np.uint8)


def _stored(pairs: Pairs) -> Stored:
    image, labels = jax.device_get((pairs.image, pairs.labels))
    return Stored(np.rint(255 * image).astype(np.uint8), labels)


def _imported(recipe: Recipe) -> tuple[Stored, Stored]:
    """The folder's pairs: those for training, and copies of those for validation."""
    assert recipe.source is not None
    stored = _stored(import_pairs(recipe.source))
    wanted = recipe.pairs + recipe.validation_pairs
    if len(stored.image) < wanted:
        raise SonarjaxError(f"{recipe.source}: expected {wanted} pairs or more, got {len(stored.image)}")
    train, validation = slice(recipe.pairs), slice(-recipe.validation_pairs, None)
    return Stored(*(v[train] for v in stored)), Stored(*(v[validation].copy() for v in stored))
