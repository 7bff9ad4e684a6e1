"""Which number of the geometry could cause the part of the real pipe's yaw error that varies with twice the yaw?

python -m experiments.pipe_sources [--data DIR] [--preset smoke] [--help]

The frames and the geometry are those of `real_turntable`. One number at a time is changed both ways and the yaws are
found anew. How the error's part with twice the yaw (an amplitude and a phase) changes says how far the number would
have to be off to explain that part, and what of it none of its values would explain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from experiments import real_turntable
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.pipe_from_coarse import platform, wave, yaw_errors_deg
from sonarjax.calibrate.parameters import changed_mesh, changed_sonar

STEPS = {
    "tilt": (math.radians(3.0), 180 / math.pi, "°"),
    "roll": (math.radians(3.0), 180 / math.pi, "°"),
    "height": (0.1, 100.0, "cm"),
    "azimuth_scale": (0.05, 100.0, "%"),
    "range_scale": (0.03, 100.0, "%"),
    "beam_bend": (0.05, 100.0, "%"),
    "object_length": (0.1, 100.0, "%"),
    "object_width": (0.1, 100.0, "%"),
    "object_height": (0.1, 100.0, "%"),
}
"""What is changed -> by how much [rad, m or 1], and how that is shown: factor and unit."""
HEADS = {
    "number": "number",
    "step": "changed by",
    "response_deg": "what that adds, amplitude [°]",
    "needed": "off by, to explain most",
    "left_deg": "amplitude left then [°]",
    "median_low": "yaw, median at minus the step [°]",
    "median_high": "at plus the step [°]",
}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    data: str = ""
    """Folder of the frames; empty for `pipe` in that of SONARJAX_REAL_DATA."""
    frames: int = 37
    """Frames, evenly spread over the turn; 0 for all."""
    numbers: tuple[str, ...] = tuple(STEPS)
    """What is changed."""
    segmenter: str = "pix2pix"
    """The segmenter with which yaws are found."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each number."""
    turntable = real_turntable.Settings(data=settings.data, frames=settings.frames, mask_radius=0.0)
    data = real_turntable.load(turntable)
    masks = data.masks & platform(data.images, data.masks)
    changes = {"nothing": ("tilt", 0.0)}
    for name in settings.numbers:
        changes |= {f"{name} {sign:+d}": (name, sign * STEPS[name][0]) for sign in (-1, 1)}

    def errors(change: tuple[str, float]) -> list[float]:
        name, by = (change[0],), jnp.asarray([change[1]], jnp.float32)
        mesh = changed_mesh(data.mesh, name, by)
        sonar = data.sonar if name[0].startswith("object_") else changed_sonar(data.sonar, name, by)
        return yaw_errors_deg(data, masks, mesh, sonar, settings.segmenter).tolist()

    found = {part: np.array(error) for part, error in job.map(errors, changes, "geometries").items()}
    as_it_is = wave(found["nothing"], data.truth)
    rows = [_row(name, found, data.truth, as_it_is) for name in settings.numbers]
    return {
        "rows": rows, "amplitude_deg": abs(as_it_is), "frames": len(data.images),
        "median_deg": float(np.median(np.abs(found["nothing"]))),
    }  # fmt: skip


def _row(name: str, found: dict[str, np.ndarray], truth: np.ndarray, as_it_is: complex) -> dict[str, Any]:
    step, factor, unit = STEPS[name]
    low, high = found[f"{name} -1"], found[f"{name} +1"]
    response = (wave(high, truth) - wave(low, truth)) / 2
    times = -(as_it_is * response.conjugate()).real / max(abs(response) ** 2, 1e-12)
    return {
        "number": name.replace("_", " "),
        "step": f"{factor * step:.3g} {unit}",
        "response_deg": abs(response),
        "needed": f"{factor * step * times:+.2g} {unit}",
        "left_deg": abs(as_it_is + times * response),
        "median_low": float(np.median(np.abs(low))),
        "median_high": float(np.median(np.abs(high))),
    }


def table(report: Report) -> str:
    """The numbers side by side."""
    about = f"as it is, over {report['frames']} frames: amplitude {report['amplitude_deg']:.2f}°"
    return f"{columns(report['rows'], HEADS)}\n\n{about}, yaw's median {report['median_deg']:.2f}°"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"frames": 4, "numbers": ("height",), "segmenter": "none"})
