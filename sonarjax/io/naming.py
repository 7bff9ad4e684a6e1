"""Names of frames: which frames of a file are wanted, and what each is called in messages and output files."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.frame import Frame, Geometry


def frame_numbers(name: str, n_frames: int, index: int | None) -> range:
    """All frame numbers of a file, or the one asked for. Raises SonarjaxError if the file has no such frame."""
    if index is None:
        return range(n_frames)
    if not 0 <= index < n_frames:
        raise SonarjaxError(f"{name}: frame {index}: expected 0 to {n_frames - 1}, the file holds {n_frames} frame(s)")
    return range(index, index + 1)


def named(
    image: Float32[np.ndarray, "range beam"],
    name: str,
    number: int,
    n_frames: int,
    geometry: Geometry | None,
    meta: dict[str, Any],
    mask: Bool[np.ndarray, "range beam"] | None = None,
) -> Frame:
    """Make a frame (range, beam) of file `name`. If the file holds several, its source and stem contain the number."""
    stem = os.path.splitext(os.path.basename(name))[0]
    several = n_frames > 1
    return Frame(
        image=image,
        mask=mask,
        source=f"{name}:{number}" if several else name,
        stem=f"{stem}_{number}" if several else stem,
        geometry=geometry,
        meta={**meta, "frame_index": number, "n_frames": n_frames},
    )
