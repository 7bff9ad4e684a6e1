"""How many frames a second does `sonarjax dataset` write, beside writing the same files alone, and in how much memory?

python -m experiments.bench_dataset [--preset smoke] [--help]

A DIDSON, two piles of bricks, a device drawn for each frame. Each format is written twice: the frames are simulated, or
read into memory before and only encoded and written, by the same threads and the same atomic writes. Of several rounds
the fastest counts. Peak memory is that of a command of its own, for a few frames and for many.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from PIL import Image

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.progress import Progress
from experiments.common.runs import Job
from sonarjax.data import FORMATS, FrameSettings, make_dataset
from sonarjax.data.folder import MANIFEST, STORED
from sonarjax.data.formats import Axes, Item, png_bytes
from sonarjax.data.frames import CHUNK
from sonarjax.io import SonarjaxError, write_atomic

HEADS = {"format": "format", "scenes": "objects, up to", "made": "made [frames/s]", "alone": "written alone [frames/s]",
         "share": "made / alone", "pngs": "images alone as PNG [frames/s]", "kib": "a frame [KiB]"}  # fmt: skip
MEMORY = {"frames": "frames", "peak_mib": "peak memory [MiB]"}
SHOWN = 6


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    count: int = 96
    """Frames of each data set."""
    scenes: tuple[int, ...] = (1, 3)
    """Most objects in a frame."""
    formats: tuple[Literal["png", "npz", "coco", "yolo"], ...] = ("png", "npz", "coco", "yolo")
    """Formats."""
    rounds: int = 2
    """Rounds, of which the fastest counts."""
    memory: tuple[int, ...] = (64, 640)
    """Frames of the commands whose peak memory is measured; of format coco."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each format and number of objects; a row for each peak; `frames.npz` has frames to look at."""
    rows, load = [], os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        for scenes in settings.scenes:
            first = Path(name) / f"first_{scenes}"
            _make(first, settings.count, scenes, "png", job.seed)  # compiles
            items = list(read_items(first))
            for format in settings.formats:
                rows.append(_row(Path(name), items, format, scenes, settings, job.seed))
        shown = items[:SHOWN]
        pictures = {key: np.stack([getattr(v, key) for v in shown]) for key in ("image", "labels", "instances")}
        job.arrays("frames", **pictures)
        peaks = [{"frames": n, "peak_mib": peak_memory(Path(name), n)} for n in settings.memory]
    return {"rows": rows, "memory": peaks, "cores": len(os.sched_getaffinity(0)), "load": [load, os.getloadavg()[0]]}


def _meshes() -> dict[str, sj.Mesh]:
    return {"target": sj.objects.target(), "non_target": sj.objects.non_target()}


def _make(folder: Path, count: int, scenes: int, format: str, seed: int) -> None:
    how: dict[str, Any] = {"settings": FrameSettings(scenes=scenes), "format": format, "engine": engine()}
    with Progress(f"{format}, up to {scenes}", count, unit="frame", leave=False) as bar:
        make_dataset(
            _meshes(), sonar_for(20.0), folder, count, key=jax.random.key(seed), **how,
            progress=lambda frames: [bar.done() for _ in range(frames)],
        )  # fmt: skip


def read_items(folder: Path) -> list[Item]:
    """The frames of a data set of PNGs, in memory."""
    names = list(_meshes())
    found = []
    for line in map(json.loads, (folder / MANIFEST).read_text(encoding="utf-8").splitlines()):
        image, grey, instances = (_pixels(folder / line[key]) for key in ("image", "labels", "instances"))
        labels = np.argmax(grey[..., None] == STORED, axis=-1).astype(np.uint8)
        objects = line["objects"]
        poses = [[entry["x_m"], entry["y_m"], np.radians(entry["yaw_deg"])] for entry in objects]
        meshes = [names.index(entry["mesh"]) for entry in objects]
        found.append(Item(line["number"], image, labels, instances, meshes, poses))
    return found


def _pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def _row(folder: Path, items: list[Item], format: str, scenes: int, settings: Settings, seed: int) -> dict[str, Any]:
    made, alone, pngs = [], [], []
    for number in range(settings.rounds):
        out = folder / f"{format}_{scenes}_{number}"
        made.append(_rate(settings.count, lambda out=out: _make(out, settings.count, scenes, format, seed)))
        alone.append(_rate(settings.count, lambda out=out: _write(out.with_name(out.name + "_alone"), items, format)))
        pngs.append(_rate(settings.count, lambda out=out: _write(out.with_name(out.name + "_png"), items, None)))
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / 1024 / settings.count
    return {
        "format": format, "scenes": scenes, "made": max(made), "alone": max(alone), "share": max(made) / max(alone),
        "pngs": max(pngs), "kib": size,
    }  # fmt: skip


def _rate(count: int, work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return count / (time.perf_counter() - begun)


def _write(folder: Path, items: Sequence[Item], format: str | None) -> None:
    """The files of all frames, or their images alone as PNG: encoded by the engine's threads, written by this one."""
    sonar = sonar_for(20.0)
    edges = np.linspace(float(sonar.range_min), float(sonar.range_max), sonar.n_ranges + 1)
    axes = Axes(np.degrees(np.asarray(sonar.azimuth)), edges, tuple(_meshes()))
    for name in ("images", "labels", "instances", "frames"):
        (folder / name).mkdir(parents=True)
    for files in engine().stream(encode, (axes, format), [items[k : k + CHUNK] for k in range(0, len(items), CHUNK)]):
        for name, content in files.items():
            write_atomic(folder / name, lambda file, content=content: file.write(content))


def encode(shared: tuple[Axes, str | None], items: Sequence[Item], _: sj.Engine) -> dict[str, bytes]:
    """Files of some frames by name."""
    axes, format = shared
    if format is None:
        return {f"images/{item.number:08d}.png": png_bytes(item.image) for item in items}
    files: dict[str, bytes] = {}
    for item in items:
        files |= FORMATS[format](item, axes)[0]
    return files


def peak_memory(folder: Path, count: int) -> float:
    """Peak memory [MiB] of `sonarjax dataset` for `count` frames. Raises SonarjaxError when it fails."""
    (folder / "sonar.toml").write_text('preset = "didson-hf"\ntilt_deg = 20\n', encoding="utf-8")
    mesh, lines = sj.objects.target(), ["OFF"]
    faces = np.asarray(mesh.faces)
    faces = faces[faces[:, 0] != faces[:, 1]]
    lines += [f"{len(mesh.vertices)} {len(faces)} 0", *(" ".join(map(str, v)) for v in np.asarray(mesh.vertices))]
    lines += [" ".join(map(str, (3, *face))) for face in faces]
    (folder / "target.off").write_text("\n".join(lines) + "\n", encoding="utf-8")
    command = [sys.executable, "-m", "sonarjax", "dataset", folder / "target.off", "--sonar", folder / "sonar.toml",
               "--count", count, "--out", folder / f"memory_{count}", "--format", "coco"]  # fmt: skip
    process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SonarjaxError(f"sonarjax dataset --count {count} ended with {process.returncode}")
    return usage.ru_maxrss / 1024


def table(report: Report) -> str:
    """Frames a second, then peak memory."""
    text = columns(report["rows"], HEADS)
    if report["memory"]:
        text += "\n\n" + columns(report["memory"], MEMORY)
    before, after = report["load"]
    return f"{text}\n\nCores: {report['cores']}; load average {before:.1f} before, {after:.1f} after"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 16, "scenes": (1,), "formats": ("coco",), "rounds": 1, "memory": ()})
