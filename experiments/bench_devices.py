"""What does an accelerator gain? Rendering, matching, refinement, the network and training on it and on the CPU beside.

python -m experiments.bench_devices [--preset smoke] [--help]

One side after the other on one machine, in processes of their own: JAX's own choice of device, then the CPU on all
cores, set up as `recognize` sets it up. Compilation is not counted. Where JAX finds no accelerator, the table says so
and has the CPU alone. The last column is how far the results of the two sides are apart.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import ROOT, Job
from sonarjax.io import SonarjaxError

CPU, ACCELERATOR = "cpu", "accelerator"
SIDE = "from experiments import bench_devices; bench_devices.one_part()"  # what a process of one side runs
SMOKE = {"views": 12, "batch": 2, "images": 2, "pairs": 8, "widths": (4,), "repeats": 1}

Work = tuple[str, int, Callable[[], Any]]
"""What is done, how many items a call makes, and the call."""


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    views: int = 360
    """Views of the bank that is rendered, and templates that are matched."""
    batch: int = 32
    """Frames that are refined at once."""
    images: int = 32
    """Images in a step of training, and patches of a batch."""
    pairs: int = 256
    """Training pairs that are made at once."""
    widths: tuple[int, ...] = (16, 64)
    """Channels of the first layer of the networks."""
    repeats: int = 5
    """Calls of each; the fastest counts."""
    sides: tuple[Literal["accelerator", "cpu"], ...] = (ACCELERATOR, CPU)
    """Which sides are timed."""


def rendering(settings: Settings) -> Iterator[Work]:
    """The paper's target: a bank of views, then the bank matched with a frame."""
    import jax

    from experiments.bench_match import Settings as MatchSettings
    from experiments.bench_match import frame_with
    from experiments.bench_render import X_M, make_sonar
    from experiments.common.engine import engine
    from sonarjax.match import match_bank, prepare_bank
    from sonarjax.render import template_bank
    from sonarjax.scene.objects import target

    count, sonar = settings.views, make_sonar()
    yaws = np.arange(count) * (2 * np.pi / count)

    def bank() -> np.ndarray:
        return np.asarray(template_bank(target(), sonar, yaws, x=X_M, engine=engine()).templates)

    yield "a view of a bank", count, bank
    templates = bank()
    frame = frame_with(templates[count // 3], MatchSettings(), 0)
    prepared = jax.block_until_ready(prepare_bank(templates, sonar.shape))
    yield "a template matched", count, lambda: np.asarray(match_bank(frame, prepared))


def refinement(settings: Settings) -> Iterator[Work]:
    """`refine_yaw` of one frame, and of a batch of frames at once."""
    from experiments.bench_refine import Settings as RefineSettings
    from experiments.bench_refine import make_frames, make_sonar, refinements, target

    chosen = RefineSettings(batch=settings.batch, hypotheses=1)
    mesh, sonar = target(), make_sonar()
    frames, poses = make_frames(mesh, sonar, settings.batch, chosen.noise, 0)
    for name, (count, call) in refinements(mesh, sonar, frames, poses, chosen, 0).items():
        yield name, count, lambda call=call: np.rad2deg(call().yaw)


def networks(settings: Settings) -> Iterator[Work]:
    """Training pairs, a patch segmented by the shipped network, and training steps."""
    import jax

    from experiments.bench_train import examples
    from experiments.common.engine import engine
    from sonarjax.data import make_pairs, split_key
    from sonarjax.segment.step import GanConfig, create_state, train_step
    from sonarjax.segment.weights import load_generator, segment_patch

    yield (
        "a training pair",
        settings.pairs,
        lambda: np.asarray(make_pairs(settings.pairs, key=split_key(0, "train"), engine=engine()).image),
    )
    x, y = (jax.device_put(v) for v in examples(settings.images))
    shipped, some = load_generator(), (x[..., 0] + 1) / 2
    yield "a patch segmented", settings.images, lambda: np.asarray(segment_patch(shipped, some))
    dtype = "float32" if jax.default_backend() == "cpu" else "bfloat16"
    for width in settings.widths:
        state = [create_state(GanConfig(width=width, dtype=dtype), key=jax.random.key(0))]

        def step(state: list[Any] = state) -> None:
            state[0], losses = train_step(state[0], x, y, key=jax.random.key(1))
            jax.block_until_ready((state, losses))

        yield f"an image of a training step, width {width}", settings.images, step


PARTS = {"networks": networks, "rendering": rendering, "refinement": refinement}


def one_part() -> None:
    """What a process that `measured` starts does: a line of JSON for each work, and its results, in a folder."""
    import jax

    from sonarjax.cpu import keep_memory, tune

    settings, part, folder = Settings(**json.loads(sys.argv[1])), sys.argv[2], Path(sys.argv[3])
    if jax.default_backend() == "cpu":
        tune()
        keep_memory()
    with open(folder / f"{part}.jsonl", "w", encoding="utf-8") as lines:
        print(json.dumps({"device": jax.devices()[0].device_kind, "backend": jax.default_backend()}), file=lines)
        for number, (what, count, call) in enumerate(PARTS[part](settings)):
            result, seconds = call(), []
            for _ in range(settings.repeats):
                started = time.perf_counter()
                result = call()
                seconds.append(time.perf_counter() - started)
            if result is not None:
                np.save(folder / f"{part}{number}.npy", result)
            row = {"what": what, "milliseconds": 1e3 * min(seconds) / count, "results": f"{part}{number}.npy"}
            print(json.dumps(row), file=lines, flush=True)


def measured(side: str, settings: Settings, folder: Path) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """The device, and one row for each work; results are left in `folder`. Raises SonarjaxError."""
    folder.mkdir(parents=True, exist_ok=True)
    env = os.environ | ({"JAX_PLATFORMS": "cpu"} if side == CPU else {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"})

    def measure(part: str) -> list[dict[str, Any]]:
        command = [sys.executable, "-c", SIDE, json.dumps(asdict(settings)), part, str(folder)]
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SonarjaxError(f"{side}, {part}: {done.stderr[-2000:]}")
        return [json.loads(line) for line in (folder / f"{part}.jsonl").read_text(encoding="utf-8").splitlines()]

    found = [measure(part) for part in PARTS]  # one after another: each has the device to itself
    return found[0][0], [row for rows in found for row in rows[1:]]


def run(settings: Settings, job: Job) -> Report:
    """Milliseconds of each item on both sides, and how far their results are apart."""
    found = {side: measured(side, settings, job.folder / side) for side in settings.sides}
    if found.get(ACCELERATOR, ({}, []))[0].get("backend") == "cpu":
        del found[ACCELERATOR]  # JAX has none
    rows = {side: rows for side, (_, rows) in found.items()}
    return {
        "rows": [_row(k, rows, job.folder) for k in range(len(next(iter(rows.values()))))],
        "devices": {side: about["device"] for side, (about, _) in found.items()},
        "cores": os.cpu_count(),
        "images": settings.images,
    }


def _row(number: int, found: dict[str, list[dict[str, Any]]], folder: Path) -> dict[str, Any]:
    first = next(iter(found.values()))[number]
    times = {side: rows[number]["milliseconds"] for side, rows in found.items()}
    row = {"what": first["what"], **times}
    files = [folder / side / first["results"] for side in times]
    if len(times) == 2:
        row["ratio"] = times[CPU] / times[ACCELERATOR]
        if all(file.exists() for file in files):
            apart = abs(np.subtract(*(np.load(file) for file in files)))
            row["apart"] = f"{np.median(apart):.1e}, {apart.max():.1e}"
    return row


def table(report: Report) -> str:
    """One line for each work."""
    devices = report["devices"]
    heads = {"what": "what", CPU: f"{report['cores']} cores [ms]"}
    if ACCELERATOR in devices:
        heads |= {ACCELERATOR: f"{devices[ACCELERATOR]} [ms]", "ratio": "times as fast"}
        heads["apart"] = "results apart: median, largest"
    shown = columns(report["rows"], heads)
    return shown if ACCELERATOR in devices else f"{shown}\n\nJAX finds no accelerator here: the CPU alone"


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
