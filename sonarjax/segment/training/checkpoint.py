"""Checkpoints of a run by Orbax: written aside and renamed, so a run killed while writing keeps the previous one."""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType
from typing import Any

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp
from jax.sharding import NamedSharding

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.step import GanState

KEPT = 2


class Checkpoints:
    """The checkpoints in a folder, numbered by steps done; a context manager."""

    def __init__(self, folder: Path) -> None:
        """Open `folder`, and make it if it is missing. Raises SonarjaxError if it cannot be used."""
        logging.getLogger("absl").setLevel(logging.WARNING)  # at level INFO Orbax logs every file
        self.folder = folder
        options = ocp.CheckpointManagerOptions(
            max_to_keep=KEPT, enable_async_checkpointing=False, cleanup_tmp_directories=True
        )
        try:
            self._manager = ocp.CheckpointManager(folder.absolute(), options=options)
        except (OSError, ValueError) as error:
            raise SonarjaxError(f"{folder}: cannot hold checkpoints: {' '.join(str(error).split())}") from error

    @property
    def latest(self) -> int | None:
        """Number of steps done at the newest checkpoint; None if there is none."""
        return self._manager.latest_step()

    def save(self, state: GanState, step: int) -> None:
        """Write the state after `step` steps. Raises SonarjaxError if it cannot be written."""
        if step == self.latest:
            return
        try:
            self._manager.save(step, args=ocp.args.StandardSave(_named(state)), force=True)
        except (OSError, ValueError) as error:
            raise SonarjaxError(f"{self.folder}: cannot be written: {' '.join(str(error).split())}") from error

    def restore(self, like: GanState, sharding: NamedSharding) -> GanState:
        """Read the newest state, in the shapes of `like`, placed by `sharding`.

        Raises:
            SonarjaxError: It cannot be read, or is of other networks.
        """
        wanted = {k: jax.ShapeDtypeStruct(v.shape, v.dtype, sharding=sharding) for k, v in _named(like).items()}
        try:
            found = self._manager.restore(self.latest, args=ocp.args.StandardRestore(wanted))
        except (OSError, ValueError, KeyError) as error:
            reason = " ".join(str(error).split())[:200]
            raise SonarjaxError(f"{self.folder}: checkpoint {self.latest} cannot be restored: {reason}") from error
        # Copied, because Orbax's arrays may lie in memory that a step, to which they are donated, must not overwrite.
        return jax.tree.unflatten(jax.tree.structure(like), [jnp.copy(found[name]) for name in wanted])

    def __enter__(self) -> Checkpoints:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._manager.close()


def _named(state: Any) -> dict[str, Any]:
    """Every array of the state under the name of its place."""
    flat, _ = jax.tree_util.tree_flatten_with_path(state)
    return {jax.tree_util.keystr(path, simple=True, separator="-"): leaf for path, leaf in flat}
