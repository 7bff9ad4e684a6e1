"""Do frames show beyond which angle of incidence a sonar hears no echo, and does fitting it harm the geometry?

python -m experiments.incidence_limit [--devices N] [--preset smoke] [--help]

Drawn devices, each with another look, tilt and height than the nominal sonar, see the target at random yaws and places.
Facets that are hit beyond a drawn limit send nothing back: their reflectivity is set to 0, with normals taken from the
mesh alone. Some devices have no limit. Each is calibrated as if there were none, and with the limit free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.sets import target
from sonarjax.calibrate.parameters import INCIDENCE, changed_sonar
from sonarjax.sensor import SensorModel

GEOMETRY = ("tilt", "height")
OFF = (math.radians(2.0), 0.05)
"""By how much tilt and height differ from the nominal sonar at most [rad, m]; the prior is told this as deviation."""
LIMITS_DEG = (50.0, 80.0)
"""Between these the limits are drawn [deg]."""
UNLIMITED = 4
"""Every so many devices, one has no limit."""
HEADS = {"devices": "devices", "free": "limit", "count": "count", "limit": "limit: median error [°]", "p90": "90 % [°]",
         "within_1": "within 1 std", "determined": "determined", "least": "least limit found [°]",
         "tilt": "tilt: median error [°]", "tilt_p90": "90 % [°] ", "height": "height: median error [cm]"}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is calibrated."""

    devices: int = 16
    """Drawn devices, a quarter of them without a limit."""
    frames: int = 16
    """Frames of each."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""
    segmenter: str = "pix2pix"
    """The segmenter that finds the target."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each kind of device, with the limit free and without."""
    numbers = {f"device {k}": k for k in range(settings.devices)}
    found = job.map(lambda k: _device(settings, job.seed, k), numbers, "devices").values()
    rows = []
    for devices, limited in (("with a limit", True), ("without", False)):
        chosen = [one for one in found if (one["limit"] is not None) == limited]
        truth = [one["limit"] for one in chosen]
        rows += [_summary(devices, free, truth, [one[free] for one in chosen]) for free in ("none", "free") if chosen]
    return {"rows": rows}


def _device(settings: Settings, seed: int, number: int) -> dict[str, Any]:
    """The errors of one device's calibrations, by how the limit was taken."""
    key = jax.random.fold_in(jax.random.key(seed), 9000 + number)
    shares = np.asarray(jax.random.uniform(jax.random.fold_in(key, 0), (3,), minval=-1, maxval=1), float)
    off, nominal = shares[:2] * OFF, sonar_for(20.0)
    drawn = float(np.mean(LIMITS_DEG) + shares[2] * (LIMITS_DEG[1] - LIMITS_DEG[0]) / 2)
    limit = drawn if (number + 1) % UNLIMITED else None
    true = changed_sonar(nominal, GEOMETRY, jnp.asarray(off, jnp.float32))
    images = _frames(true, limit, settings, key=key)
    result: dict[str, Any] = {"limit": limit}
    for how, free in (("none", GEOMETRY), ("free", (*GEOMETRY, INCIDENCE))):
        found = sj.calibrate(
            images, target(), nominal, free=free, prior=dict(zip(GEOMETRY, OFF, strict=True)), present=True,
            segmenter=settings.segmenter, engine=engine(),
        )  # fmt: skip
        result[how] = {
            "tilt": math.degrees(found.change[0] - off[0]),
            "height": 100 * (found.change[1] - off[1]),
            "determined": found.determined.get(INCIDENCE),
            "std": found.std.get(INCIDENCE),
            "limit": float(found.sonar.highlight_max_incidence),
        }
    return result


def _frames(sonar: sj.Sonar, limit: float | None, settings: Settings, *, key: jax.Array) -> list[np.ndarray]:
    """Frames of the target at random yaws and places."""
    model = SensorModel.draw(key=jax.random.fold_in(key, 1), severity=settings.severity)
    images = []
    for number in range(settings.frames):
        part = jax.random.fold_in(key, 100 + number)
        draws = np.asarray(jax.random.uniform(part, (3,)), float)
        pose = sj.Pose(2.3 + 0.15 * (2 * draws[0] - 1), 0.25 * (2 * draws[1] - 1), 2 * math.pi * draws[2])
        mesh = target() if limit is None else darkened(target(), pose, sonar, limit)
        images.append(np.asarray(observed(mesh, pose, sonar, model, key=jax.random.fold_in(part, 1))[0]))
    return images


def darkened(mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, limit_deg: float) -> sj.Mesh:
    """The mesh with a reflectivity of 0 for facets that are hit farther from their normal than `limit_deg` [deg]."""
    corners = np.asarray(pose.to_ground(mesh.vertices))[np.asarray(mesh.faces)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ray = corners.mean(axis=1) - [0.0, 0.0, float(sonar.height)]
    size = np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    heard = np.abs((normal * ray).sum(axis=1)) >= math.cos(math.radians(limit_deg)) * size
    return replace(mesh, reflectivity=jnp.asarray(heard, jnp.float32))


def _summary(
    devices: str, free: str, truth: Sequence[float | None], found: Sequence[dict[str, Any]]
) -> dict[str, Any]:  # fmt: skip
    """Errors over devices; those of the limit over the devices whose frames determine it."""
    row: dict[str, Any] = {"devices": devices, "free": free, "count": len(found)}
    tilt, height = (np.abs([one[name] for one in found]) for name in GEOMETRY)
    row |= {"tilt": np.median(tilt), "tilt_p90": np.percentile(tilt, 90), "height": np.median(height)}
    if free == "free":
        row["determined"] = np.mean([one["determined"] for one in found])
        row["least"] = min(one["limit"] for one in found)
        told = [(abs(one["limit"] - limit), one["std"]) for limit, one in zip(truth, found, strict=True)
                if one["determined"] and limit is not None]  # fmt: skip
        if told:
            error, std = np.array(told).T
            row |= {"limit": np.median(error), "p90": np.percentile(error, 90), "within_1": np.mean(error <= std)}
    return {name: value if isinstance(value, str | int) else float(value) for name, value in row.items()}


def table(report: Report) -> str:
    """Both kinds of devices, with the limit free and without."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"devices": 1, "frames": 3, "segmenter": "none"})
