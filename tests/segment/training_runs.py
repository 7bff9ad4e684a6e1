"""Tiny runs of training, here and in processes of their own.

`python -m tests.segment.training_runs FOLDER RUN [kill_at_step N | kill_in_save N]` trains on the pairs of FOLDER and
kills itself with SIGKILL at the start of step N, or while the checkpoint of step N or a later one is written.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
QUICK = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"  # conftest's, and code is not optimised


def tiny_recipe(folder, **changes):
    """Seconds of training on the pairs of `folder`: three epochs of four steps, a checkpoint after every second."""
    from sonarjax.segment.step import GanConfig
    from sonarjax.segment.training import Recipe

    networks = GanConfig(width=2, discriminator_width=2, multipliers=(1, 1, 1, 1, 1, 1, 1))
    usual = {"batch": 8, "pairs": 32, "passes": 3, "validation_pairs": 4, "checkpoint_steps": 2, "log_steps": 1}
    return Recipe(**({"networks": networks, "source": str(folder)} | usual | changes))


def plain_pairs(folder, count=36):
    """Pairs in `folder` without a simulator: a bright box with a dark one behind it, in noise."""
    import jax.numpy as jnp
    import numpy as np

    from sonarjax.data import Pairs, export_pairs

    rng = np.random.default_rng(0)
    labels = np.zeros((count, 128, 128), np.uint8)
    for number, (row, column) in enumerate(rng.integers(10, 60, (count, 2))):
        labels[number, row : row + 24, column : column + 50] = 1
        labels[number, row + 24 : row + 60, column : column + 50] = 2
    image = np.array([0.5, 0.9, 0.1])[labels] + 0.15 * rng.standard_normal(labels.shape)
    export_pairs(Pairs(jnp.asarray(np.clip(image, 0, 1), jnp.float32), jnp.asarray(labels)), folder)
    return folder


def start(*arguments, **environment):
    """This file in another process, with one device unless `environment` says otherwise."""
    usual = {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": QUICK, "PYTHONPATH": str(PROJECT)}
    return subprocess.Popen(
        [sys.executable, "-m", "tests.segment.training_runs", *map(str, arguments)],
        cwd=PROJECT,
        env=os.environ | usual | environment,
        stderr=subprocess.PIPE,
        text=True,
    )


def end(process, code=0):
    """Wait for a process that must end with `code`."""
    _, said = process.communicate(timeout=240)
    assert process.returncode == code, said[-3000:]


def recorded(run):
    """The lines of metrics.jsonl of a run."""
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def kill():
    """End this process as a power cut does."""
    os.kill(os.getpid(), signal.SIGKILL)


def kill_at_step(number):
    """From now on a process is killed that asks for batch `number`."""
    from sonarjax.segment.training.batches import Batches

    batch = Batches.batch

    def deadly(self, step):
        if step >= number:
            kill()
        return batch(self, step)

    Batches.batch = deadly


def kill_in_save(number):
    """From now on a process is killed that has begun to write the checkpoint of step `number` or later."""
    from sonarjax.segment.training.checkpoint import Checkpoints

    save = Checkpoints.save

    def deadly(self, state, step):
        if step >= number:
            before = set(os.listdir(self.folder))

            def watch():
                while set(os.listdir(self.folder)) == before:
                    time.sleep(0.0005)
                kill()

            threading.Thread(target=watch, daemon=True).start()
        save(self, state, step)

    Checkpoints.save = deadly


if __name__ == "__main__":
    pairs, run_dir, *order = sys.argv[1:]
    if order:
        {"kill_at_step": kill_at_step, "kill_in_save": kill_in_save}[order[0]](int(order[1]))
    import jax

    from sonarjax.segment.training import train

    train(tiny_recipe(pairs), run_dir, resume=True)
    found = {"devices": jax.device_count(), "processes": jax.process_count()}
    wanted = {name: int(os.environ.get(f"EXPECTED_{name.upper()}", 1)) for name in found}
    assert found == wanted, f"expected {wanted}, ran on {found}"
