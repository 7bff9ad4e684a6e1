"""Sets of simulated frames that segmenters and recognizers are judged on, each like §4.1's 288 but for one thing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

import numpy as np

import sonarjax as sj
from experiments.common.frames import TestFrame, paper_frames

SetName = Literal["severity 1", "offset yaw", "severity 1.5", "mirror image", "other devices"]
SETS: dict[str, dict[str, Any]] = {
    "severity 1": {},
    "offset yaw": {"yaw_offset_deg": 5.0},
    "severity 1.5": {"severity": 1.5},
    "mirror image": {"mirror": True},
    "other devices": {"drawn": True},
}
"""Sets of frames: how each differs from the 288 of §4.1 at severity 1."""


@cache
def target() -> sj.Mesh:
    """The paper's target: one mesh for all frames."""
    return sj.objects.target()


def mirrored(mesh: sj.Mesh) -> sj.Mesh:
    """The mirror image of an object, port and starboard exchanged: the hardest other object."""
    vertices, faces = np.asarray(mesh.vertices) * (1.0, -1.0, 1.0), np.asarray(mesh.faces)
    real = faces[:, 0] != faces[:, 1]  # the others are padding
    return sj.Mesh.from_arrays(vertices, faces[real][:, ::-1], name="mirror image")


def frames_of(name: str, seed: int, step_deg: int, tilts_deg: Sequence[float]) -> list[TestFrame]:
    """The frames of one set."""
    options = dict(SETS[name])
    other = mirrored(target()) if options.pop("mirror", False) else None
    return paper_frames(seed, step_deg=step_deg, other=other, tilts_deg=tilts_deg, **options)
