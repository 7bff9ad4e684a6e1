"""How fast does pix2pix train and answer, beside the same networks and step in PyTorch?

python -m experiments.bench_train [--preset smoke] [--help]

Each side runs in processes of its own, which keep their memory (see `cpu.keep_memory`), in turn with the other
and on all cores; of several rounds the fastest step counts, since other programs only ever slow one down. Where they
never rest, --one-core gives each side one core and counts the processor's time that it takes. PyTorch is the extra
`peers`; --no-peer times ours alone. The last line says how fast training pairs are made.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.bench_match import has, need
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job
from sonarjax.cpu import cores, keep_memory, tune
from sonarjax.io import SonarjaxError

PROJECT = Path(__file__).resolve().parent.parent
SIDE = "from experiments import bench_train; bench_train.one_side()"  # what a process of one side runs
WORK = ("training", "inference", "one patch")
PAIRS = 128
SMOKE = {"widths": (4,), "batch": 2, "steps": 2, "rounds": 1, "pairs": False, "peer": has("torch")}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

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
    peer: bool = True
    """Time PyTorch too."""
    plain: bool = False
    """Time ours without `segment.winograd` too, which stays as long as training is 1.15 times as fast with it."""
    pairs: bool = True
    """Time the making of training pairs too."""


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


def time_plain(width: int, settings: Settings) -> list[float]:
    """As `time_ours`, with all layers as plain matrix products."""
    from sonarjax.segment import matmul, products

    products.scheme = lambda *_: matmul  # this process does nothing else
    return time_ours(width, settings)


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

    from experiments.common.engine import engine
    from sonarjax.data import make_pairs, split_key

    def make() -> None:
        jax.block_until_ready(make_pairs(PAIRS, key=split_key(0, "train"), engine=engine()))

    return [fastest(make, 2, settings.one_core) / PAIRS]


def in_process(side: str, width: int, settings: Settings) -> list[float]:
    """The times of one side, measured by a fresh process that has the cores to itself."""
    command = [sys.executable, "-c", SIDE, side, str(width), json.dumps(asdict(settings))]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SonarjaxError(f"{side}, width {width}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def one_side() -> None:
    """What a process that `in_process` starts does: print the times of its side."""
    side, width, settings = sys.argv[1], int(sys.argv[2]), Settings(**json.loads(sys.argv[3]))
    if settings.one_core and hasattr(os, "sched_setaffinity"):  # before either library starts its threads
        os.sched_setaffinity(0, [max(os.sched_getaffinity(0))])
    tune()
    keep_memory()  # as training does; for both sides
    print(json.dumps(SIDES[side](width, settings)))


SIDES = {"ours": time_ours, "plain": time_plain, "torch": time_torch, "pairs": time_pairs}
"""What a process may time."""
HEADS = {"ours": "ours", "plain": "without Winograd", "torch": "PyTorch"}


def run(settings: Settings, job: Job) -> Report:
    """Seconds and images/s of each side by width and kind of work, and pairs made a second."""
    if settings.peer:
        need("torch", "PyTorch")
    load = os.getloadavg()[0]
    found = job.map(lambda width: compare(width, settings), {f"width {w}": w for w in settings.widths}, "train")
    made = job.map(lambda _: 1 / in_process("pairs", 0, settings)[0], ["made"], "pairs") if settings.pairs else {}
    return {
        "rows": [row for rows in found.values() for row in rows],
        "pairs": made.get("made"),
        "batch": settings.batch,
        "load": [load, os.getloadavg()[0]],
        "cores": 1 if settings.one_core else cores(),
    }


def compare(width: int, settings: Settings) -> list[dict[str, Any]]:
    """One row for each kind of work at one width: the fastest of all rounds of each side."""
    sides = ["ours", *["plain"] * settings.plain, *["torch"] * settings.peer]
    rounds: dict[str, list[list[float]]] = {side: [] for side in sides}
    for _ in range(settings.rounds):
        for side in sides:
            rounds[side].append(in_process(side, width, settings))
    best = {side: np.min(times, 0).tolist() for side, times in rounds.items()}
    rows = []
    for k, work in enumerate(WORK):
        count = 1 if work == "one patch" else settings.batch
        seconds = {side: best[side][k] for side in sides}
        images = {side: count / value for side, value in seconds.items()}
        rows.append({"width": width, "work": work, "seconds": seconds, "images": images, "ratio": _ratio(images)})
    return rows


def _ratio(images: dict[str, float], other: str = "torch") -> float | None:
    """Ours over the other side's images/s."""
    return images["ours"] / images[other] if other in images else None


def table(report: Report) -> str:
    """One line for each width and kind of work."""
    before, after = report["load"]
    sides = [side for side in HEADS if side in report["rows"][0]["seconds"]]
    rows = []
    for row in report["rows"]:
        cells = [(f"{1e3 * row['seconds'][side]:.2f}", f"{row['images'][side]:.1f}") for side in sides]
        ratios = [_ratio(row["images"], side) for side in sides[1:]]
        rows.append([row["width"], row["work"], *(cell for pair in cells for cell in pair), *ratios])
    heads = [head for side in sides for head in (f"{HEADS[side]} [ms]", "images/s")]
    head = ("width", "work", *heads, *(f"ours / {HEADS[side]}" for side in sides[1:]))
    lines = [
        f"pix2pix, 128 × 128, batch {report['batch']}, {report['cores']} core(s) (load {before:.1f} to {after:.1f})",
        markdown(head, rows),
    ]
    return "\n".join(lines + ([f"\ntraining pairs: {report['pairs']:.0f} made a second"] if report["pairs"] else []))


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
