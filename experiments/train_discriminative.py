"""How good is the paper's 'discriminative model'? The U-Net of a recipe on the same pairs, by cross-entropy alone.

python -m experiments.train_discriminative [--preset smoke] [--help]

The file that the recipe `cpu` leaves, <code>/training/weights.safetensors in the run's folder, is the baseline
`discriminative.safetensors` beside this script. An interrupted training goes on from its last checkpoint.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job, code_digest
from sonarjax.segment.training import Recipe, TrainResult, discriminative, find_recipe, train


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    recipe: Literal["smoke", "cpu", "paper"] = "cpu"
    """Whose networks and pairs; see `sonarjax train`."""


def run(settings: Settings, job: Job) -> Report:
    """The validation metrics after the last epoch, and where the weights are."""
    recipe = replace(discriminative(find_recipe(settings.recipe)), run_seed=job.seed)
    result = train_to_the_end(recipe, job.folder / code_digest() / "training")  # never on from other code's checkpoint
    return {"metrics": result.metrics, "weights": result.weights}


def train_to_the_end(recipe: Recipe, folder: Path) -> TrainResult:
    """Train from the last checkpoint in `folder`, if there is one. Raises KeyboardInterrupt when asked to stop."""
    result = train(recipe, folder, resume=True)
    if not result.finished:
        raise KeyboardInterrupt  # training has noted it and kept a checkpoint; `launch` says how to go on
    shutil.rmtree(folder / "checkpoints")  # they have served: started again, a finished run trains anew
    return result


def table(report: Report) -> str:
    """The metrics in a row."""
    metrics = report["metrics"]
    return f"{markdown(list(metrics), [list(metrics.values())])}\n\n{report['weights']}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"recipe": "smoke"})
