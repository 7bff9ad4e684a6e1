"""Does a sonar find its own geometry from frames of a known object?

python -m experiments.self_calibration [--external DIR] [--preset smoke] [--help]

Drawn devices: each has another look, tilt, height, range scale and azimuth scale than the nominal sonar says; it sees
the target at random yaws and places, and in some frames another object. `calibrate` is told neither poses nor which
frames show the target. With the other simulator's folder (or SONARJAX_EXTERNAL_DATA) its sets `off_geometry` follow:
one half of their frames calibrates, the other half is recognized with the nominal, the fitted and the true geometry.
They are calibrated twice: with the vertical aperture taken as known, and with it free.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.likelihood import scale_to_68
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.outside import OutsideFrame, read_set
from experiments.common.runs import Job
from experiments.common.sets import target
from sonarjax.calibrate import compare_templates
from sonarjax.calibrate.calibration import WIDENING
from sonarjax.calibrate.parameters import changed_sonar
from sonarjax.sensor import SensorModel

FREE = ("tilt", "height", "range_scale", "azimuth_scale")
"""What is free in the drawn sets."""
OFF = (math.radians(5.0), 0.3, 0.01, 0.02)
"""By how much each differs from the nominal sonar at most [rad, m, 1, 1]; the prior is told this as its deviation."""
EXTERNAL_OFF = {"tilt": math.radians(3.0), "height": 0.05, "elevation_aperture": math.radians(1.0)}
"""What the prior is told of the other simulator's sonar [rad, m, rad]. Data sheets state apertures in whole degrees."""
OTHERS = 0.2
"""Share of the drawn frames that show another object."""
RIGHT_DEG = 5.0
"""Largest error of a right yaw [deg]."""
SHOWN = {"tilt": ("tilt [°]", 180 / math.pi), "height": ("height [cm]", 100.0),
         "range_scale": ("range scale [%]", 100.0), "azimuth_scale": ("azimuth scale [%]", 100.0)}  # fmt: skip
"""How each number is called in a table, and in which unit."""
HEADS = {"name": "sonars", "count": "count", "number": "number", "mean": "mean of the signed errors",
         "median": "median error", "p90": "90 %",
         "within_1": "within 1 std", "bound": "Cramér-Rao bound, median", "determined": "determined"}  # fmt: skip
SET_HEADS = {"name": "set", "geometry": "geometry",
             "tilt": "tilt, error [°]", "tilt_std": "its std", "tilt_bound": "bound",
             "height": "height, error [cm]", "height_std": "its std ", "height_bound": "bound ",
             "right": "other half right"}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is calibrated."""

    devices: int = 16
    """Drawn devices."""
    frames: int = 20
    """Frames of each."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""
    external: str = ""
    """Folder with the other simulator's sets; empty for that of SONARJAX_EXTERNAL_DATA, or none."""
    segmenter: str = "pix2pix"
    """The segmenter that finds the target."""


def run(settings: Settings, job: Job) -> Report:
    """Errors of the drawn devices, and what calibration does for the other simulator's sets."""
    numbers = {f"device {k}": k for k in range(settings.devices)}
    drawn = job.map(lambda k: _drawn(settings, job, k), numbers, "devices")
    folder = settings.external or os.environ.get("SONARJAX_EXTERNAL_DATA", "")
    sets: dict[str, Any] = {}
    if folder:
        where = Path(folder) / "off_geometry"
        names = sorted(path.name for path in where.glob("set_*"))
        sets = job.map(lambda name: _external(where, name, settings), names, "sets")
    rows = [_summary(list(drawn.values()), name) for name in FREE] if drawn else []
    seconds = float(np.median([one["seconds"] for one in drawn.values()])) if drawn else None
    job.arrays("devices", **{
        f"{what}_{name}": np.array([one[what][name] for one in drawn.values()])
        for what in ("error", "std", "bound") for name in FREE
    })  # fmt: skip
    rows_of_sets = [row for one in sets.values() for row in one]
    return {"rows": rows, "sets": rows_of_sets, "calibration_s": seconds, "widening": _widening(drawn.values())}


def _drawn(settings: Settings, job: Job, number: int) -> dict[str, Any]:
    """The errors of one device; of the first one, frames and templates before and after are kept for the figure."""
    key = jax.random.fold_in(jax.random.key(job.seed), 5000 + number)
    shares = np.asarray(jax.random.uniform(jax.random.fold_in(key, 0), (len(FREE),), minval=-1, maxval=1), float)
    off = shares * OFF
    nominal = sonar_for(20.0)
    true = changed_sonar(nominal, FREE, jnp.asarray(off, jnp.float32))
    images = _frames(true, settings, key=key)
    begun = time.perf_counter()
    how: dict[str, Any] = {"free": FREE, "prior": dict(zip(FREE, OFF, strict=True))}
    found = sj.calibrate(images, target(), nominal, segmenter=settings.segmenter, engine=engine(), **how)
    seconds = time.perf_counter() - begun
    if number == 0:
        frames, before, after = compare_templates(found, images, target(), nominal)
        job.arrays("before_after", image=frames, nominal=before, fitted=after)
    return {
        "error": dict(zip(FREE, (found.change - off).tolist(), strict=True)),
        "std": found.std,
        "bound": found.bound,
        "determined": found.determined,
        "used": int(found.used.sum()),
        "seconds": seconds,
    }


def _frames(sonar: sj.Sonar, settings: Settings, *, key: jax.Array) -> list[np.ndarray]:
    """Frames of the target, some of another object, at random yaws and places on the lit floor near the beam axis."""
    model = SensorModel.draw(key=jax.random.fold_in(key, 1), severity=settings.severity)
    meshes = {False: target(), True: sj.objects.non_target()}
    images = []
    for number in range(settings.frames):
        part = jax.random.fold_in(key, 100 + number)
        draws = np.asarray(jax.random.uniform(part, (4,)), float)
        ground = _middle(sonar) + 0.15 * (2 * draws[0] - 1)
        pose = sj.Pose(ground, 0.25 * (2 * draws[1] - 1), 2 * math.pi * draws[2])
        image, _ = observed(meshes[bool(draws[3] < OTHERS)], pose, sonar, model, key=jax.random.fold_in(part, 1))
        images.append(np.asarray(image))
    return images


def _middle(sonar: sj.Sonar) -> float:
    """Where the beam axis meets the floor [m ahead], or as near to it as the window has room for object and shadow."""
    height, tilt = float(sonar.height), float(sonar.tilt)
    nearest, farthest = float(sonar.range_min) + 0.4, float(sonar.range_max) - 1.0
    slant = min(max(height / math.sin(tilt), nearest, height + 0.3), farthest)
    return math.sqrt(slant**2 - height**2)


def _summary(found: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    """A number's errors where it is determined; elsewhere it keeps its nominal value, which says nothing of the fit."""
    title, unit = SHOWN[name]
    told = [one for one in found if one["determined"][name]]
    row = {"name": "drawn", "count": len(found), "number": title, "determined": len(told) / len(found)}
    if not told:
        return row | dict.fromkeys(("mean", "median", "p90", "within_1", "bound"))
    signed, std, bound = (unit * np.array([one[key][name] for one in told]) for key in ("error", "std", "bound"))
    error = np.abs(signed)
    return row | {
        "mean": float(signed.mean()), "median": float(np.median(error)), "p90": float(np.percentile(error, 90)),
        "within_1": float((error <= std).mean()), "bound": float(np.median(bound)),
    }  # fmt: skip


def _widening(found: Iterable[dict[str, Any]]) -> float | None:
    """The `WIDENING` with which 68 % of all errors of determined numbers would lie within a standard deviation."""
    pairs = [(abs(one["error"][n]), one["std"][n]) for one in found for n in FREE if one["determined"][n]]
    return WIDENING * scale_to_68(*np.array(pairs).T) if pairs else None


def _external(folder: Path, name: str, settings: Settings) -> list[dict[str, Any]]:
    judged = read_set(folder)
    sonars = list({id(frame.sonar): frame.sonar for frame in judged.frames}.values())
    nominal = sonars[int(name.removeprefix("set_"))]
    frames = [frame for frame in judged.frames if frame.sonar is nominal]
    half = len(frames) // 2
    first, rest, true = frames[:half], frames[half:], frames[0].true_sonar
    assert true is not None
    free = ("tilt", "height", "elevation_aperture")
    known, unknown = (_calibrated(first, judged.target, nominal, names, settings) for names in (free[:2], free))
    found = {"fitted": known, "fitted, aperture free": unknown}
    fitted = {geometry: one.sonar for geometry, one in found.items()}
    rows = []
    for geometry, sonar in ({"nominal": nominal} | fitted | {"true": true}).items():
        row = {"name": name, "geometry": geometry, "right": _right(rest, judged.target, sonar, settings.segmenter)}
        row["tilt"] = math.degrees(float(sonar.tilt) - float(true.tilt))
        row["height"] = 100 * (float(sonar.height) - float(true.height))
        if geometry in found:
            std, bound = found[geometry].std, found[geometry].bound
            row |= {"tilt_std": math.degrees(std["tilt"]), "height_std": 100 * std["height"]}
            row |= {"tilt_bound": math.degrees(bound["tilt"]), "height_bound": 100 * bound["height"]}
        rows.append(row)
    return rows


def _calibrated(
    frames: Sequence[OutsideFrame], mesh: sj.Mesh, nominal: sj.Sonar, free: Sequence[str], settings: Settings
) -> sj.Calibration:
    """The calibration from these frames, which may show another object, at poses that are searched for."""
    images, prior = [frame.image for frame in frames], {name: EXTERNAL_OFF[name] for name in free}
    return sj.calibrate(
        images, mesh, nominal, free=free, prior=prior, segmenter=settings.segmenter, engine=engine()
    )  # fmt: skip


def _right(frames: Sequence[OutsideFrame], mesh: sj.Mesh, sonar: sj.Sonar, segmenter: str) -> float:
    """Share of frames with the target identified and its yaw within 5°, or another object refused."""
    recognizer = sj.Recognizer(mesh, sonar, segmenter=segmenter, engine=engine())
    right = []
    for frame in frames:
        found = recognizer(frame.image)
        near = yaw_error_deg(found.yaw, frame.yaw) <= RIGHT_DEG
        right.append(bool(found.identified and near) if frame.is_target else not found.identified)
    return float(np.mean(right))


def table(report: Report) -> str:
    """What is found of each number, and what it is good for."""
    parts = []
    if report["rows"]:
        parts.append(columns(report["rows"], HEADS))
        if "calibration_s" in report:  # `seconds` is the whole run's
            parts.append(f"one calibration: {report['calibration_s']:.0f} s")
        if report.get("widening"):  # None if nothing is determined
            parts.append(f"widening that holds 68 % of the errors of determined numbers: {report['widening']:.2f}")
    if report["sets"]:
        parts.append(columns(report["sets"], SET_HEADS))
    return "\n\n".join(parts)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"devices": 1, "frames": 4, "segmenter": "none"})
