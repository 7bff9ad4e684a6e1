"""Work shared among Dask workers: results are those of one process, and a worker killed at any moment costs only time.

Each cluster here is a real LocalCluster of processes; what is killed is killed with SIGKILL.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from tests.cli.files import content

distributed = pytest.importorskip("distributed")

from sonarjax.cluster import ClusterEngine, connect  # noqa: E402
from sonarjax.engine import PLAIN  # noqa: E402
from sonarjax.io import SonarjaxError  # noqa: E402

PROJECT = Path(__file__).resolve().parent.parent
pytestmark = [pytest.mark.filterwarnings("ignore")]  # Dask's own, while its processes come and go


def slow_square(shared: int, item: int, engine: object) -> tuple[int, int]:
    """Half a second of work, and who did it."""
    time.sleep(0.5)
    return shared + item * item, os.getpid()


def stumble(shared: int, item: int, engine: object) -> int:
    """Fails at one item."""
    if item == shared:
        raise SonarjaxError(f"item {item}: expected another")
    return item


# ---------------------------------------------------------------- without a cluster


class Now:
    """A client whose tasks are done at once; of the first of them Dask gives up twice."""

    def __init__(self) -> None:
        self.failures, self.most, self.running = 2, 0, 0

    def nthreads(self) -> dict[str, int]:
        return {"a": 1, "b": 2}

    def submit(self, function, *args, pure):
        value = function(*(getattr(one, "value", one) for one in args))
        self.running += 1
        self.most = max(self.most, self.running)

        def result(timeout=None):
            if self.failures and len(args) > 1:
                self.failures -= 1
                raise distributed.KilledWorker("task", SimpleNamespace(address="tcp://nowhere"), 4)
            self.running -= 1
            return value

        return SimpleNamespace(value=value, result=result)


def test_results_come_in_order_few_at_a_time_and_death_is_no_end(monkeypatch):
    monkeypatch.setattr("sonarjax.cluster._own_engine", lambda: PLAIN)
    client = Now()
    taken = iter(range(1000))
    stream = ClusterEngine(client).stream(stumble, -1, taken)
    assert [next(stream) for _ in range(50)] == list(range(50))
    assert next(taken) < 60  # the memory does not grow with the items
    assert client.most < 20


@pytest.mark.parametrize("engine", [PLAIN, None], ids=["plain", "cpu"])
def test_streams_here_are_in_order_and_bounded(engine):
    from sonarjax.cpu import CpuEngine

    taken = iter(range(1000))
    stream = (engine or CpuEngine()).stream(stumble, 40, taken)
    assert [next(stream) for _ in range(20)] == list(range(20))
    assert next(taken) < 20 + 2 * (os.cpu_count() or 1) + 2
    with pytest.raises(SonarjaxError, match="item 40"):
        list(stream)


@pytest.mark.parametrize("address", ["", "local:", "local:0", "local:-1", "remote", "local:2:3x"])
def test_what_is_no_cluster_is_one_clear_error(address):
    with pytest.raises(SonarjaxError, match="--cluster: expected"), connect(address):
        pass


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file"),
        ("{", "expected the JSON file that a Dask scheduler writes"),
        ("[1]", "address: expected that of a Dask scheduler"),
        ('{"address": 1}', "address: expected that of a Dask scheduler"),
        ('{"address": "hello"}', "address: expected that of a Dask scheduler"),
    ],
)
def test_a_file_that_is_no_schedulers_is_one_clear_error(content, said, tmp_path):
    path = tmp_path / "scheduler.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SonarjaxError, match=f"--cluster: {path}: {said}"), connect(str(path)):
        pass


def test_a_network_travels_to_a_worker_as_it_is(rng):
    from distributed.protocol import deserialize, serialize

    import sonarjax as sj

    sent = sj.load_segmenter()
    there = deserialize(*serialize(sent))
    assert (there.name, there.threshold, there.tile, there.rule) == (sent.name, sent.threshold, sent.tile, sent.rule)
    jax.tree.map(np.testing.assert_array_equal, there.weights, sent.weights)
    image = rng.random((64, 32), np.float32)
    np.testing.assert_array_equal(there.semantic(image), sent.semantic(image))


# ---------------------------------------------------------------- with one


@pytest.mark.slow
def test_killed_workers_cost_nothing_but_time():
    with connect("local:2") as engine:
        pids, found = set(), []
        for value, pid in engine.stream(slow_square, 7, range(16)):
            found.append(value)
            pids.add(pid)
            if len(found) in (2, 5, 9):  # while both are at work
                for one in list(engine.client.run(os.getpid).values())[: 1 + len(found) // 5]:
                    os.kill(one, signal.SIGKILL)
    assert found == [7 + k * k for k in range(16)]
    assert len(pids) > 2


@pytest.mark.slow
def test_a_scheduler_is_found_by_its_file_and_without_workers_one_line_says_so(tmp_path, capsys, monkeypatch):
    def tell(message, kind):
        if "no workers are left" in message:
            raise SonarjaxError(message)

    with connect("local:1") as engine:
        cluster, (worker,) = engine.client.cluster, engine.client.nthreads()
        engine.client.write_scheduler_file(str(tmp_path / "scheduler.json"))
        with connect(str(tmp_path / "scheduler.json")) as other:
            assert list(other.stream(stumble, -1, range(3))) == [0, 1, 2]
        assert capsys.readouterr().err == ""
        assert {*engine.client.run(signal.getsignal, signal.SIGINT).values()} == {signal.SIG_IGN}
        engine.client.retire_workers([worker])
        with connect(cluster.scheduler_address) as other, pytest.raises(SonarjaxError, match="no workers are left"):
            monkeypatch.setattr("sonarjax.cluster.PATIENCE_S", 0.2)
            monkeypatch.setattr("sonarjax.cluster.complain", tell)
            list(other.stream(stumble, -1, range(3)))
        monkeypatch.undo()
        capsys.readouterr()
        with connect(cluster.scheduler_address):
            assert "has no workers yet: waiting for the first" in capsys.readouterr().err


@pytest.mark.slow
def test_an_error_of_an_item_is_the_error_of_the_stream():
    with connect("local:1") as engine, pytest.raises(SonarjaxError, match="item 3: expected another"):
        list(engine.stream(stumble, 3, range(10)))


def cache_in_use(shared: None, item: int, engine: object) -> tuple[str, int]:
    """Where this process keeps compiled code."""
    return str(jax.config.jax_compilation_cache_dir), os.getpid()


@pytest.mark.slow
def test_workers_share_the_cache_of_compiled_code():
    with connect("local:2") as engine:
        found = list(engine.stream(cache_in_use, None, range(20)))
    assert {folder for folder, _ in found} == {str(jax.config.jax_compilation_cache_dir)}


@pytest.fixture
def place(tmp_path) -> Path:
    """A folder with a sonar, a brick, and frames of it."""
    import sonarjax as sj

    (tmp_path / "sonar.toml").write_text(
        "n_beams = 24\nfield_of_view_deg = 29.0\nrange_min_m = 1.5\nrange_max_m = 4.0\nn_ranges = 64\n"
        "elevation_aperture_deg = 14.0\ntilt_deg = 20.0\nheight_m = 0.9\n"
    )
    brick = sj.objects.brick()
    faces = np.asarray(brick.faces)
    rows = [" ".join(["3", *map(str, face)]) for face in faces[faces[:, 0] != faces[:, 1]]]
    points = [" ".join(map(str, v)) for v in np.asarray(brick.vertices)]
    (tmp_path / "brick.off").write_text("\n".join(["OFF", f"{len(points)} {len(rows)} 0", *points, *rows, ""]))
    return tmp_path


def sonarjax(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sonarjax", *map(str, arguments)]
    return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False, timeout=500)


@pytest.mark.slow
def test_a_data_set_of_workers_that_are_killed_is_that_of_one_process(place):
    import sonarjax as sj
    from sonarjax.data import FrameSettings, make_dataset

    meshes, sonar = {"brick": sj.Mesh.load(place / "brick.off")}, sj.Sonar.from_toml(place / "sonar.toml")
    how = {"key": jax.random.key(3), "settings": FrameSettings(scenes=2), "format": "npz"}
    assert make_dataset(meshes, sonar, place / "one", 160, **how)
    with connect("local:2") as engine:
        stop, killed = threading.Event(), list[int]()

        def kill() -> None:
            while not stop.is_set() and not list(place.glob("many/parts/0*.jsonl")):
                time.sleep(0.01)
            for _ in range(2):
                killed.append(next(iter(engine.client.run(os.getpid).values())))
                os.kill(killed[-1], signal.SIGKILL)
                stop.wait(1.0)

        killer = threading.Thread(target=kill)
        killer.start()
        assert make_dataset(meshes, sonar, place / "many", 160, engine=engine, **how)
        stop.set()
        killer.join()
    assert len(set(killed)) == 2
    assert content(place / "many") == content(place / "one")


@pytest.mark.slow
def test_recognize_on_a_cluster_writes_the_lines_of_one_process(place):
    made = sonarjax(
        "dataset", place / "brick.off", "--sonar", place / "sonar.toml", "--count", 6, "--out", place / "set"
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    frames = sorted((place / "set" / "images").iterdir())
    frames.insert(3, place / "absent.png")
    lines = {}
    for name, options in (("one", ()), ("many", ("--cluster", "local:2"))):
        done = sonarjax(
            "recognize", *frames, "--target", place / "brick.off", "--sonar", place / "sonar.toml",
            "--segmenter", "none", "--out", place / f"{name}.jsonl", *options,
        )  # fmt: skip
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1 and "absent.png: no such file" in done.stderr
        lines[name] = [json.loads(line) for line in (place / f"{name}.jsonl").read_text().splitlines()]
        for line in lines[name]:
            line.pop("seconds", None)
    assert lines["one"] == lines["many"]
    assert [line["frame"] for line in lines["many"]] == [str(frame) for frame in frames]
    track = sonarjax(
        "recognize", frames[0], "--target", place / "brick.off", "--sonar", place / "sonar.toml",
        "--out", place / "t.jsonl", "--track", "--cluster", "local:1",
    )  # fmt: skip
    assert track.returncode == 2 and "--cluster or --track, not both" in track.stderr


def experiment(folder: Path, *arguments: object) -> list[dict]:
    command = [sys.executable, "-m", "experiments.yaw_basin", "--preset", "smoke", "--runs", folder, *arguments]
    done = subprocess.run(
        list(map(str, command)), cwd=PROJECT, capture_output=True, text=True, check=False, timeout=550
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    reports = [json.loads(path.read_text()) for path in sorted(folder.rglob("results.json"))]
    return [{k: v for k, v in report.items() if k not in ("command", "seconds", "git")} for report in reports]


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> tuple[Path, list[dict]]:
    """Two seeds on one process: the folder, and a report of each."""
    folder = tmp_path_factory.mktemp("alone")
    return folder, experiment(folder, "--seeds", 0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(0,), (0, 1)], ids=["parts", "seeds"])
def test_an_experiment_on_a_cluster_is_that_of_one_process(alone, tmp_path, seeds):
    folder, reports = alone
    assert experiment(tmp_path, "--seeds", *seeds, "--cluster", "local:2") == reports[: len(seeds)]
    wanted, found = (
        {path.relative_to(base): path.read_bytes() for path in base.rglob("*.npz")} for base in (folder, tmp_path)
    )
    assert len(found) == len(seeds) and found.items() <= wanted.items()


def test_benchmarks_are_not_shared(capsys):
    from experiments import bench_calibrate as bench
    from experiments.common.launch import launch

    with pytest.raises(SystemExit) as left:
        launch(bench.run, bench.Settings, bench.table, smoke={}, arguments=("--cluster", "local"))
    assert left.value.code == 2 and "a benchmark times one machine" in capsys.readouterr().err
