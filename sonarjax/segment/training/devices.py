"""One training step on all devices of all processes, with the same losses as on one device.

The batch is split over the devices, and each device has a copy of the networks. To use several processes, start each
with `SONARJAX_COORDINATOR=host:port`, `SONARJAX_PROCESSES` and `SONARJAX_PROCESS` (counted from 0), or call
`jax.distributed.initialize` before anything else. All of them must see the same run directory.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
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


def place_batches(batches: Sequence[Stored], mesh: Mesh) -> tuple[Array, Array]:
    """Images and labels (step, pair, range, beam), the pairs split over the devices.

    All processes hold the same `batches`.
    """
    split = NamedSharding(mesh, PartitionSpec(None, "batch"))
    image, labels = (np.stack(layer) for layer in zip(*batches, strict=True))
    return _placed(image, split), _placed(labels, split)


def place_state(state: GanState, mesh: Mesh) -> GanState:
    """Copy the state, which is the same in every process, to all devices."""
    return jax.tree.map(lambda v: _placed(np.asarray(v), copied(mesh)), state)


def _placed(values: np.ndarray, sharding: NamedSharding) -> Array:
    return jax.make_array_from_callback(values.shape, sharding, lambda rows: values[rows])


def local_copy(tree: Any) -> Any:
    """This process's own copy of arrays that every device has in full."""
    return jax.tree.map(lambda v: v.addressable_data(0), tree)


def make_steps(recipe: Recipe, mesh: Mesh) -> Callable[[GanState, Array, Array, Any], tuple[GanState, Losses]]:
    """Training steps, one for each batch of a stack.

    Several steps are one compiled loop: on a GPU, starting the small kernels of a step one by one from Python takes
    longer than they run. A single step is two functions, which XLA compiles faster than one.

    Returns:
        A function of the state (donated), images and labels as bytes (step, pair, range, beam) and the run's key data.
        It returns the next state and the losses of the last step.
    """
    whole, split = copied(mesh), NamedSharding(mesh, PartitionSpec(None, "batch"))

    def gradients(state: GanState, image: Array, labels: Array, dropout: Any) -> Gradients:
        x = (image.astype(jnp.float32) / 127.5 - 1)[..., None]
        key = jax.random.fold_in(jax.random.wrap_key_data(dropout), state.step)
        if recipe.discriminative:
            return discriminative_gradients(state, x, labels, key=key)
        y = (labels == 1).astype(jnp.float32) - (labels == 2)
        return pix2pix_gradients(state, x, y[..., None], key=key)

    @partial(jax.jit, in_shardings=(whole, split, split, whole), out_shardings=whole)
    def first_gradients(state: GanState, images: Array, labels: Array, dropout: Any) -> Gradients:
        return gradients(state, images[0], labels[0], dropout)

    @partial(jax.jit, in_shardings=(whole, split, split, whole), out_shardings=whole, donate_argnums=0)
    def loop(state: GanState, images: Array, labels: Array, dropout: Any) -> tuple[GanState, Losses]:
        def step(state: GanState, pairs: tuple[Array, Array]) -> tuple[GanState, Losses]:
            found = gradients(state, *pairs, dropout)
            return update(state, found), found.losses

        state, losses = jax.lax.scan(step, state, (images, labels))
        return state, jax.tree.map(lambda values: values[-1], losses)

    def steps(state: GanState, images: Array, labels: Array, dropout: Any) -> tuple[GanState, Losses]:
        if len(images) > 1:
            return loop(state, images, labels, dropout)
        found = first_gradients(state, images, labels, dropout)
        return update(state, found), found.losses

    return steps


def anywhere(happened: bool) -> bool:
    """Whether `happened` is true in any process; all processes must call this."""
    if jax.process_count() == 1:
        return happened
    from jax.experimental import multihost_utils

    return bool(np.any(multihost_utils.process_allgather(np.array(happened))))
