"""How good do the paper's two networks get? Eq. 3 alone, 30 epochs of the 6,780 pairs of §3.1.

python -m experiments.train_paper [--seeds 0 1 2] [--preset smoke] [--help]
python -m experiments.train_paper --recipe cpu --alone       the 'discriminative model' of §2.2
python -m experiments.train_paper --recipe cpu --sets 3      a third of `cpu`, the short form of what ships

`--into experiments/paper-cpu.safetensors` made the file beside this script, from seed 0; its threshold is that of
`fit_threshold`. The second command trains the U-Net by cross-entropy alone; `discriminative.safetensors` is such a
network, of the pairs that the recipe `cpu` had before. An interrupted training goes on from its last checkpoint.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jax

from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, formatted
from experiments.common.runs import Job, code_digest
from experiments.common.trainings import train_to_the_end
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment.training import Recipe, discriminative, find_recipe
from sonarjax.segment.training.batches import Batches
from sonarjax.segment.training.evaluate import predict_all, score
from sonarjax.segment.weights import load_generator

HEADS = {
    "when": "after",
    "epoch": "epoch",
    "iou_mean": "IoU",
    "iou_highlight": "of highlight",
    "iou_shadow": "of shadow",
    "psnr_db": "PSNR [dB]",
    "psnr_gain_db": "gain [dB]",
}
SMALL = {"batch": 4, "pairs": 16, "passes": 2, "sets": 1, "validation_pairs": 8, "checkpoint_steps": 4}
"""What the smoke preset changes in the recipe, beside the width."""


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    recipe: Literal["paper-cpu", "paper", "cpu", "gpu"] = "paper-cpu"
    """Whose networks and pairs; see `sonarjax train`."""
    alone: bool = False
    """By cross-entropy alone, as the paper's 'discriminative model'."""
    sets: int = 0
    """Sets of pairs, fewer for a shorter training; 0 for the recipe's number."""
    small: bool = False
    """A training of seconds instead, which only shows that it runs."""
    into: str = ""
    """A file that is given the weights, with what the training cost; empty for none."""


def run(settings: Settings, job: Job) -> Report:
    """Metrics of the best and of the last epoch, those of all epochs, and how fast it was."""
    recipe = find_recipe(settings.recipe)
    recipe = replace(discriminative(recipe) if settings.alone else recipe, run_seed=job.seed)
    recipe = replace(recipe, sets=settings.sets or recipe.sets)
    if settings.small:
        recipe = replace(recipe, networks=replace(recipe.networks, width=4, discriminator_width=4), **SMALL)
    folder = job.folder / code_digest() / "training"  # never on from other code's checkpoint
    goes_on = (folder / "checkpoints").exists()  # else a finished training is begun anew
    before, started = len(_epochs(folder)) if goes_on else 0, time.perf_counter()
    result = train_to_the_end(recipe, folder)
    epochs = _epochs(folder)
    images = recipe.epoch_steps * recipe.batch
    rate = images * max(len(epochs) - before, 1) / (time.perf_counter() - started)
    best = max(epochs, key=lambda epoch: epoch["iou_mean"])
    cost = {"hours": images * len(epochs) / rate / 3600, "images_per_s": rate, "width": recipe.networks.width}
    cost["device"] = f"{os.cpu_count()} cores" if jax.default_backend() == "cpu" else jax.devices()[0].device_kind
    assert result.weights is not None
    known = {"when": "that one, on pairs it was trained on", "epoch": epochs[-1]["epoch"]}
    known |= _on_training_pairs(recipe, result.weights)
    if settings.into:
        arrays, about = read_safetensors(result.weights)
        write_safetensors(settings.into, arrays, about | {"cost": cost})
    return {
        "rows": [{"when": "the best epoch", **best}, {"when": "the last epoch", **epochs[-1]}, known],
        "epochs": epochs,
        "images": images * len(epochs),
        **cost,
        "batch": recipe.batch,
        "pairs": recipe.pairs,
        "weights": result.weights,
    }


def _epochs(folder: Path) -> list[dict[str, Any]]:
    """Losses and validation metrics of each epoch that a training has ended."""
    path = folder / "metrics.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def _on_training_pairs(recipe: Recipe, weights: Path) -> dict[str, float]:
    """The metrics on the first training pairs, as many as validate: how much of them was learnt by heart."""
    count = recipe.validation_pairs
    first = replace(recipe, pairs=count, batch=count, passes=1, mirrored=0.0, plain=0.0)
    with Batches(first, engine()) as batches:
        pairs = batches.batch(0)
    return score(predict_all(recipe.networks, load_generator(weights).variables, pairs), pairs)


def table(report: Report) -> str:
    """The two epochs, the last also on training pairs, and the cost."""
    rows = columns([row | {"epoch": formatted(row["epoch"], ".0f")} for row in report["rows"]], HEADS)
    hours, rate = formatted(report["hours"], ".2f"), formatted(report["images_per_s"], ".0f")
    cost = f"{report['images']:.0f} images in {hours} h, {rate} a second"
    return f"{rows}\n\nwidth {report['width']:.0f} on {report['device']}: {cost}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"small": True})
