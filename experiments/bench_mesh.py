"""What does a scan of very many triangles cost: to load, to reduce, in labels, and in a bank beside Embree's?

python -m experiments.bench_mesh [--preset smoke] [--help]

An irregular body with detail of millimetres is written as a file, read and reduced as the commands do it. The judge's
rays (Embree) label frames of the full and of the reduced mesh. Then a template bank of the reduced mesh is timed beside
the same views by Embree of the full one, in the same run (`bench_render` says how; --no-peer does without it).
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from experiments.bench_match import has, need, time_all
from experiments.bench_render import IN_BOX, OURS, TURNED, X_M, Embree, make_sonar
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from sonarjax.io import write_atomic
from sonarjax.render import reduced_for, template_bank
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar

SIZE_M, FLATNESS = 0.16, (1.2, 0.8, 0.8)
"""Radius of the body [m], about, and how it is stretched along x, y and z."""
SHAPE, DETAIL = (12, 1.5, 5.0), (60, 20.0, 80.0)
"""Waves of the body's shape and of its surface: how many, their least and largest wave number on a ball of radius 1."""
BUMPS, DETAIL_M = 0.22, 0.0015
"""Standard deviations of the shape, as a share of the radius, and of the detail [m]."""
MEASURES = {
    "load": ("load the file [s]", "≤ 5"),
    "reduce": ("reduce the mesh [s]", ""),
    "after": ("triangles left", ""),
    "usual": ("99 % of the surface within [mm]", ""),
    "largest": ("all of it within [mm]", ""),
    "equal": ("labels equal, of pixels that either mesh touches [%]", "≥ 99"),
    "pixels": ("labels equal, of all pixels [%]", "≥ 99"),
    "ours": ("bank of the reduced mesh, sonarjax [ms]", ""),
    "embree": ("the same views of the full mesh, Embree, all of the frame [ms]", ""),
    "box": ("in the templates' box alone, Embree [ms]", ""),
    "ratio": ("sonarjax / Embree, all of the frame", "≤ 1.5"),
    "box_ratio": ("sonarjax / Embree, in the box", ""),
}
"""What a row of the table says, and its bar."""
SMOKE = {"triangles": (20_000,), "poses": 1, "views": 9, "rounds": 1, "peer": has("open3d")}


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    triangles: tuple[int, ...] = (40_000, 500_000)
    """Triangles of the scans."""
    poses: int = 8
    """Poses at which labels are compared."""
    views: int = 36
    """Yaws of the bank, over the full circle."""
    elevations: int = 128
    """The peer's rays in each beam."""
    rounds: int = 9
    """Rounds of the bank, each times both sides once; the median counts."""
    peer: bool = True
    """Time Embree's bank too."""


def scan(triangles: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (vertex, 3) [m] and triangles of an irregular body that stands on z = 0: no two triangles alike."""
    count = triangles // 2 + 2
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, math.pi * (1 + math.sqrt(5)) * number
    planar = np.sqrt(1 - z * z)
    ball = np.stack([planar * np.cos(turn), planar * np.sin(turn), z], axis=1)
    ball += rng.normal(scale=0.5 / math.sqrt(count), size=ball.shape)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    faces = ConvexHull(ball).simplices
    a, b, c = (ball[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    radius = SIZE_M * (1 + BUMPS * _waves(ball, *SHAPE, rng)) + DETAIL_M * _waves(ball, *DETAIL, rng)
    points = ball * np.maximum(radius, SIZE_M / 3)[:, None] * FLATNESS
    return points - [0.0, 0.0, points[:, 2].min()], faces


def _waves(points: np.ndarray, count: int, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Plane waves in random directions at points (point, 3) of the unit ball, of standard deviation 1 about."""
    total = np.zeros(len(points))
    for _ in range(count):
        along = rng.normal(size=3)
        total += np.sin(points @ (along / np.linalg.norm(along) * rng.uniform(low, high)) + rng.uniform(0, 2 * math.pi))
    return total * math.sqrt(2 / count)


def write_stl(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """A binary STL file."""
    record = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    record["corners"] = vertices[faces]
    header = bytes(80) + np.uint32(len(faces)).tobytes()
    write_atomic(path, lambda file: file.write(header + record.tobytes()))


def labels_of(mesh: Mesh, sonar: Sonar, poses: np.ndarray) -> np.ndarray:
    """The judge's labels (pose, range, beam) of a mesh at `poses` (pose, 3): x, y [m], yaw [rad]."""
    from experiments.judge.device import Device
    from experiments.judge.frames import surface
    from experiments.judge.labels import labels
    from experiments.judge.raycast import cast, place
    from experiments.judge.view import View

    view, device, body = View.of(sonar, float(sonar.tilt), float(sonar.height)), Device(), surface(mesh)
    return np.stack([labels(cast(place(*body, *map(float, pose)), view), device) for pose in poses])


def measure(triangles: int, settings: Settings, seed: int) -> dict[str, Any]:
    """One row: a scan of that many triangles."""
    rng, sonar = np.random.default_rng([seed, triangles]), make_sonar()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.stl"
        write_stl(path, *scan(triangles, rng))
        load, mesh = _timed(lambda: Mesh.load(path))
    reduce, found = _timed(lambda: reduced_for(mesh, sonar))
    spread = np.array([0.15, 0.1, math.pi])
    poses = np.array([X_M, 0.0, math.pi]) + rng.uniform(-1, 1, (settings.poses, 3)) * spread
    full, reduced = (labels_of(one, sonar, poses) for one in (mesh, found.mesh))
    either = (full > 0) | (reduced > 0)
    row = {
        "triangles": found.before, "load": load, "reduce": reduce, "after": found.after,
        "usual": 1e3 * found.error.usual, "largest": 1e3 * found.error.largest,
        "equal": 100 * float((full == reduced)[either].mean()), "pixels": 100 * float((full == reduced).mean()),
    }  # fmt: skip
    return row | _bank_times(mesh, found.mesh, sonar, settings)


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def _bank_times(mesh: Mesh, reduced: Mesh, sonar: Sonar, settings: Settings) -> dict[str, Any]:
    """Milliseconds of a bank: ours of the reduced mesh, Embree's of the full one, which is not told the box or is."""
    yaws = np.arange(settings.views) * (2 * np.pi / settings.views)
    render = partial(template_bank, reduced, sonar, yaws, x=X_M, engine=engine())
    sides = {OURS: lambda: np.asarray(render().templates)}
    if settings.peer:
        bank = render()
        row, column = np.asarray(bank.offset).tolist()
        frame = Embree(mesh, sonar, settings.elevations)
        part = Embree(mesh, sonar, settings.elevations, (row, column, *bank.templates.shape[1:]))
        sides |= {TURNED: lambda: frame.turned_rays(X_M, yaws), IN_BOX: lambda: part.turned_rays(X_M, yaws)}
    seconds, _ = time_all(sides, settings.rounds)
    ours, embree, box = (seconds.get(side, math.nan) for side in (OURS, TURNED, IN_BOX))
    return {
        "ours": 1e3 * ours, "embree": 1e3 * embree, "box": 1e3 * box, "ratio": ours / embree, "box_ratio": ours / box
    }  # fmt: skip


def run(settings: Settings, job: Job) -> Report:
    """A row for each scan; the machine's load before and after."""
    need("embreex", "embreex (Embree, extra bench)")
    if settings.peer:
        need("open3d", "Open3D")
    load = os.getloadavg()[0]
    cases = {f"{count} triangles": count for count in settings.triangles}
    found = job.map(lambda count: measure(count, settings, job.seed), cases, "scans")
    return {"rows": list(found.values()), "load": [load, os.getloadavg()[0]], "views": settings.views}


def table(report: Report) -> str:
    """A column for each scan."""
    before, after = report["load"]
    scans = {str(row["triangles"]): row for row in report["rows"]}
    shown = [
        {"what": what, "bar": limit} | {name: row[key] for name, row in scans.items()}
        for key, (what, limit) in MEASURES.items()
    ]
    heads = {"what": "what", "bar": "bar"} | {name: f"{int(name):,} triangles" for name in scans}
    text = columns(shown, heads)
    return f"{text}\n\nbanks of {report['views']} views; load {before:.1f} to {after:.1f} on {os.cpu_count()} cores"


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
