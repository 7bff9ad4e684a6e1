"""How fast pix2pix trains and answers, beside the same networks and step in PyTorch.

python -m experiments.bench_train [--smoke]: prints one table; `run` returns its numbers. Each side runs in processes of
its own, which keep their memory (see `segment.memory`), in turn with the other and on all cores; of several rounds the
fastest step counts, since other programs only ever slow one down. Where they never rest, --one-core gives each side one
core and counts the processor's time that it takes. PyTorch is optional: without it ours is timed alone. The last line
says how fast training pairs are made.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.bench_render import parse
from sonarjax.segment.memory import keep_memory

PROJECT = Path(__file__).resolve().parent.parent
WORK = ("training", "inference", "one patch")
PAIRS = 128


@dataclass(frozen=True)
class Settings:
    """What is timed; every field is a command line option."""

    widths: tuple[int, ...] = (16, 32, 64)
    """Channels of the first layer of both networks."""
    batch: int = 8
    """Patches in a step, and in a batch of inference."""
    steps: int = 8
    """Steps of training, calls of inference, and four times as many of one patch, in each round."""
    rounds: int = 3
    """Rounds; each runs every contender once."""
    one_core: bool = False
    """Processor time on one core instead of the clock on all: for a machine that others use too."""
    side: str = ""
    """For the processes that this one starts: `ours`, `torch` or `pairs`."""
    smoke: bool = False
    """A run of seconds: width 4, one round of two steps."""


def fastest(function: Callable[[], Any], count: int, one_core: bool) -> float:
    """Seconds of the fastest of `count` calls, after one that is not counted."""
    clock = time.process_time if one_core else time.perf_counter
    function()
    seconds = []
    for _ in range(count):
        start = clock()
        function()
        seconds.append(clock() - start)
    return min(seconds)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def examples(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random images and maps (count, 128, 128, 1) in [-1, 1]: what is in them does not matter here."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, (2, count, 128, 128, 1)).astype(np.float32)
    return x, y


def time_ours(width: int, settings: Settings) -> list[float]:
    """Seconds of a training step, of inference on a batch and on one patch."""
    import jax

    from sonarjax.segment.step import GanConfig, create_state, train_step
    from sonarjax.segment.weights import GeneratorWeights, segment_patch

    config = GanConfig(width=width, discriminator_width=width)
    state = create_state(config, key=jax.random.key(0))
    x, y = (jax.device_put(v) for v in examples(settings.batch))

    def step() -> None:
        nonlocal state
        state, losses = train_step(state, x, y, key=jax.random.key(1))
        jax.block_until_ready((state, losses))

    timed = partial(fastest, one_core=settings.one_core)
    training = timed(step, settings.steps)
    weights = GeneratorWeights(state.weights(), config.generator())
    batch, one = (x[..., 0] + 1) / 2, (x[:1, ..., 0] + 1) / 2
    inference = timed(lambda: segment_patch(weights, batch).block_until_ready(), settings.steps)
    patch = timed(lambda: segment_patch(weights, one).block_until_ready(), 4 * settings.steps)
    return [training, inference, patch]


def time_torch(width: int, settings: Settings) -> list[float]:
    """The same of PyTorch, in whichever of its two memory layouts is faster for each."""
    import torch

    from experiments import torch_pix2pix as peer

    torch.set_num_threads(cores())
    timed, found = partial(fastest, one_core=settings.one_core), []
    for layout in (torch.contiguous_format, torch.channels_last):
        trainer = peer.Trainer(width, layout)
        x, y = (torch.tensor(v).permute(0, 3, 1, 2).contiguous(memory_format=layout) for v in examples(settings.batch))
        training = timed(lambda t=trainer, a=x, b=y: t.step(a, b), settings.steps)
        inference = timed(lambda t=trainer, a=x: t.infer(a), settings.steps)
        one = x[:1].contiguous(memory_format=layout)
        patch = timed(lambda t=trainer, a=one: t.infer(a), 4 * settings.steps)
        found.append([training, inference, patch])
    return [min(pair) for pair in zip(*found, strict=True)]


def time_pairs(_: int, settings: Settings) -> list[float]:
    """Seconds of one training pair, made among `PAIRS` at once."""
    import jax

    from sonarjax._cache import enable_compilation_cache
    from sonarjax.data import make_pairs, split_key

    enable_compilation_cache()  # they take minutes to compile
    key = split_key(0, "train")
    return [fastest(lambda: jax.block_until_ready(make_pairs(PAIRS, key=key)), 2, settings.one_core) / PAIRS]


def in_process(side: str, width: int, settings: Settings) -> list[float]:
    """The three times of one side, measured by a fresh process that has the cores to itself."""
    command = [sys.executable, "-m", "experiments.bench_train", "--side", side, "--widths", str(width)]
    command += ["--batch", str(settings.batch), "--steps", str(settings.steps)]
    command += ["--one-core"] if settings.one_core else []
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{side}, width {width}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def run(settings: Settings) -> dict[str, Any]:
    """Seconds, images/s and ratios (ours over PyTorch's, in images/s) of each width and kind of work."""
    if settings.smoke:
        settings = replace(settings, widths=(4,), batch=2, steps=2, rounds=1)
    sides = ("ours", "torch") if importlib.util.find_spec("torch") else ("ours",)
    load, rows = os.getloadavg()[0], []
    for width in settings.widths:
        rounds: dict[str, list[list[float]]] = {side: [] for side in sides}
        for _ in range(settings.rounds):
            for side in sides:
                rounds[side].append(in_process(side, width, settings))
        best = {side: np.min(times, 0).tolist() for side, times in rounds.items()}
        for k, work in enumerate(WORK):
            seconds = {side: best[side][k] for side in sides}
            rows.append({"width": width, "work": work, "seconds": seconds, "images": _images(seconds, work, settings)})
    used = 1 if settings.one_core else cores()
    pairs = math.nan if settings.smoke else 1 / in_process("pairs", 0, settings)[0]
    return {"rows": rows, "pairs": pairs, "batch": settings.batch, "load": (load, os.getloadavg()[0]), "cores": used}


def _images(seconds: dict[str, float], work: str, settings: Settings) -> dict[str, float]:
    count = 1 if work == "one patch" else settings.batch
    return {side: count / value for side, value in seconds.items()}


def ratio(row: dict[str, Any]) -> float:
    """Ours over PyTorch's images/s; NaN without PyTorch."""
    return row["images"]["ours"] / row["images"].get("torch", float("nan"))


def table(report: dict[str, Any]) -> str:
    """The report as text, one line for each width and kind of work."""
    before, after = report["load"]
    lines = [
        f"pix2pix, 128 x 128, batch {report['batch']}, {report['cores']} core(s) (load {before:.1f} to {after:.1f})",
        f"{'width':>5} {'work':<10} {'ours [ms]':>10} {'images/s':>9} {'torch [ms]':>11} {'images/s':>9} {'ratio':>6}",
    ]
    for row in report["rows"]:
        seconds, images = row["seconds"], row["images"]
        there = seconds.get("torch", float("nan")), images.get("torch", float("nan"))
        lines.append(
            f"{row['width']:>5} {row['work']:<10} {1e3 * seconds['ours']:>10.2f} {images['ours']:>9.1f}"
            f" {1e3 * there[0]:>11.2f} {there[1]:>9.1f} {ratio(row):>6.2f}"
        )
    lines.append(f"training pairs: {report['pairs']:.0f} made a second")
    return "\n".join(lines)


def main(settings: Settings) -> None:
    """Print the table, or in a process of one side its three times."""
    if settings.side:
        if settings.one_core and hasattr(os, "sched_setaffinity"):  # before either library starts its threads
            os.sched_setaffinity(0, [max(os.sched_getaffinity(0))])
        keep_memory()  # as training does; for both sides
        side = {"ours": time_ours, "torch": time_torch, "pairs": time_pairs}[settings.side]
        print(json.dumps(side(settings.widths[0], settings)))
    else:
        print(table(run(settings)))


if __name__ == "__main__":
    main(parse(Settings, __doc__))
