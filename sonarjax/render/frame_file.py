"""FRAME.npz: a rendered frame with its axes."""

from __future__ import annotations

import os

import numpy as np

from sonarjax.io.atomic import write_npz
from sonarjax.render.frame import SonarFrame
from sonarjax.sonar import Sonar, range_edges_of


def write_frame(path: str | os.PathLike[str], frame: SonarFrame, sonar: Sonar) -> None:
    """Write a frame and the axes of its sonar to an NPZ file.

    The array `image` is the semantic map, so the file can be given to `recognize`.

    Args:
        path: File to write.
        frame: One frame (range, beam).
        sonar: The sonar whose axes are written.

    Raises:
        SonarjaxError: The file cannot be written.
    """
    write_npz(
        path,
        image=np.asarray(frame.semantic()),
        intensity=np.asarray(frame.intensity),
        highlight=np.asarray(frame.highlight),
        shadow=np.asarray(frame.shadow),
        labels=np.asarray(frame.labels()),
        azimuth_deg=np.degrees(np.asarray(sonar.azimuth, np.float64)),
        range_edges_m=range_edges_of(sonar),
    )
