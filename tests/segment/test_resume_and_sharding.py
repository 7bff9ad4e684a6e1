"""However it is run, a recipe gives the same: killed and resumed bit for bit, on many devices to rounding.

Two processes are in test_many_machines.
"""

from __future__ import annotations

import os
import secrets
import signal

import jax
import numpy as np
import pytest
from safetensors.numpy import load_file

from sonarjax.segment.step import create_state
from sonarjax.segment.training import train
from sonarjax.segment.training.checkpoint import Checkpoints
from sonarjax.segment.training.devices import copied, device_mesh
from tests.segment.training_runs import QUICK, end, plain_pairs, recorded, start, tiny_recipe

pytestmark = pytest.mark.slow  # processes that train; test_train stops and goes on within one
EIGHT = f"{QUICK} --xla_force_host_platform_device_count=8"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return plain_pairs(tmp_path_factory.mktemp("pairs") / "plain")


@pytest.fixture(scope="module")
def alone(folder, tmp_path_factory):
    """A run that was left alone, on one device."""
    run = tmp_path_factory.mktemp("runs") / "alone"
    end(start(folder, run))
    return run


def test_killed_at_random_steps_and_resumed(folder, alone, tmp_path):
    # The one test whose draw is new each time. What is printed is shown when it fails; the seed set so repeats it.
    seed = int(os.environ.get("SONARJAX_KILL_SEED") or secrets.randbits(32))
    rng = np.random.default_rng(seed)
    run, at, saving = tmp_path / "run", int(rng.integers(1, 6)), int(rng.integers(6, 10))
    print(f"SONARJAX_KILL_SEED={seed}: killed at step {at}, then in the first save from step {saving} on")
    # The first is killed between two steps, the second while it writes, the third may finish.
    end(start(folder, run, "kill_at_step", at), -signal.SIGKILL)
    end(start(folder, run, "kill_in_save", saving), -signal.SIGKILL)
    end(start(folder, run))
    assert (run / "weights.safetensors").read_bytes() == (alone / "weights.safetensors").read_bytes()
    for one, other in zip(
        jax.tree.leaves(last_state(run, folder)), jax.tree.leaves(last_state(alone, folder)), strict=True
    ):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()  # float32, and Adam's averages
    assert recorded(run) == recorded(alone)
    assert [line["step"] for line in recorded(run)] == [4, 8, 12]


def last_state(run, folder):
    """Everything that the last checkpoint of a run holds."""
    networks = tiny_recipe(folder).networks
    state = create_state(networks, key=jax.random.key(0))
    with Checkpoints(run / "checkpoints") as checkpoints:
        return checkpoints.restore(state, copied(device_mesh(8)))


def test_resuming_what_is_done_changes_nothing(folder, alone):
    before = load_file(alone / "weights.safetensors")
    result = train(tiny_recipe(folder), alone, resume=True)
    assert result.finished and result.step == 12
    np.testing.assert_allclose(result.metrics["psnr_db"], recorded(alone)[-1]["psnr_db"], rtol=1e-5)
    assert len(recorded(alone)) == 3
    after = load_file(alone / "weights.safetensors")
    assert before.keys() == after.keys() and all((before[name] == after[name]).all() for name in before)


def test_eight_devices_have_the_losses_of_one(folder, alone, tmp_path):
    end(start(folder, tmp_path / "eight", XLA_FLAGS=EIGHT, EXPECTED_DEVICES="8"))
    assert_same_losses(recorded(tmp_path / "eight"), recorded(alone))


def assert_same_losses(found, wanted):
    """Sums over a batch are made in another order: float32's rounding, grown over twelve steps."""
    losses = {name for name in wanted[0] if name.startswith("loss_")}
    assert losses == {"loss_discriminator", "loss_adversarial", "loss_distance"} and len(wanted) == 3
    for line, truth in zip(found, wanted, strict=True):
        assert line["step"] == truth["step"]
        print({name: abs(line[name] / truth[name] - 1) for name in losses})
        for name in losses:
            np.testing.assert_allclose(line[name], truth[name], rtol=1e-4, err_msg=name)
