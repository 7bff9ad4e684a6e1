"""A stream of frames: which files in which order, errors on the way, what is kept when it is cut off, tracking."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from experiments import recognize_stream
from experiments.common import stream
from experiments.common.runs import Job, code_digest, load_arrays
from experiments.recognize_stream import Settings
from sonarjax.io import Frame, SonarjaxError, write_npz
from sonarjax.sonar.toml import write_sonar

YAWS_DEG = (40.0, 43.0, 46.0)


@pytest.fixture(scope="module")
def sonar() -> sj.Sonar:
    """A small sonar with the paper's field of view."""
    azimuth = jnp.asarray(np.radians((np.arange(24) - 11.5) * 29 / 24), jnp.float32)
    return sj.Sonar.preset("didson-hf", tilt=math.radians(20.0)).replace(azimuth=azimuth, n_ranges=96)


@pytest.fixture(scope="module")
def frames(sonar: sj.Sonar) -> list[np.ndarray]:
    """Clean frames (range, beam) of the target at YAWS_DEG."""
    poses = [sj.Pose(2.3, 0.0, math.radians(yaw)) for yaw in YAWS_DEG]
    return [np.asarray(sj.render(sj.objects.target(), pose, sonar).semantic()) for pose in poses]


@pytest.fixture
def arguments(broken: dict[str, str], frames: list[np.ndarray]) -> dict[str, str]:
    """The same with three frames in the folder."""
    for number, image in zip((2, 9, 10), frames, strict=True):
        write_npz(Path(broken["source"]) / f"frame_{number}.npz", image=image)
    return broken


@pytest.fixture
def broken(tmp_path: Path, sonar: sj.Sonar) -> dict[str, str]:
    """A folder with one frame, which is broken; the target's mesh and the sonar as files."""
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "frame_3.npz").write_bytes(b"no archive")
    (folder / "notes.txt").write_text("not a frame")
    mesh = sj.objects.target()
    lines = [f"v {x} {y} {z}" for x, y, z in np.asarray(mesh.vertices)]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(mesh.faces) + 1 if len({a, b, c}) == 3]
    (tmp_path / "target.obj").write_text("\n".join(lines))
    write_sonar(sonar, tmp_path / "sonar.toml")
    return {
        "source": str(folder),
        "target": str(tmp_path / "target.obj"),
        "sonar": str(tmp_path / "sonar.toml"),
        "segmenter": "none",
    }


def records(path: Path) -> list[dict]:
    """The records of a file of JSON lines."""
    return [json.loads(line) for line in path.read_text().splitlines()]


# ---------------------------------------------------------------- the stream as a whole


@pytest.mark.slow
def test_a_broken_file_is_one_line_and_the_stream_goes_on(arguments, tmp_path, capfd):
    report = recognize_stream.run(Settings(**arguments), Job(tmp_path / "run", 0))
    (row,) = report["rows"]
    assert (row["way"], row["frames"], row["unreadable"], row["tracked"]) == ("recognize", 3, 1, 0.0)
    complaints = [line for line in capfd.readouterr().err.splitlines() if "recognize_stream:" in line]
    assert len(complaints) == 1
    assert "frame_3.npz" in complaints[0]
    found = records(tmp_path / "run" / "recognize.jsonl")
    assert [Path(r["frame"]).stem for r in found] == ["frame_2", "frame_3", "frame_9", "frame_10"]
    assert "error" in found[1]
    assert [r["number"] for r in found] == [0, 1, 2, 3]
    good = [r for r in found if "error" not in r]
    np.testing.assert_allclose([r["yaw_deg"] for r in good], YAWS_DEG, atol=3.0)
    assert [r["warm"] for r in good] == [False, True, True]
    assert load_arrays(tmp_path / "run", "recognize")["yaw_deg"].tolist() == [r["yaw_deg"] for r in good]
    assert (tmp_path / "run" / "recognize.png").stat().st_size > 1000
    assert "| recognize | 3 | 1 |" in recognize_stream.table(report)


@pytest.mark.slow
def test_tracking_recognizes_once_and_finds_the_same_yaws(arguments, tmp_path):
    settings = Settings(**arguments, track=True, track_on="frame")
    (row,) = recognize_stream.run(settings, Job(tmp_path / "run", 0))["rows"]
    assert row["way"] == "track frame"
    assert row["tracked"] == pytest.approx(2 / 3)
    good = [r for r in records(tmp_path / "run" / "track_frame.jsonl") if "error" not in r]
    assert [r["tracked"] for r in good] == [False, True, True]
    assert good[1]["yaw_bin_deg"] is None
    np.testing.assert_allclose([r["yaw_deg"] for r in good], YAWS_DEG, atol=3.0)


@pytest.mark.slow
def test_a_cut_off_stream_goes_on_after_its_last_line(arguments, tmp_path):
    run = tmp_path / "run"
    settings = Settings(**arguments)
    recognize_stream.run(settings, Job(run, 0))
    whole = (run / "recognize.jsonl").read_text().splitlines()
    Job(run, 0).finish({})  # else its part would be taken as it is
    (run / "recognize.jsonl").unlink()
    (run / f"recognize-{code_digest()}.jsonl").write_text("\n".join(whole[:2]) + "\n" + whole[2][:30])
    recognize_stream.run(settings, Job(run, 0))
    lines = (run / "recognize.jsonl").read_text().splitlines()
    assert lines[:2] == whole[:2]  # not measured again
    assert [Path(r["frame"]).stem for r in map(json.loads, lines[3:])] == ["frame_9", "frame_10"]


@pytest.mark.slow
def test_every_and_limit_pick_frames(arguments, tmp_path):
    settings = Settings(**arguments, every=2, limit=2)
    recognize_stream.run(settings, Job(tmp_path / "run", 0))
    found = records(tmp_path / "run" / "recognize.jsonl")
    assert [Path(r["frame"]).stem for r in found] == ["frame_2", "frame_9"]


def test_a_stream_without_a_frame_that_fits_says_so(broken, tmp_path):
    for number in (2, 3):
        write_npz(tmp_path / "frames" / f"frame_{number}.npz", image=np.zeros((5, 5)))
    with pytest.raises(SonarjaxError, match="none of its frames could be recognized"):
        recognize_stream.run(Settings(**broken), Job(tmp_path / "run", 0))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"source": "x.aris"}, "target"),
        ({"every": 0}, "every"),
        ({"limit": -1}, "limit"),
        ({"follow": 5.0}, "folder"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(wrong, said):
    with pytest.raises(SonarjaxError, match=said):
        Settings(**wrong)


# ---------------------------------------------------------------- its parts


@pytest.mark.slow
def test_a_belief_goes_through_a_broken_file(arguments, tmp_path):
    settings = Settings(**arguments, track=True, track_on="belief")
    (row,) = recognize_stream.run(settings, Job(tmp_path / "run", 0))["rows"]
    assert (row["way"], row["frames"], row["unreadable"]) == ("track belief", 3, 1)
    good = [r for r in records(tmp_path / "run" / "track_belief.jsonl") if "error" not in r]
    assert [r["tracked"] for r in good] == [False, True, True]
    yaws = np.array([r["yaw_deg"] for r in good])
    # The file that is broken stood between the first two.
    assert np.abs(yaws - YAWS_DEG).max() < 3


@pytest.mark.slow
def test_a_tracker_that_lost_its_object_recognizes_anew(sonar, frames):
    finder = stream.Finder(sj.objects.target(), sonar, "none", "track frame")
    assert finder(Frame(frames[0], None, "a", "a"))[1] is False
    finder.threshold = 2.0  # no probability reaches it: recognition fails
    finder.tracked_on = replace(finder.tracked_on, threshold=2.0)  # nor any correlation: tracking fails
    result, tracked = finder(Frame(frames[1], None, "b", "b"))
    assert not tracked
    assert not result.identified
    assert finder.last is None


def test_tracking_asks_for_a_correlation_where_there_is_one():
    plain = sj.load_segmenter("otsu")
    ruled = replace(sj.load_segmenter("none"), threshold=0.2)
    assert plain.rule is None and ruled.rule is not None
    assert stream.least_correlation(plain, None) == plain.threshold
    assert stream.least_correlation(plain, 0.6) == 0.6
    assert stream.least_correlation(ruled, 0.6) == 0.2  # 0.6 is a probability
    assert stream.least_correlation(replace(plain, threshold=None), 0.6) == 0.6
    for segmenter, threshold in ((replace(plain, threshold=None), None), (replace(ruled, threshold=None), 0.6)):
        with pytest.raises(SonarjaxError, match="threshold: tracking needs one"):
            stream.least_correlation(segmenter, threshold)


def test_files_are_taken_in_natural_order(tmp_path):
    for name in ("b.npz", "a10.npz", "a9.npz", "a9b.png", "A.PNG", "a.txt"):
        (tmp_path / name).touch()
    names = [path.name for path in stream.folder_files(tmp_path, 0.0)]
    assert names == ["A.PNG", "a9.npz", "a9b.png", "a10.npz", "b.npz"]


def test_a_followed_folder_gives_files_that_come_later_once_they_are_whole(tmp_path, monkeypatch):
    """A file grows at each of 20 polls; time passes by sleeping alone, so that a busy machine changes nothing."""
    (tmp_path / "1.npz").write_bytes(b"x")
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) <= 20:
            with open(tmp_path / "2.npz", "ab") as file:
                file.write(b"x" * 1000)

    monkeypatch.setattr(stream, "time", SimpleNamespace(monotonic=lambda: sum(slept), sleep=sleep))
    taken = [(path.name, path.stat().st_size) for path in stream.folder_files(tmp_path, 20.0)]
    assert taken == [("1.npz", 1), ("2.npz", 20_000)]
    assert sum(slept) == pytest.approx(20 * stream.POLL_S + 20.0, abs=2 * stream.POLL_S)  # it ends once none has come


def test_the_time_of_a_frame_is_read_where_its_file_tells_it():
    assert stream.seconds_of({"time_us": 2_500_000}) == 2.5
    first, second = (stream.seconds_of({"time": f"2024-01-02 03:04:{s}"}) for s in ("05.50", "06.75"))
    assert second - first == pytest.approx(1.25)
    assert stream.seconds_of({"time": "0000-00-00 00:00:00.00"}) is None
    assert stream.seconds_of({}) is None


def test_a_line_of_yaw_is_broken_where_a_turn_begins_anew():
    drawn = stream.broken(np.array([350.0, 358.0, 6.0, 14.0]))
    np.testing.assert_array_equal(np.isnan(drawn), [False, False, True, False])
