"""The averaged generator as safetensors, with what made it in the metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sonarjax.io import write_atomic

ABOUT = "sonarjax"
"""The one key of the metadata, a JSON object: more keys would be stored in an order that changes from run to run."""


def export_weights(path: Path, weights: Any, about: Mapping[str, Any]) -> None:
    """Write a generator's variables, named by their place (`params.down1.kernel`), and `about` them; all or nothing.

    Raises SonarjaxError when the file cannot be written.
    """
    from safetensors.numpy import save

    flat, _ = jax.tree_util.tree_flatten_with_path(weights)
    named = {jax.tree_util.keystr(place, simple=True, separator="."): np.ascontiguousarray(v) for place, v in flat}
    data = save(named, {ABOUT: json.dumps(about, sort_keys=True)})
    write_atomic(path, lambda file: file.write(data))
