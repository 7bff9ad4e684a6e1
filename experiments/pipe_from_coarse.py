"""Can real frames be recognized with a geometry that is only guessed? The turntable's pipe, calibrated from 30°, 1.0 m.

python -m experiments.pipe_from_coarse [--data DIR] [--preset smoke] [--help]

The frames are those of `real_turntable`. Taken from their folder: range window, beams, the pipe's mesh and the truth,
which judges alone. Tilt and height start at the guess; where the platform lies is seen in the frames, as what stays
bright while it turns. `calibrate` gets some of the frames; yaws of all of them are then found with the guess, with what
it fitted, and with the folder's own geometry. The part of the error that goes with twice the yaw is shown: a wrong
geometry leaves one, since a pipe that is seen too flat or too steep turns by too much or too little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import binary_fill_holes, binary_opening
from scipy.ndimage import label as components
from skimage.filters import threshold_otsu

import sonarjax as sj
from experiments import real_turntable
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.segmenters import loaded

QUIET = 20
"""Percentile over frames below which a pixel of the platform seldom falls [%]: the pipe's shadow passes over it."""
HEADS = {
    "geometry": "geometry",
    "tilt_deg": "tilt [°]",
    "tilt_std": "its std",
    "height_m": "height [m]",
    "height_std": "its std ",
    "median_deg": "yaw, median [°]",
    "p90_deg": "90 % [°]",
    "most_deg": "within 10°",
    "wave_deg": "amplitude with twice the yaw [°]",
}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    data: str = ""
    """Folder of the frames; empty for `pipe` in that of SONARJAX_REAL_DATA."""
    frames: int = 0
    """Frames that are judged, evenly spread over the turn; 0 for all."""
    fitted: int = 20
    """Frames that `calibrate` gets, evenly spread."""
    tilt_deg: float = 30.0
    """The guess of the tilt [deg]."""
    height_m: float = 1.0
    """The guess of the height [m]."""
    tilt_std_deg: float = 5.0
    """Standard deviation of that guess [deg]."""
    height_std_m: float = 0.3
    """Standard deviation of that guess [m]."""
    segmenter: str = "pix2pix"
    """The segmenter with which the pipe and its yaws are found."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each geometry."""
    turntable = real_turntable.Settings(data=settings.data, frames=settings.frames, mask_radius=0.0)
    data = real_turntable.load(turntable)
    masks = data.masks & platform(data.images, data.masks)
    usual = sj.Sonar.preset("didson-hf").highlight_max_incidence
    guess = data.sonar.replace(
        tilt=math.radians(settings.tilt_deg), height=settings.height_m, highlight_max_incidence=usual
    )
    some = np.unique(np.linspace(0, len(data.images) - 1, min(settings.fitted, len(data.images))).astype(int))

    def calibrated(_: str) -> dict[str, Any]:
        found = sj.calibrate(
            data.images[some], data.mesh, guess, masks=masks[some], present=True, segmenter=loaded(settings.segmenter),
            engine=engine(), prior={"tilt": math.radians(settings.tilt_std_deg), "height": settings.height_std_m},
        )  # fmt: skip
        return {
            "tilt": float(found.sonar.tilt), "height": float(found.sonar.height), "std": found.std,
            "determined": found.determined, "used": int(found.used.sum()),
        }  # fmt: skip

    fit = job.map(calibrated, ("coarse guess",), "calibration")["coarse guess"]
    sonars = {
        "guessed": guess,
        "fitted": guess.replace(tilt=fit["tilt"], height=fit["height"]),
        "of the folder": data.sonar.replace(highlight_max_incidence=usual),  # so that only the geometry differs
    }
    judged = job.map(partial(_judge, settings, data, masks), sonars, "geometries")
    rows = [{"geometry": name} | {k: v for k, v in row.items() if k != "error_deg"} for name, row in judged.items()]
    rows[1] |= {"tilt_std": math.degrees(fit["std"]["tilt"]), "height_std": fit["std"]["height"]}
    job.arrays("errors", truth=data.truth, **{name.replace(" ", "_"): row["error_deg"] for name, row in judged.items()})
    return {"rows": rows, "determined": fit["determined"], "used": fit["used"], "frames": len(data.images)}


def platform(images: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """True (range, beam) where the turning platform is lit in nearly all frames (frame, range, beam): its largest part.

    Open water beside it stays dark. No geometry is needed for this, nor known.
    """
    measured = masks.all(axis=0)
    quiet = np.percentile(np.where(measured, images, 0.0), QUIET, axis=0)
    bright = measured & (quiet > threshold_otsu(quiet[measured]))
    parts, count = components(binary_opening(bright, np.ones((3, 3))))
    if not count:
        return measured
    largest = parts == 1 + np.argmax(np.bincount(parts.ravel())[1:])
    return np.asarray(binary_fill_holes(largest)) & measured


def wave(error_deg: np.ndarray, yaw: np.ndarray) -> complex:
    """The part of the errors (frame,) [deg] that goes with twice the `yaw` (frame,) [rad]: a of Re(a·exp(-2iψ)).

    By least squares beside a constant; errors beyond 10° are of another hypothesis and left out.
    """
    near = np.abs(error_deg) <= 10
    basis = np.stack([np.ones(near.sum()), np.cos(2 * yaw[near]), np.sin(2 * yaw[near])], axis=1)
    (_, cosine, sine), *_ = np.linalg.lstsq(basis, error_deg[near], rcond=None)
    return complex(cosine, sine)


def yaw_errors_deg(
    data: real_turntable.Data, masks: np.ndarray, mesh: sj.Mesh, sonar: sj.Sonar, segmenter: str
) -> np.ndarray:
    """Yaw errors (frame,) [deg] of all frames with one geometry, none refused."""
    recognizer = sj.Recognizer(mesh, sonar, segmenter=loaded(segmenter), engine=engine())
    yaws = [recognizer(image, mask, threshold=-1.0).yaw for image, mask in zip(data.images, masks, strict=True)]
    return np.asarray(real_turntable.errors_deg(np.array(yaws), data.truth)[0])


def _judge(settings: Settings, data: real_turntable.Data, masks: np.ndarray, sonar: sj.Sonar) -> dict[str, Any]:
    """How well yaw is found with one geometry."""
    error = yaw_errors_deg(data, masks, data.mesh, sonar, settings.segmenter)
    return {
        "tilt_deg": math.degrees(float(sonar.tilt)),
        "height_m": float(sonar.height),
        "median_deg": float(np.median(np.abs(error))),
        "p90_deg": float(np.percentile(np.abs(error), 90)),
        "most_deg": float((np.abs(error) <= 10).mean()),
        "wave_deg": abs(wave(error, data.truth)),
        "error_deg": error.tolist(),
    }


def table(report: Report) -> str:
    """The geometries side by side."""
    told = ", ".join(f"{name} {'yes' if yes else 'no'}" for name, yes in report["determined"].items())
    about = f"{report['frames']} frames judged, {report['used']} used to calibrate; determined: {told}"
    return f"{columns(report['rows'], HEADS)}\n\n{about}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"frames": 4, "fitted": 4, "segmenter": "none"})
