"""`sonarjax train`: train the pix2pix segmenter on simulated pairs."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from sonarjax.cli.frames import start_jax
from sonarjax.io import complain, say


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("train", help="train the pix2pix segmenter on simulated pairs")
    command.set_defaults(run=run)
    command.add_argument(
        "--preset", choices=("smoke", "cpu", "paper-cpu", "paper", "gpu", "further"), required=True,
        help="smoke: a short test run; cpu: the recipe of the shipped weights, shorter; paper-cpu: the paper's recipe "
        "(eq. 3 alone, 30 epochs) at width 16; paper: the same at full width, for a GPU; gpu: the recipe of the "
        "shipped weights; further: with --weights, on more varied objects",
    )  # fmt: skip
    command.add_argument(
        "--run-dir", metavar="RUN", required=True,
        help="output folder: checkpoints, TensorBoard events, metrics.jsonl, samples, weights.safetensors",
    )  # fmt: skip
    command.add_argument(
        "--weights", metavar="FILE",
        help="train this network further, instead of a new one: a weights file of the recipe's kind of network",
    )  # fmt: skip
    command.add_argument("--resume", action="store_true", help="continue from the last checkpoint in RUN, if any")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    start_jax()
    from sonarjax.cpu import keep_memory, usual_engine
    from sonarjax.segment.training import find_recipe, train
    from sonarjax.segment.training.devices import join_processes

    keep_memory()  # allocating a step's memory anew would take a third of the step
    join_processes()  # before anything asks JAX for its devices, as the choice of an engine does
    recipe = replace(find_recipe(args.preset), initial_weights=args.weights)
    result = train(recipe, args.run_dir, resume=args.resume, engine=usual_engine())
    if not result.finished:
        complain(f"stopped after step {result.step}; --resume continues from there", "")
        return 130
    say(f"{result.weights}: " + ", ".join(f"{name} {value:.3f}" for name, value in result.metrics.items()))
    return 0
