"""One training step on all devices of all processes, with the same losses as on one device.

The batch is split over the devices, and each device has a copy of the networks. To use several processes, start each
with `SONARJAX_COORDINATOR=host:port`, `SONARJAX_PROCESSES` and `SONARJAX_PROCESS` (counted from 0), or call
`jax.distributed.initialize` before anything else. All of them must see the same run directory.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.step import GanState, Gradients, Losses, discriminative_gradients, pix2pix_gradients, update
from sonarjax.segment.training.batches import Stored
from sonarjax.segment.training.recipes import Recipe

COORDINATOR, PROCESSES, PROCESS = "SONARJAX_COORDINATOR", "SONARJAX_PROCESSES", "SONARJAX_PROCESS"


def join_processes() -> None:
    """Join the other processes, if the environment names a coordinator and JAX has not joined them already.

    Raises:
        SonarjaxError: The numbers in the environment cannot be used, or the coordinator does not answer.
    """
    address = os.environ.get(COORDINATOR)
    if not address or jax.distributed.is_initialized():
        return
    try:
        count, number = int(os.environ[PROCESSES]), int(os.environ[PROCESS])
    except (KeyError, ValueError) as error:
        raise SonarjaxError(f"{COORDINATOR} is set: expected numbers in {PROCESSES} and {PROCESS} too") from error
    try:
        jax.distributed.initialize(address, count, number)
    except (RuntimeError, ValueError) as error:
        raise SonarjaxError(f"{COORDINATOR}: cannot join {address}: {' '.join(str(error).split())}") from error


def device_mesh(batch: int) -> Mesh:
    """A row of all devices; in a single process, as many of them as divide the batch evenly.

    Raises:
        SonarjaxError: Several processes cannot share the batch evenly.
    """
    devices = jax.devices()
    if jax.process_count() > 1 and batch % len(devices):
        raise SonarjaxError(f"training: batch: expected a multiple of the {len(devices)} devices, got {batch}")
    count = max(n for n in range(1, len(devices) + 1) if batch % n == 0)
    return Mesh(np.array(devices[:count]), ("batch",))


def copied(mesh: Mesh) -> NamedSharding:
    """The sharding of arrays of which every device has a full copy."""
    return NamedSharding(mesh, PartitionSpec())


def place_batch(pairs: Stored, mesh: Mesh) -> tuple[Array, Array]:
    """Split images and labels over the devices; all processes hold the same `pairs`."""
    split = NamedSharding(mesh, PartitionSpec("batch"))
    return _placed(pairs.image, split), _placed(pairs.labels, split)


def place_state(state: GanState, mesh: Mesh) -> GanState:
    """Copy the state, which is the same in every process, to all devices."""
    return jax.tree.map(lambda v: _placed(np.asarray(v), copied(mesh)), state)


def _placed(values: np.ndarray, sharding: NamedSharding) -> Array:
    return jax.make_array_from_callback(values.shape, sharding, lambda rows: values[rows])


def local_copy(tree: Any) -> Any:
    """This process's own copy of arrays that every device has in full."""
    return jax.tree.map(lambda v: v.addressable_data(0), tree)


def make_step(recipe: Recipe, mesh: Mesh) -> Callable[[GanState, Array, Array, Any], tuple[GanState, Losses]]:
    """The compiled step: state (donated), images and labels as bytes, the run's key data → next state and losses."""
    copies, split = copied(mesh), NamedSharding(mesh, PartitionSpec("batch"))

    @partial(jax.jit, in_shardings=(copies, split, split, copies), out_shardings=copies)
    def take_gradients(state: GanState, image: Array, labels: Array, dropout: Any) -> Gradients:
        x = (image.astype(jnp.float32) / 127.5 - 1)[..., None]
        key = jax.random.fold_in(jax.random.wrap_key_data(dropout), state.step)
        if recipe.discriminative:
            return discriminative_gradients(state, x, labels, key=key)
        y = (labels == 1).astype(jnp.float32) - (labels == 2)
        return pix2pix_gradients(state, x, y[..., None], key=key)

    def step(state: GanState, image: Array, labels: Array, dropout: Any) -> tuple[GanState, Losses]:
        gradients = take_gradients(state, image, labels, dropout)
        return update(state, gradients), gradients.losses

    return step


def anywhere(happened: bool) -> bool:
    """Whether `happened` is true in any process; all processes must call this."""
    if jax.process_count() == 1:
        return happened
    from jax.experimental import multihost_utils

    return bool(np.any(multihost_utils.process_allgather(np.array(happened))))
