"""Results of experiments: runs/<experiment>/<hash of the settings>-s<seed>/results.json, and what was measured so far.

`Job.map` keeps each part of an experiment as soon as it is measured: an interrupted run goes on where it was. The same
code must go on with the same files: parts that other code or weights measured are forgotten. A finished run that is
started again measures anew, but for the first seeds of several that were interrupted in a later one.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

import sonarjax as sj
from experiments.common.progress import Progress
from sonarjax.io import SonarjaxError, write_atomic, write_npz, write_text
from sonarjax.io.jsonlines import JsonLines, plain
from sonarjax.io.outputs import make_folder

ROOT = Path(__file__).resolve().parents[2]
RESULTS, PARTS = "results.json", "parts.jsonl"
DATA = ("SONARJAX_EXTERNAL_DATA", "SONARJAX_REAL_DATA")
"""Variables of the environment that name folders of frames."""
Case = TypeVar("Case")
Files = dict[str, bytes]
Share = Callable[[list[str], dict[str, Any]], Iterable[tuple[dict[str, Any], Files]]]
"""Values by the names of parts, in the parts' order, and files of the run's folder by name; from the parts' names and
what was measured before."""


class Job:
    """One run of an experiment with one seed: its folder, and the parts that it has measured so far."""

    def __init__(self, folder: Path, seed: int, share: Share | None = None, read: str = "") -> None:
        """Make `folder`, and take up what an interrupted run of the same code left in it.

        With `share`, other processes measure the parts. `read` is a digest of the files that the run reads, see
        `files_digest`: parts that were measured with other files are forgotten too.
        """
        self.folder, self.seed, self._share, self._read = folder, seed, share, read
        make_folder(str(folder))
        self._path = folder / PARTS
        taken_up = self._taken_up()
        self.begun = taken_up is not None
        """Whether the same code was interrupted in this run, if only before its first part was measured."""
        self._done = taken_up or {}

    @property
    def finished(self) -> dict[str, Any] | None:
        """The results that the same code left here before; None without."""
        report = load_report(self.folder) if (self.folder / RESULTS).exists() else {}
        return report if self._origin.items() <= report.items() and not self.begun else None

    @property
    def key(self) -> jax.Array:
        """The root key of all that is random in the run."""
        return jax.random.key(self.seed)

    def map(
        self, measure: Callable[[Case], Any], cases: Mapping[str, Case] | Iterable[str], title: str
    ) -> dict[str, Any]:
        """`measure(case)` by the case's name, with a progress bar that says which; what was measured is left out.

        `measure` returns JSON's types (NumPy's are made plain). Cases share the accelerators where there are several.
        """
        named: dict[str, Any] = dict(cases) if isinstance(cases, Mapping) else {name: name for name in cases}
        parts = {name: f"{title}/{name}" for name in named}
        left = [name for name in named if parts[name] not in self._done]
        with JsonLines(self._path) as kept, Progress(title, len(named), initial=len(named) - len(left)) as progress:

            def part(name: str, device: jax.Device | None = None) -> None:
                with progress.part(name), jax.default_device(device):
                    keep(parts[name], measure(named[name]))

            def keep(part: str, value: Any) -> None:
                record = plain({"part": part, "value": value})
                kept.write(record)
                self._done[part] = record["value"]

            if self._share is None or not left:
                _spread(part, left)
            else:
                for found, files in self._share([parts[name] for name in left], dict(self._done)):
                    self.put(files)
                    for one, value in found.items():
                        keep(one, value)
                        progress.done()
        return {name: self._done[parts[name]] for name in named}

    def arrays(self, name: str, **arrays: Any) -> Path:
        """Keep arrays as `name`.npz in the run's folder, for the figures."""
        path = self.folder / f"{name}.npz"
        write_npz(path, **{key: np.asarray(value) for key, value in arrays.items()})
        return path

    def put(self, files: Files) -> None:
        """Keep files that another process made in a folder of its own."""
        for name, content in files.items():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_atomic(self.folder / name, lambda file, content=content: file.write(content))

    def finish(self, report: Mapping[str, Any]) -> None:
        """Write the results; the parts have served."""
        write_text(self.folder / RESULTS, json.dumps(plain({**report, "read": self._read}), indent=1) + "\n")
        self.drop_parts()

    def drop_parts(self) -> None:
        """Remove the file of parts, without which the run counts as finished."""
        self._path.unlink(missing_ok=True)

    def _taken_up(self) -> dict[str, Any] | None:
        """The parts of an interrupted run of the same code; None if there was none."""
        lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() else []
        records = [record for record in map(_record, lines) if record]
        if records and records[0] == self._origin:
            return {record["part"]: record["value"] for record in records[1:]}
        self._path.unlink(missing_ok=True)
        with JsonLines(self._path) as file:
            file.write(self._origin)
        return None

    @property
    def _origin(self) -> dict[str, Any]:
        """What must be the same for parts to be taken up."""
        return {"code": code_digest(), "read": self._read}


def _record(line: str) -> dict[str, Any]:
    """A line of the file of parts; nothing if a kill cut it short."""
    try:
        return dict(json.loads(line))
    except ValueError:
        return {}


def _spread(part: Callable[..., None], names: list[str]) -> None:
    """One part after another, or on accelerators one on each at a time."""
    devices = jax.local_devices()
    if len(devices) < 2 or devices[0].platform == "cpu":
        for name in names:
            part(name)
        return
    with ThreadPoolExecutor(len(devices)) as pool:
        list(pool.map(lambda job: part(job[1], devices[job[0] % len(devices)]), enumerate(names)))


def run_folder(runs: Path, experiment: str, settings: Mapping[str, Any], seed: int) -> Path:
    """The folder of one run: settings that differ never share one."""
    digest = hashlib.sha256(json.dumps(plain(settings), sort_keys=True).encode()).hexdigest()[:8]
    return runs / experiment / f"{digest}-s{seed}"


@dataclass(frozen=True)
class Run:
    """A finished run of an experiment."""

    folder: Path
    """Where it lies."""
    report: dict[str, Any]
    """Its results.json."""

    @property
    def smoke(self) -> bool:
        """Whether it was made with --preset smoke."""
        return self.report["preset"] == "smoke"

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Arrays that it kept. Raises SonarjaxError when they are not there."""
        return load_arrays(self.folder, name)


def load(runs: Path, experiment: str) -> Run:
    """The newest finished run: full ones, those with fewer changed settings and lower seeds first.

    `experiment` is its name, or as in a command with some of its settings: `ablate --vary tilt`. Raises SonarjaxError,
    which says how to make one, when there is none, and when what lies there is no report.
    """
    name, *options = experiment.split()
    names = (one.removeprefix("--").replace("-", "_") for one in options[::2])
    wanted = dict(zip(names, options[1::2], strict=True))
    command = f"python -m experiments.{experiment}"
    try:
        paths = runs.glob(f"{name}/*/{RESULTS}")
        found = [Run(path.parent, json.loads(path.read_text(encoding="utf-8"))) for path in paths]
        found = [run for run in found if not wanted or wanted.items() <= run.report["settings"].items()]
        newest = max(found, key=lambda run: (*_rank(run.report), (run.folder / RESULTS).stat().st_mtime), default=None)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        text = (
            f"{runs / name}: a results.json here comes from other code ({error!r}); remove it and run {command} again"
        )
        raise SonarjaxError(text) from error
    if newest is None:
        raise SonarjaxError(f"{runs / name}: no finished run; `{command}` makes one")
    return newest


def has_run(runs: Path, experiment: str) -> bool:
    """Whether an experiment has a finished run."""
    try:
        load(runs, experiment)
    except SonarjaxError:
        return False
    return True


def _rank(report: Mapping[str, Any]) -> tuple[bool, int, int]:
    return report["preset"] == "full", -len(report.get("changed", ())), -report["seed"]


def load_report(folder: Path) -> dict[str, Any]:
    """The results of a finished run. Raises SonarjaxError when they cannot be read."""
    try:
        return dict(json.loads((folder / RESULTS).read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise SonarjaxError(f"{folder / RESULTS}: expected the results of an experiment: {error}") from error


def load_arrays(folder: Path, name: str) -> dict[str, np.ndarray]:
    """Arrays that `Job.arrays` kept. Raises SonarjaxError when they are not there."""
    path = folder / f"{name}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            return dict(file)
    except (OSError, ValueError) as error:
        raise SonarjaxError(f"{path}: expected arrays of an experiment: {error}") from error


def circumstances() -> dict[str, Any]:
    """What a result depends on beside settings and seed: versions, code and machine."""
    return {
        "versions": {
            "sonarjax": sj.__version__,
            "jax": jax.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "git": git_hash(),
        "code": code_digest(),
        "device": jax.devices()[0].device_kind,
        "date": time.strftime("%Y-%m-%d"),
        "command": _command(sys.argv[1:]),
    }


def _command(arguments: list[str]) -> str:
    """What was typed, but for the folder of the results: it says nothing of them and everything of a machine."""
    apart = [word for one in arguments for word in (one.split("=", 1) if one.startswith("--") else [one])]
    at = apart.index("--runs") if "--runs" in apart else len(apart)
    name = getattr(sys.modules["__main__"].__spec__, "name", "?")
    return f"python -m {shlex.join([name, *apart[:at], *apart[at + 2 :]])}"


def git_hash() -> str | None:
    """The commit of the working tree, with a + where it was changed since; None outside of git."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        return git("rev-parse", "--short=10", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def files_digest(settings: Mapping[str, Any]) -> str:
    """A digest of what settings only name: the content of files, and the folders of `DATA` in the environment."""
    digest = hashlib.sha256(repr([os.environ.get(name) for name in DATA]).encode())
    for value in settings.values():
        for name in value if isinstance(value, tuple) else (value,):
            if isinstance(name, str) and name and Path(name).is_file():
                digest.update(name.encode() + Path(name).read_bytes())
    return digest.hexdigest()[:12]


@cache
def code_digest() -> str:
    """A digest of the package, its weights and the experiments: equal for equal code."""
    files = (p for folder in ("sonarjax", "experiments") for p in sorted((ROOT / folder).rglob("*")))
    digest = hashlib.sha256()
    for path in files:
        if path.suffix in (".py", ".safetensors"):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]
