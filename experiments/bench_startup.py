"""How long does the first frame take, and each further one? This tree beside an older commit of it, in the same run.

python -m experiments.bench_startup [--preset smoke] [--help]

`python -m sonarjax recognize` of one frame in a process that finds its cache empty and in a second one that finds it
full, and the seconds a frame of a process that goes on: frames one by one, and a batch of them, which the older commit
takes one by one too. Both sides read the same frames, mesh and sonar, in turn; of several rounds the fastest counts,
since other programs only ever slow one down. The older commit is checked out into a temporary folder, with git, and
runs on the packages that are installed.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, observed, sonar_for
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns
from experiments.common.progress import Progress
from experiments.common.runs import ROOT, Job
from sonarjax.cpu import FLAGS
from sonarjax.io import SonarjaxError, write_npz, write_text
from sonarjax.sensor import SensorModel

TILT_DEG = 20.0
OLD, NEW = "old", "new"
MEASURES = {
    "cold": "first process, its cache empty [s]",
    "warm": "second process, its cache full [s]",
    "steady": "a further frame in one process [s]",
    "batch": "a frame of a batch [s]",
}
HEADS = {"what": "what", OLD: "old", NEW: "this tree", "ratio": "old / this tree"}
SMOKE = {"sides": (NEW,), "segmenter": "none", "refine": False, "frames": 1, "rounds": 1}
COMMON = """
import json, sys, time
from pathlib import Path
import numpy as np
folder, segmenter, refine, frames = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "True", int(sys.argv[4])
{setup}
import sonarjax as sj
mesh, sonar = sj.Mesh.load(folder / "target.off"), sj.Sonar.from_toml(folder / "sonar.toml")
{recognizer}
images = [np.load(folder / f"frame_{{k}}.npz")["image"] for k in range(frames)]
for image in images:
    recognize(image)
seconds = []
for image in images:
    started = time.perf_counter()
    recognize(image)
    seconds.append(time.perf_counter() - started)
started = time.perf_counter()
done = sum(1 for _ in batch(images))
each = (time.perf_counter() - started) / done
print(json.dumps({{"package": sj.__file__, "steady": float(np.median(seconds)), "batch": each}}))
"""
SCRIPTS = {
    OLD: COMMON.format(
        setup="from sonarjax._cache import enable_compilation_cache\nenable_compilation_cache()",
        recognizer="def recognize(image): sj.recognize(image, mesh, sonar, segmenter=segmenter, refine=refine)\n"
        "def batch(images): return map(recognize, images)",
    ),
    NEW: COMMON.format(
        setup="from sonarjax import cpu\nfrom sonarjax.refine import MAP_REFINEMENT\ncpu.tune()",
        recognizer="recognize = sj.Recognizer(mesh, sonar, segmenter=segmenter, engine=cpu.CpuEngine(), "
        "refine=MAP_REFINEMENT if refine else None)\nbatch = recognize.stream",
    ),
}
"""What a process of each side runs, where frames follow each other: each goes about it as its own command line does."""


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    commit: str = "f99308b"
    """The older side: a commit whose `sonarjax.recognize` keeps its own banks."""
    sides: tuple[Literal["old", "new"], ...] = (OLD, NEW)
    """Which of both are timed."""
    segmenter: Literal["pix2pix", "none", "otsu"] = "pix2pix"
    """What makes the map that is matched."""
    refine: bool = True
    """Refine the yaw."""
    frames: int = 12
    """Frames of the process that goes on."""
    rounds: int = 2
    """Rounds; each times both sides once, with caches of their own."""


def make_files(folder: Path, count: int, seed: int) -> None:
    """The target, the sonar and `count` frames at random yaws, as files that either side reads."""
    mesh, sonar = sj.objects.target(), sonar_for(TILT_DEG)
    faces = np.asarray(mesh.faces)
    faces = faces[faces[:, 0] != faces[:, 1]]  # without padding
    lines = ["OFF", f"{len(mesh.vertices)} {len(faces)} 0", *(_line(v) for v in np.asarray(mesh.vertices))]
    write_text(folder / "target.off", "\n".join([*lines, *(f"3 {_line(face)}" for face in faces), ""]))
    write_text(folder / "sonar.toml", f'preset = "didson-hf"\ntilt_deg = {TILT_DEG}\n')
    model = SensorModel.nominal()
    with Progress("simulating frames", count, unit="frame", leave=False) as progress:
        for k, key in enumerate(jax.random.split(jax.random.key(seed), count)):
            turn, noise = jax.random.split(key)
            with progress.part(f"frame {k}"):
                pose = sj.Pose(GROUND_RANGE_M[TILT_DEG], 0.0, jax.random.uniform(turn, maxval=2 * math.pi))
                image, _ = observed(mesh, pose, sonar, model, key=noise)
                write_npz(folder / f"frame_{k}.npz", image=np.asarray(image))


def _line(values: Sequence[Any]) -> str:
    return " ".join(str(value) for value in values)


@contextmanager
def checked_out(commit: str, folder: Path) -> Iterator[Path]:
    """The files of a commit below `folder`, which are gone afterwards. Raises Skipped where git does not give them."""
    tree = folder / "tree"
    _git("worktree", "add", "--detach", str(tree), commit)
    try:
        yield tree
    finally:
        _git("worktree", "remove", "--force", str(tree))


def _git(*arguments: str) -> None:
    try:
        subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except OSError as error:
        raise Skipped(f"git is not there: --sides new does without the older commit ({error})") from error
    except subprocess.CalledProcessError as error:
        raise Skipped(f"git {arguments[0]} failed: {error.stderr.strip()}") from error


def run(settings: Settings, job: Job) -> Report:
    """A row for each measure; what each round gave; the machine's load before and after."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        files = Path(name)
        make_files(files, settings.frames, job.seed)
        if OLD in settings.sides:
            with checked_out(settings.commit, files) as tree:
                found = _rounds(settings, job, files, {OLD: tree, NEW: ROOT})
        else:
            found = _rounds(settings, job, files, {NEW: ROOT})
    best = {
        side: {key: min(one[key] for name, one in found.items() if name.startswith(side)) for key in MEASURES}
        for side in settings.sides
    }
    rows = [{"what": what} | _compared({side: best[side][key] for side in best}) for key, what in MEASURES.items()]
    return {"commit": settings.commit, "rows": rows, "rounds": found, "load": [load, os.getloadavg()[0]]}


def _compared(seconds: dict[str, float]) -> dict[str, float]:
    both = {"ratio": seconds[OLD] / seconds[NEW]} if len(seconds) > 1 else {}
    return seconds | both


def _rounds(settings: Settings, job: Job, files: Path, trees: dict[str, Path]) -> dict[str, dict[str, float]]:
    """Seconds by measure, by the name of side and round; which side goes first changes from round to round."""
    cases = {
        f"{side}, round {number}": side
        for number in range(settings.rounds)
        for side in settings.sides[:: 1 if number % 2 == 0 else -1]
    }
    return job.map(lambda side: measure(side, trees[side], files, settings), cases, "startup")


def measure(side: str, tree: Path, files: Path, settings: Settings) -> dict[str, float]:
    """Seconds by measure of one side, whose package lies in `tree`, from an empty cache on."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        start = partial(_process, tree, Path(name) / "cache")
        for key in ("cold", "warm"):
            out = Path(name) / f"{key}.jsonl"
            options = ["--segmenter", settings.segmenter, *([] if settings.refine else ["--no-refine"])]
            asked = ["--target", files / "target.off", "--sonar", files / "sonar.toml", "--out", out, *options]
            started = time.perf_counter()
            start("-m", "sonarjax", "recognize", files / "frame_0.npz", *asked)
            found[key] = time.perf_counter() - started
            if "error" in json.loads(out.read_text(encoding="utf-8")):
                raise SonarjaxError(f"{side}: {out.read_text(encoding='utf-8')}")
        said = start("-c", SCRIPTS[side], files, settings.segmenter, settings.refine, settings.frames)
    facts = json.loads(said.splitlines()[-1])
    if not Path(facts["package"]).resolve().is_relative_to(tree.resolve()):
        raise SonarjaxError(f"{side}: {facts['package']} was timed, expected the package in {tree}")
    return found | {key: facts[key] for key in ("steady", "batch")}


def _process(tree: Path, cache: Path, *arguments: Any) -> str:
    """What Python prints, started in `tree` with a cache of its own, and none of the settings of this process."""
    env = os.environ | {"SONARJAX_CACHE_DIR": str(cache), "PYTHONPATH": str(tree)}
    for name in ("SONARJAX_NO_CACHE", "JAX_COMPILATION_CACHE_DIR"):
        env.pop(name, None)
    # `tune` has added its flags to those of the user.
    env["XLA_FLAGS"] = " ".join(flag for flag in env.get("XLA_FLAGS", "").split() if flag not in FLAGS)
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, cwd=tree, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SonarjaxError(f"{' '.join(command[1:4])} in {tree}: {done.stderr[-2000:]}")
    return done.stdout


def table(report: Report) -> str:
    """A row for each measure."""
    before, after = report["load"]
    load = f"load {before:.1f} to {after:.1f} on {os.cpu_count()} cores; old: commit {report['commit']}"
    return f"{columns(report['rows'], HEADS)}\n\n{load if OLD in report['rows'][0] else load.partition(';')[0]}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
