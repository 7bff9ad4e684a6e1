"""Named arrays in a safetensors file, with a description of them. The file holds no code, and its size is checked."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from sonarjax.io.atomic import PathLike, write_atomic
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes, reason
from sonarjax.io.nesting import check_nesting

ABOUT = "sonarjax"
"""The only key of the metadata, a JSON object. Several keys would be stored in an order that varies between runs."""


def write_safetensors(path: PathLike, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> None:
    """Write named arrays (any shape), and the description `about` of JSON types. The same input gives the same bytes.

    Raises:
        SonarjaxError: The file cannot be written, or `about` cannot be stored as JSON.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import save

    try:
        text = json.dumps(dict(about), sort_keys=True, allow_nan=False)
        data = save({name: np.ascontiguousarray(v) for name, v in arrays.items()}, {ABOUT: text})
    except (TypeError, ValueError, SafetensorError) as error:
        raise SonarjaxError(f"{os.fspath(path)}: cannot be stored as safetensors: {reason(error)}") from error
    write_atomic(path, lambda file: file.write(data))


def read_safetensors(path: PathLike) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays (any shape) by name, and the description, which is empty if another program wrote the file.

    Raises:
        SonarjaxError: The file is missing, truncated or not a safetensors file.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    name, data = os.fspath(path), read_bytes(path)
    try:
        arrays = load(data)
        length = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__") or {}
        about = json.loads(metadata.get(ABOUT, "{}"))
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise SonarjaxError(f"{name}: expected a complete safetensors file: {reason(error)}") from error
    if not isinstance(about, dict):
        raise SonarjaxError(f"{name}: metadata: {ABOUT}: expected a JSON object")
    check_nesting(about, f"{name}: metadata")
    return arrays, about
