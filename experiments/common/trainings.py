"""Trainings of the paper's recipe that differ in one thing: eq. 3's normaliser and λ, the discriminator, the output.

The full form is the recipe `paper-cpu` at a third of its length: width 16, 10 epochs of the 6,780 pairs of §3.1.
`--recipe paper` takes batches and number type of the recipe for GPUs, `--width 64` also its width. A short form, such
as `--width 8 --pairs 512 --images 2048`, says what helps early, not where trainings end. All variants see as
many images as there are full passes for: at full length four times the pairs are seen a fifth less often. All are
judged on the same validation pairs. An interrupted training goes on from its checkpoint, and one that has ended is
kept.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.engine import engine
from sonarjax.data import export_pairs, make_pairs, split_key
from sonarjax.data.folder import MANIFEST
from sonarjax.data.pairs import PAPER_PAIRS, PAPER_SETTINGS
from sonarjax.segment import training
from sonarjax.segment.classical import to_grey
from sonarjax.segment.training import Recipe, TrainResult, find_recipe
from sonarjax.segment.training.batches import validation_set
from sonarjax.segment.training.evaluate import predict_all
from sonarjax.segment.weights import load_generator

VARIANTS: dict[str, dict[str, Any]] = {
    "eq. 3": {},
    "N per image": {"normaliser": "per_image"},
    "λ 10": {"distance": 10.0},
    "λ 0": {"distance": 0.0},
    "no discriminator": {"adversarial": 0.0},
    "classes": {"head": "classes"},
    "shipped loss": {"head": "classes", "adversarial": 0.25, "cross_entropy": 20.0},
    "cross-entropy alone": {"head": "classes"},
    "no skips": {"skips": False},
}
"""What each variant changes in the networks or in eq. 3, which has N affine, λ = 100 and grey output by tanh.
`classes` puts out three classes' logits; `shipped loss` has cross-entropy beside eq. 3 then, as the shipped network,
and `cross-entropy alone` is the paper's discriminative model."""
ALONE = "cross-entropy alone"
SIZES = {"a quarter of the pairs": 0.25, "four times the pairs": 4.0}
"""What others change, if asked for: how many different pairs there are, seen more or less often."""


@dataclass(frozen=True)
class Trainings:
    """How large the trainings are."""

    recipe: Literal["paper-cpu", "paper"] = "paper-cpu"
    """Whose pairs, batches and networks (training)."""
    width: int = 16
    """Channels of the first layer of both networks (training)."""
    images: int = 10 * PAPER_PAIRS
    """Images that each training sees."""
    pairs: int = PAPER_PAIRS
    """Different pairs among them, where the variant says nothing else (training)."""
    validation_pairs: int = 256
    """Pairs that judge all variants (training)."""
    batch: int = 0
    """Pairs in a step; 0 for the recipe's number (training)."""


def share_pairs(folder: Path, settings: Trainings, seed: int) -> None:
    """Keep the usual pairs in `folder`, and those that judge behind them: made once, they serve all variants."""
    if (folder / MANIFEST).exists():
        return
    counts = {"train": settings.pairs, "validation": settings.validation_pairs}
    made = [
        make_pairs(count, PAPER_SETTINGS, key=split_key(seed, split), engine=engine())
        for split, count in counts.items()
    ]
    export_pairs(jax.tree.map(lambda *parts: jnp.concatenate(parts), *made), folder)


def recipe_of(variant: str, settings: Trainings, seed: int, shared: Path) -> Recipe:
    """The training of a variant of the paper's recipe, on the pairs in `shared`, or the first of them.

    Where there are more, the same and others are made again, the usual number in each set.
    """
    pairs = round(settings.pairs * SIZES.get(variant, 1.0))
    each = min(pairs, settings.pairs)
    recipe = find_recipe(settings.recipe)
    widths = {"width": settings.width, "discriminator_width": settings.width}
    return replace(
        recipe,
        name=variant,
        networks=replace(recipe.networks, **widths, **VARIANTS.get(variant, {})),
        discriminative=variant == ALONE,
        run_seed=seed,
        batch=settings.batch or recipe.batch,
        pairs=each,
        passes=max(settings.images // pairs, 1),
        sets=pairs // each,
        source=str(shared) if pairs == each else None,
        validation_pairs=settings.validation_pairs,
    )


def train_to_the_end(recipe: Recipe, folder: Path) -> TrainResult:
    """Train from the last checkpoint in `folder`, if there is one. Raises KeyboardInterrupt when asked to stop."""
    result = training.train(recipe, folder, resume=True)
    if not result.finished:
        raise KeyboardInterrupt  # training has noted it and kept a checkpoint; `launch` says how to go on
    shutil.rmtree(folder / "checkpoints")  # they have served: started again, a finished run trains anew
    return result


def train(variant: str, settings: Trainings, shared: Path, seed: int) -> dict[str, Any]:
    """Validation metrics at the end, eq. 3's distance on the same pairs (N affine), and the curve of each metric.

    The checkpoints lie beside the folder `shared` of pairs.
    """
    recipe, folder = recipe_of(variant, settings, seed, shared), shared.with_name(variant.replace(" ", "_"))
    result = train_to_the_end(recipe, folder)
    assert result.weights is not None
    validation = validation_set(recipe_of("eq. 3", settings, seed, shared))
    grey = predict_all(recipe.networks, load_generator(result.weights).variables, validation)
    # Grey runs from 0 to 1 where eq. 3 has −1 to 1, which the affine N halves again: one difference.
    distance = float(np.abs(grey - to_grey(validation.labels)).mean())
    counts = {"pairs": recipe.pairs * recipe.sets, "passes": recipe.passes}
    return result.metrics | {"distance": distance} | counts | {"curve": _curve(folder, recipe.batch)}


def _curve(folder: Path, batch: int) -> dict[str, list[float]]:
    """Images seen, and the losses and validation metrics after each epoch, by name: lists (epoch,)."""
    lines = (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    epochs = [json.loads(line) for line in lines]
    named = {name: [float(epoch[name]) for epoch in epochs] for name in epochs[0] if name not in ("epoch", "step")}
    return {"images": [float(epoch["step"] * batch) for epoch in epochs]} | named
