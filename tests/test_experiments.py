"""Experiments: how they are started, where their results go, and small parts whose results are shipped or printed."""

from __future__ import annotations

import json
import re
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from experiments import __main__ as listing
from experiments.ablate import SWEEPS
from experiments.common import runs
from experiments.common.frames import STEP_DEG, paper_frames
from experiments.common.launch import Skipped, combined, launch, parse
from experiments.common.runs import Job, load, load_arrays, load_report, run_folder
from experiments.common.sets import mirrored
from experiments.fit_threshold import best_threshold
from sonarjax.data.pairs import SPLITS
from sonarjax.io import SonarjaxError
from sonarjax.scene import objects

FOLDER = Path(__file__).resolve().parents[1] / "experiments"
NOT_EXPERIMENTS = {"__init__", "__main__", "torch_pix2pix"}  # torch_pix2pix: what bench_train compares with


@dataclass(frozen=True)
class Options:
    """Settings of every kind."""

    count: int = 3
    """How many; 100 % of them."""
    share: float = 0.5
    """What share [1]."""
    sizes: tuple[int, ...] = (1, 2)
    """Which sizes."""
    kind: Literal["plain", "fancy"] = "plain"
    """Of which kind."""
    kinds: tuple[Literal["plain", "fancy"], ...] = ("plain",)
    """Of which kinds."""
    loud: bool = True
    """Whether to shout."""

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ValueError("--count must be 1 or more")


def run(options: Options, job: Job) -> dict[str, Any]:
    """An experiment of no time."""
    return {"rows": [{"name": "a", "value": float(job.seed), "count": options.count}]}


def table(report: dict[str, Any]) -> str:
    """Its rows."""
    return f"value {report['rows'][0]['value']:.2f}"


def options(*arguments: str) -> Options:
    return parse(Options, "", {"count": 1, "share": 0.1}, arguments)[0]


# ---------------------------------------------------------------- the command line


def test_without_arguments_all_is_as_the_settings_have_it():
    assert options() == Options()


def test_every_kind_of_field_is_an_option():
    given = ("--count", "7", "--share", "0.25", "--sizes", "5", "6", "--kind", "fancy", "--kinds", "fancy", "--no-loud")
    assert options(*given) == Options(7, 0.25, (5, 6), "fancy", ("fancy",), False)


def test_what_is_asked_for_goes_before_the_preset():
    assert options("--preset", "smoke") == Options(count=1, share=0.1)
    assert options("--preset", "smoke", "--count", "9") == Options(count=9, share=0.1)


@pytest.mark.parametrize(
    "arguments", [("--count", "x"), ("--count", "0"), ("--kind", "odd"), ("--kinds", "odd"), ("--nonsense",)]
)
def test_a_bad_argument_ends_with_2(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as left:
        options(*arguments)
    assert left.value.code == 2
    assert "error: " in capsys.readouterr().err


def test_help_has_the_strings_under_the_fields(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        options("--help")
    assert "How many; 100 % of them. (default: 3)" in " ".join(capsys.readouterr().out.split())


# ---------------------------------------------------------------- launching


def start(folder: Path, *arguments: str, run: Any = run) -> list[dict[str, Any]]:
    return launch(run, Options, table, smoke={"count": 1}, arguments=("--runs", str(folder), *arguments))


def test_results_say_what_they_depend_on(tmp_path: Path):
    (report,) = start(tmp_path, "--count", "4", "--seeds", "2")
    (path,) = tmp_path.rglob("results.json")
    kept = json.loads(path.read_text())
    assert path.parent == run_folder(tmp_path, "test_experiments", asdict(Options(count=4)), 2)
    assert kept["settings"]["count"] == 4 and kept["seed"] == 2 and kept["preset"] == "full"
    assert kept["changed"] == ["count"]
    assert {"sonarjax", "jax", "numpy", "python"} <= set(kept["versions"])
    assert {"git", "code", "device", "date", "command", "seconds"} <= set(kept)
    assert kept["rows"] == report["rows"]
    assert not list(tmp_path.rglob("parts.jsonl"))


def test_a_value_that_the_preset_has_anyway_is_no_change(tmp_path: Path):
    assert [start(tmp_path, "--count", n, "--preset", "smoke")[0]["changed"] for n in "12"] == [[], ["count"]]


def test_several_seeds_are_told_one_by_one_then_as_mean_and_spread(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    reports = start(tmp_path, "--seeds", "1", "2", "6")
    told = [float(value) for value in re.findall(r"value (\S+)", capsys.readouterr().out)]
    values = [report["rows"][0]["value"] for report in reports]
    np.testing.assert_allclose(told, [*values, 3.0, 3.0])  # mean of 1, 2 and 6, and what 6 is off


def test_seeds_that_were_done_before_an_interruption_are_not_measured_again(tmp_path: Path):
    measured = []

    def in_parts(options: Options, job: Job) -> dict[str, Any]:
        def measure(case: int) -> float:
            measured.append((job.seed, case))
            if measured.count((5, 1)) == 1 and measured[-1] == (5, 1):
                raise KeyboardInterrupt
            return float(case)

        values = job.map(measure, {str(k): k for k in range(2)}, "parts")
        return {"rows": [{"name": "a", "value": sum(values.values())}]}

    arguments = ("--seeds", "4", "5", "6")
    with pytest.raises(SystemExit):
        start(tmp_path, *arguments, run=in_parts)
    assert measured == [(4, 0), (4, 1), (5, 0), (5, 1)]
    assert [report["seed"] for report in start(tmp_path, *arguments, run=in_parts)] == [4, 5, 6]
    assert measured[4:] == [(5, 1), (6, 0), (6, 1)]
    start(tmp_path, *arguments, run=in_parts)  # nothing was interrupted: all is measured anew
    assert len(measured) == 13


def test_an_interruption_before_the_first_part_is_one(tmp_path: Path):
    measured: list[int] = []

    def at_once(options: Options, job: Job) -> dict[str, Any]:
        measured.append(job.seed)
        if measured == [4, 5]:
            raise KeyboardInterrupt
        return {"rows": [{"name": "a", "value": 1.0}]}

    with pytest.raises(SystemExit):
        start(tmp_path, "--seeds", "4", "5", run=at_once)
    assert len(start(tmp_path, "--seeds", "4", "5", run=at_once)) == 2
    assert measured == [4, 5, 5]


def test_a_reader_that_has_gone_and_a_folder_that_is_a_file_are_no_tracebacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    silenced: list[bool] = []
    monkeypatch.setattr("experiments.common.launch.silence_stdout", lambda: silenced.append(True))  # else pytest's own

    def broken(report: dict[str, Any]) -> str:
        raise BrokenPipeError

    with pytest.raises(SystemExit) as left:
        launch(run, Options, broken, smoke={"count": 1}, arguments=("--runs", str(tmp_path)))
    assert left.value.code == 141 and silenced
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="cannot be used as a folder"):
        start(tmp_path / "file")


@pytest.mark.parametrize("written", [["--runs", "/a b/c"], ["--runs=/a b/c"]])
def test_the_command_that_is_kept_names_no_folder_of_results(written: list[str]):
    assert runs._command(["--count=4", *written, "--seeds", "2"]).endswith(" --count 4 --seeds 2")


@pytest.mark.parametrize("seed", ["-1", "1000", "1.5"])
def test_seeds_are_not_those_of_validation_frames(seed: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        options("--seeds", seed)
    assert "whole number below 1000" in capsys.readouterr().err


def test_what_is_missing_ends_a_smoke_run_well_and_another_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    def lacking(options: Options, job: Job) -> dict[str, Any]:
        raise Skipped("no data here")

    assert start(tmp_path, "--preset", "smoke", run=lacking) == []
    assert capsys.readouterr().out == "skipped: no data here\n"
    with pytest.raises(SystemExit, match="test_experiments: no data here"):
        start(tmp_path, run=lacking)


@pytest.mark.parametrize(
    ("error", "code"), [(SonarjaxError("too wet"), "test_experiments: too wet"), (KeyboardInterrupt(), 130)]
)
def test_how_it_ends(tmp_path: Path, error: BaseException, code: object):
    def failing(options: Options, job: Job) -> dict[str, Any]:
        raise error

    with pytest.raises(SystemExit) as left:
        start(tmp_path, run=failing)
    assert left.value.code == code


def test_combined_is_numpys_mean_and_spread(rng: np.random.Generator):
    values = rng.normal(size=(3, 2, 2))
    reports = [
        {"name": "a", "count": 7, "rows": [{"x": float(x), "deep": {"y": float(y)}} for x, y in block]}
        for block in values
    ]
    reports[2]["rows"].append({"x": 0.0})  # a seed with more rows than the others
    for merge, numpys in ((lambda v: sum(v) / len(v), np.mean), (lambda v: max(v) - min(v), np.ptp)):
        found = combined(reports, merge)
        wanted = numpys(values, axis=0)
        assert found["name"] == "a" and found["count"] == 7
        np.testing.assert_allclose([[row["x"], row["deep"]["y"]] for row in found["rows"]], wanted)


def test_combined_merges_whole_numbers_and_leaves_out_what_a_seed_lacks():
    def mean(values: list[float]) -> float:
        return sum(values) / len(values)

    ours = {"errors": 0, "frames": 144, "score": 1, "rate": None, "right": True, "none": None}
    theirs = {"errors": 5, "frames": 144, "score": 0.5, "rate": 0.25, "right": False, "none": None}
    for pair in ([ours, theirs], [theirs, ours]):
        found = combined(pair, mean)
        assert found == {
            "errors": 2.5, "frames": 144, "score": 0.75, "rate": 0.25, "right": False, "none": None
        }  # fmt: skip


def test_combined_finds_rows_by_their_names():
    ours = [{"frames": "any", "auc": 0.9}, {"frames": "agree", "auc": 0.8}, {"frames": "symmetric", "auc": 0.5}]
    theirs = [{"frames": "any", "auc": 0.7}, {"frames": "symmetric", "auc": 0.4}]
    found = combined([ours, theirs], max)
    assert found == [{"frames": "any", "auc": 0.9}, {"frames": "symmetric", "auc": 0.5}]
    twice = [{"frames": "any", "auc": 0.1}, {"frames": "any", "auc": 0.2}]  # no names to tell them by
    assert combined([twice, twice[::-1]], max) == [{"frames": "any", "auc": 0.2}] * 2


# ---------------------------------------------------------------- runs and their parts


def test_every_setting_and_seed_has_its_own_folder(tmp_path: Path):
    settings = (Options(), Options(count=4), Options(sizes=(1,)), Options(loud=False))
    folders = {run_folder(tmp_path, "it", asdict(chosen), seed) for chosen in settings for seed in (0, 1)}
    assert len(folders) == 8
    assert run_folder(tmp_path, "it", asdict(Options()), 0) in folders


def interrupted(folder: Path) -> list[int]:
    """Start a job of five parts that is interrupted at the fourth; returns what it measured."""
    measured: list[int] = []

    def measure(number: int) -> dict[str, Any]:
        if number == 3:
            raise KeyboardInterrupt
        measured.append(number)
        return {"square": np.float32(number**2)}

    with pytest.raises(KeyboardInterrupt):
        Job(folder, 0).map(measure, {str(k): k for k in range(5)}, "numbers")
    return measured


def resumed(folder: Path) -> tuple[list[int], dict[str, Any]]:
    measured: list[int] = []

    def measure(number: int) -> dict[str, Any]:
        measured.append(number)
        return {"square": float(number**2)}

    return measured, Job(folder, 0).map(measure, {str(k): k for k in range(5)}, "numbers")


def test_an_interrupted_job_measures_only_what_is_left(tmp_path: Path):
    assert interrupted(tmp_path) == [0, 1, 2]
    with open(tmp_path / "parts.jsonl", "a") as file:
        file.write('{"part": "numbers/3", "val')  # a kill may cut a line short
    measured, found = resumed(tmp_path)
    assert measured == [3, 4]
    assert found == {str(k): {"square": k**2} for k in range(5)}


def test_parts_of_other_code_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    interrupted(tmp_path)
    monkeypatch.setattr(runs, "code_digest", lambda: "another")
    assert resumed(tmp_path)[0] == [0, 1, 2, 3, 4]


def test_parts_that_were_measured_with_other_files_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    weights = tmp_path / "weights.safetensors"
    settings = {"segmenter": str(weights), "trainings": (), "count": 3}
    digests = []
    for content in (b"a", b"a", b"b"):
        weights.write_bytes(content)
        digests.append(runs.files_digest(settings))
    monkeypatch.setenv("SONARJAX_REAL_DATA", str(tmp_path))
    assert digests[0] == digests[1] and len({*digests, runs.files_digest(settings)}) == 3

    measured = []
    for digest in ("a", "a", "b"):
        Job(tmp_path, 0, read=digest).map(lambda name: measured.append(name), ["one"], "parts")
    assert measured == ["one", "one"]


def test_a_finished_job_measures_anew(tmp_path: Path):
    resumed(tmp_path)
    Job(tmp_path, 0).finish({"rows": []})
    assert resumed(tmp_path)[0] == [0, 1, 2, 3, 4]


def test_parts_of_the_same_name_under_two_titles_are_two(tmp_path: Path):
    job = Job(tmp_path, 0)
    assert job.map(lambda name: 1.0, ["a"], "first") == {"a": 1.0}
    assert job.map(lambda name: 2.0, ["a"], "second") == {"a": 2.0}


def test_the_run_found_is_full_then_unchanged_then_of_the_lowest_seed(tmp_path: Path):
    runs = (("a", "smoke", [], 0), ("b", "full", [], 2), ("c", "full", [], 1), ("d", "full", ["vary"], 0),
            ("e", "full", ["vary", "size"], 0))  # fmt: skip
    for name, preset, changed, seed in runs:
        settings = {"vary": "tilt" if changed else "yaw", "size": 2}
        report = {"preset": preset, "changed": changed, "seed": seed, "settings": settings}
        Job(tmp_path / "it" / name, seed).finish(report)
    assert [load(tmp_path, name).folder.name for name in ("it", "it --vary tilt", "it --vary yaw")] == ["c", "d", "c"]
    with pytest.raises(SonarjaxError, match=r"`python -m experiments\.it --vary no` makes one"):
        load(tmp_path, "it --vary no")
    with pytest.raises(SonarjaxError, match=r"`python -m experiments\.other` makes one"):
        load(tmp_path, "other")


def test_arrays_come_back_and_what_is_not_there_is_named(tmp_path: Path, rng: np.random.Generator):
    values = rng.normal(size=(2, 3))
    Job(tmp_path, 0).arrays("curve", values=values)
    np.testing.assert_array_equal(load_arrays(tmp_path, "curve")["values"], values)
    with pytest.raises(SonarjaxError, match=r"other\.npz"):
        load_arrays(tmp_path, "other")
    with pytest.raises(SonarjaxError, match=r"results\.json"):
        load_report(tmp_path)


# ---------------------------------------------------------------- the experiments as a whole


def experiments() -> list[str]:
    return sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in NOT_EXPERIMENTS)


def test_all_experiments_are_launched():
    assert set(listing.questions()) == set(experiments())


def test_the_readme_has_all_experiments_and_no_others():
    rows = re.findall(
        r"^\|.*`python -m experiments\.([^`]+)`", (FOLDER / "README.md").read_text(encoding="utf-8"), re.M
    )
    assert len(rows) == len(set(rows)) and {row.split()[0] for row in rows} == set(experiments())
    assert {f"ablate --vary {vary}" for vary in SWEEPS} <= set(rows)


def test_the_list_has_every_question(capsys: pytest.CaptureFixture[str]):
    listing.main([])
    said = capsys.readouterr().out
    assert [line.split()[0] for line in said.splitlines()] == experiments()
    assert "How fast and how exact is eq. 4?" in said


def test_smoke_tells_of_each_and_fails_when_one_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    states = {"bench_match": ("skipped", "no peer"), "fit_threshold": ("failed", "it broke"), "yaw_basin": ("ok", "")}
    monkeypatch.setattr(listing, "smoke", lambda name, folder: states[name])
    with pytest.raises(SystemExit) as left:
        listing.main(["--smoke", *states])
    said = capsys.readouterr()
    assert left.value.code == 1
    assert re.search(r"bench_match .* skipped: no peer\n.*fit_threshold .* failed\n.*yaw_basin .* ok\n", said.out, re.S)
    assert "fit_threshold:\nit broke" in said.err
    listing.main(["--smoke", "yaw_basin"])
    with pytest.raises(SystemExit) as left:
        listing.main(["--smoke", "nonsense"])
    assert left.value.code == 2


def test_workers_run_smoke_presets_at_a_time(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Each of two waits until the other runs too; lines come in the order of the names."""
    both = threading.Barrier(2, timeout=60)
    monkeypatch.setattr(listing, "smoke", lambda name, folder: ("ok", str(both.wait())))
    listing.main(["--smoke", "yaw_basin", "bench_match", "--workers", "2"])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["yaw_basin", "bench_match"]
    with pytest.raises(SystemExit) as left:
        listing.main(["--smoke", "yaw_basin", "--workers", "0"])
    assert left.value.code == 2


# ---------------------------------------------------------------- parts whose results are shipped or printed


def test_frames_of_a_tilt_that_is_not_the_papers_are_refused():
    with pytest.raises(SonarjaxError, match="tilts_deg: expected some of 15, 20, 25, got 30"):
        paper_frames(0, tilts_deg=(20.0, 30.0))


@pytest.mark.parametrize("step_deg", [0, -10, 1, 2, 3, 7, 50])
def test_steps_that_do_not_divide_the_circle_or_meet_training_s_keys_are_refused(step_deg: int):
    with pytest.raises(SonarjaxError, match=f"multiple of 5 that divides 360, got {step_deg}"):
        paper_frames(0, step_deg=step_deg)
    assert all(number % STEP_DEG for number in SPLITS.values())  # what makes them disjoint


def test_best_threshold_is_the_middle_of_the_widest_run_of_least_errors():
    assert best_threshold(np.array([0.8, 0.9]), np.array([0.2, 0.4])) == np.float64(0.4 + 0.8) / 2
    # Cuts between 0.3 and 0.4 and between 0.6 and 0.9 err once, the one between 0.4 and 0.6 twice.
    target, other = np.array([0.4, 0.9, 0.95]), np.array([0.2, 0.3, 0.6])
    assert best_threshold(target, other) == 0.75


def test_a_mirrored_mesh_is_closed_and_another_object():
    mesh = objects.target()
    other = mirrored(mesh)
    ours, theirs = (np.asarray(m.vertices)[np.asarray(m.faces)] for m in (mesh, other))

    def volume(corners):
        return float(np.linalg.det(corners.astype(float)).sum() / 6)

    assert volume(ours) > 0  # faces look outwards
    np.testing.assert_allclose(volume(theirs), volume(ours), rtol=1e-5)
    np.testing.assert_allclose(theirs[..., 1].max(), -ours[..., 1].min(), atol=1e-6)


def test_the_command_that_is_kept_leaves_the_folder_of_results_out() -> None:
    kept = runs._command(["--seeds", "0", "1", "--runs", "/somewhere", "--step-deg", "30"])
    assert kept.endswith("--seeds 0 1 --step-deg 30") and "somewhere" not in kept
    assert runs._command(["--preset", "smoke"]).endswith("--preset smoke")
