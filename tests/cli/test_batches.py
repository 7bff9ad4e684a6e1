"""`sonarjax segment`, `recognize` and `info`: the order, what is kept, the exit codes; slow parts are stand-ins."""

import json
import os
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sonarjax.cli.frames import each_frame
from sonarjax.io import Frame, write_bag, write_png
from sonarjax.io.safetensors import write_safetensors
from tests.cli.files import content, recording

SHAPE = (64, 24)
AZIMUTH, EDGES = (np.arange(24) - 11.5) * 29 / 24, np.linspace(1.5, 4.0, 65)


@pytest.fixture
def bad(tmp_path, place):
    """One frame of each kind that cannot be read, by what is said of it."""
    nan = np.full(SHAPE, np.nan, np.float32)
    np.save(tmp_path / "nan.npy", nan)
    np.save(tmp_path / "cube.npy", np.zeros((2, 3, 4), np.float32))
    np.savez(tmp_path / "other.npz", labels=np.zeros(SHAPE, np.uint8))
    (tmp_path / "short.aris").write_bytes(recording(1)[:1500])
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("words")
    names = {"nan.npy": "NaN", "cube.npy": "shape", "other.npz": "image", "short.aris": "truncated"}
    names |= {"empty.png": "empty", "notes.txt": "ending", "absent.npz": "no such file", ".": "folder"}
    return {str(tmp_path / name): said for name, said in names.items()}


@pytest.fixture
def recognize(command, place):
    """`recognize(frames, out, *options)` gives exit code, stderr and the records of `out`."""

    def run(frames, out, *options):
        target = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", out]
        code, stdout, err = command("recognize", *frames, *target, *options)
        assert stdout == ""
        assert "Traceback" not in err
        return code, err, [json.loads(line) for line in out.read_text().splitlines()]

    return run


def test_lines_come_in_order_and_are_appended(recognize, stand_in, place, tmp_path):
    out = tmp_path / "r.jsonl"
    frames = [place / "a.npz", place / "b.npy"]
    code, err, records = recognize(frames, out)
    assert (code, err) == (0, "")
    assert [record["frame"] for record in records] == [str(frame) for frame in frames]
    assert all(record["seconds"] > 0 and record["yaw_std_deg"] is None for record in records)
    _, _, records = recognize(frames[::-1], out)
    assert [record["frame"] for record in records] == [str(frame) for frame in frames + frames[::-1]]


def test_options_and_mask_reach_recognize(recognize, stand_in, place, tmp_path):
    recognize([place / "a.npz", place / "b.npy"], tmp_path / "r.jsonl")
    recognize(
        [place / "b.npy"], tmp_path / "r.jsonl", "--no-refine", "--threshold", "-.25", "--segmenter", "none"
    )  # fmt: skip
    first, second, third = stand_in.calls
    assert first["mask"].shape == SHAPE
    assert (
        {**first, "mask": None} == second == {"segmenter": "pix2pix", "refine": True, "threshold": None, "mask": None}
    )
    assert third == {"segmenter": "none", "refine": False, "threshold": -0.25, "mask": None}


def test_unreadable_frames_have_a_line_each_and_the_batch_goes_on(recognize, stand_in, bad, place, tmp_path):
    good = str(place / "a.npz")
    code, err, records = recognize([*bad, good], tmp_path / "r.jsonl")
    assert code == 1
    assert [record["frame"] for record in records] == [*bad, good]
    assert err.count("\n") == len(bad)
    for record, said in zip(records, bad.values(), strict=False):
        assert set(record) == {"frame", "error", "schema"}
        assert said in record["error"]
        assert record["error"].startswith(record["frame"])
    assert "score" in records[-1]


def test_a_frame_that_does_not_fit_the_sonar_is_an_error_line(recognize, stand_in, place, tmp_path):
    np.save(tmp_path / "wide.npy", np.zeros((64, 25), np.float32))
    code, err, records = recognize([tmp_path / "wide.npy", place / "b.npy"], tmp_path / "r.jsonl")
    assert code == 1
    assert f"{tmp_path}/wide.npy: image: expected" in err
    assert ["error" in record for record in records] == [True, False]


def test_a_fan_picture_is_sent_to_convert(recognize, stand_in, place, tmp_path):
    write_png(tmp_path / "fan.png", np.full((40, 30), 0.5))
    axes = {"azimuth_deg": np.linspace(-9, 9, 30), "range_edges_m": np.linspace(1, 2, 41)}
    np.savez(tmp_path / "polar.npz", image=np.full((40, 30), 0.5), **axes)
    _, _, (fan, polar) = recognize([tmp_path / "fan.png", tmp_path / "polar.npz"], tmp_path / "r.jsonl")
    assert fan["error"].startswith(f"{tmp_path}/fan.png: image: expected shape (64, 24)")
    assert "sonarjax convert" in fan["error"] and "--sonar" in fan["error"]
    assert "got (40, 30)" in polar["error"] and "convert" not in polar["error"]


@pytest.mark.parametrize(
    ("azimuth_deg", "edges", "said"),
    [
        (AZIMUTH, EDGES, ""),
        (AZIMUTH + 1.0, EDGES + 0.1, ""),  # less than a beam and three bins
        (AZIMUTH + 1.5, EDGES, "beam angles differ by up to 1.5 deg"),
        (AZIMUTH / 60, EDGES, "beam angles differ by up to 14 deg"),  # degrees were taken for radians
        (AZIMUTH, EDGES + 0.2, "range 1.7 to 4.2 m, not 1.5 to 4 m"),
        (AZIMUTH, np.linspace(1.5, 8.0, 65), "range 1.5 to 8 m, not 1.5 to 4 m"),
    ],
)
def test_a_header_that_contradicts_the_sonar_is_noted_once(
    recognize, stand_in, place, tmp_path, azimuth_deg, edges, said
):
    path = tmp_path / "own.npz"
    np.savez(path, image=np.full(SHAPE, 0.5, np.float32), azimuth_deg=azimuth_deg, range_edges_m=edges)
    code, err, records = recognize([path, place / "a.npz", path], tmp_path / "r.jsonl")
    assert code == 0 and all("score" in record for record in records) and len(records) == 3
    wanted = f"sonarjax: note: {path}: its header contradicts {place}/sonar.toml, which is used: {said}\n"
    assert err == (wanted if said else "")


def test_a_recording_gives_all_its_frames(recognize, stand_in, place, tmp_path):
    path = tmp_path / "three.aris"
    path.write_bytes(recording(3))
    sonar = tmp_path / "sonar.toml"
    sonar.write_text((place / "sonar.toml").read_text().replace("n_beams = 24", "n_beams = 48"))
    frames = [path, f"{path}:1", f"{path}:7"]
    code, err, records = recognize(frames, tmp_path / "r.jsonl", "--sonar", sonar)
    assert code == 1
    assert [record["frame"] for record in records] == [f"{path}:{n}" for n in (0, 1, 2, 1, 7)]
    assert ["error" in record for record in records] == [False] * 4 + [True]
    assert "frame 7: expected 0 to 2" in err
    assert err.count("its header contradicts") == 1  # one note for the file, not for each of its frames


def test_a_damaged_frame_of_a_recording_has_its_own_name(recognize, stand_in, place, tmp_path):
    pytest.importorskip("rosbags")
    content = bytearray(recording(4))
    for number in (1, 2):
        content[1024 + number * (1024 + 64 * 48) + 436] = 77  # PingMode
    path, sonar = tmp_path / "four.aris", tmp_path / "sonar.toml"
    path.write_bytes(content)
    sonar.write_text((place / "sonar.toml").read_text().replace("n_beams = 24", "n_beams = 48"))
    code, _, records = recognize([path, f"{path}:2"], tmp_path / "r.jsonl", "--sonar", sonar)
    assert code == 1
    assert [record["frame"] for record in records] == [f"{path}:{n}" for n in (0, 1, 2, 3, 2)]
    assert ["error" in record for record in records] == [False, True, True, False, True]


def test_a_damaged_frame_of_a_bag_has_its_own_name(tmp_path):
    pytest.importorskip("rosbags")
    geometry = {"azimuth_deg": [0.0, 1.0], "range_min_m": 0.0, "range_max_m": 1.0}
    path = str(tmp_path / "log.mcap")
    write_bag(path, [Frame(np.zeros((3, 2), np.float32), None, "f", "f", geometry)] * 2)
    content = Path(path).read_bytes()
    stated = struct.pack("<I", 3) + struct.pack("<3f", *(np.arange(3) + 0.5) / 3)  # `ranges`
    at = content.index(stated)
    Path(path).write_bytes(content[: at + 4] + bytes(4) + content[at + 8 :])  # of the first message
    named = [(name, isinstance(frame, Exception)) for spec in (path, f"{path}:0") for name, frame in each_frame([spec])]
    first, second = (f"{path}:/sonar_image:{number}" for number in range(2))
    assert named == [(first, True), (second, False), (first, True)]


def test_an_interrupt_keeps_what_is_written(recognize, stand_in, place, tmp_path):
    stand_in.unmasked = KeyboardInterrupt()
    code, err, records = recognize([place / "a.npz", place / "b.npy", place / "a.npz"], tmp_path / "r.jsonl")
    assert (code, err) == (130, "sonarjax: interrupted\n")
    assert len(records) == 1


FAILURES = [
    (ValueError("bad\nvalue"), "ValueError: bad value"),
    (MemoryError(), "MemoryError"),
    (FloatingPointError("overflow"), "FloatingPointError: overflow"),
    (RuntimeError("RESOURCE_EXHAUSTED: out of memory"), "RuntimeError: RESOURCE_EXHAUSTED: out of memory"),
    (OSError(5, "Input/output error"), "OSError: [Errno 5] Input/output error"),
    (RecursionError("too deep"), "RecursionError: too deep"),
]


@pytest.mark.parametrize(("failure", "said"), FAILURES, ids=[said.split(":")[0] for _, said in FAILURES])
def test_any_failure_of_one_frame_is_its_error_line(recognize, stand_in, place, tmp_path, failure, said):
    stand_in.unmasked = failure
    frames = [str(place / name) for name in ("a.npz", "b.npy", "a.npz")]
    code, err, records = recognize(frames, tmp_path / "r.jsonl")
    assert code == 1
    assert records[1] == {"frame": frames[1], "error": f"{frames[1]}: {said}", "schema": 2}
    assert err == f"sonarjax: error: {frames[1]}: {said}\n"
    assert "score" in records[0] and "score" in records[2]


@pytest.mark.parametrize(("failure", "said"), FAILURES, ids=[said.split(":")[0] for _, said in FAILURES])
def test_segment_goes_on_after_any_failure(command, stand_in, place, tmp_path, failure, said):
    stand_in.failures = {1: failure}
    code, out, err = command("segment", place / "a.npz", place / "b.npy", "--out-dir", tmp_path / "labels")
    assert (code, out, err) == (1, "", f"sonarjax: error: {place}/a.npz: {said}\n")
    assert os.listdir(tmp_path / "labels") == ["labels_b.npz"]


@pytest.mark.parametrize(("failure", "expected"), [(KeyboardInterrupt(), 130), (BrokenPipeError(), 141)])
def test_what_still_stops_a_batch(recognize, command, stand_in, place, tmp_path, monkeypatch, failure, expected):
    monkeypatch.setattr("sonarjax.cli.silence_stdout", lambda: None)
    stand_in.unmasked = failure
    frames = [place / "a.npz", place / "b.npy", place / "a.npz"]
    code, _, records = recognize(frames, tmp_path / "r.jsonl")
    assert (code, len(records)) == (expected, 1)
    stand_in.calls.clear()
    stand_in.failures = {2: failure}
    assert command("segment", *frames, "--out-dir", tmp_path / "labels")[0] == expected
    assert os.listdir(tmp_path / "labels") == ["labels_a.npz"]


@pytest.mark.parametrize("ending", [".npz", ".npy", ".png"])
def test_a_file_larger_than_memory_is_an_error_line(recognize, stand_in, place, tmp_path, ending):
    huge = tmp_path / f"huge{ending}"
    huge.touch()
    os.truncate(huge, 2**40)  # sparse: it takes no space on the disk
    code, _, records = recognize([huge, place / "b.npy"], tmp_path / "r.jsonl")
    assert code == 1
    assert records[0]["error"].startswith(f"{huge}: the file is too large")
    assert "score" in records[1]


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--target", "absent.stl", "no such mesh"),
        ("--target", "empty", "folder of meshes"),
        ("--target", "brick_mm.stl", "millimetres"),
        ("--sonar", "absent.toml", "no such file"),
        ("--sonar", "brick.stl", "TOML"),
        ("--out", ".", "folder|directory"),
        ("--out", "absent/r.jsonl", "cannot be written: expected a folder that exists"),
        ("--out", "brick_mm.stl", "expected JSON lines"),
        ("--out", "/proc/r.jsonl", "cannot be opened"),
        ("--out", "/dev/full", "cannot be written"),
        ("--segmenter", "unet", "expected one of pix2pix"),
    ],
)
def test_what_stops_a_batch(complaint, stand_in, place, tmp_path, option, value, said):
    if value.startswith("/") and not os.path.exists(value if "full" in value else os.path.dirname(value)):
        pytest.skip(f"needs {value}")
    (place / "empty").mkdir(exist_ok=True)
    out = tmp_path / "r.jsonl"
    options = {"--target": place / "brick.stl", "--sonar": place / "sonar.toml", "--out": out}
    options[option] = value if option == "--segmenter" else place / value
    before = content(place)
    message = complaint(2, "recognize", place / "a.npz", *[part for pair in options.items() for part in pair])
    assert any(words in message.lower() for words in said.lower().split("|"))
    assert not out.exists() and content(place) == before


def test_results_that_cannot_be_kept_stop_a_batch_before_targets_are_prepared(complaint, place, tmp_path, monkeypatch):
    recognizer = sys.modules["sonarjax.recognize"].Recognizer
    monkeypatch.setattr(recognizer, "prepare", lambda *_: pytest.fail("prepared"))
    targets = ["--target", place / "brick.stl", "--target", place / "brick_mm.stl", "--unit-m", "0.001"]
    (tmp_path / "notes.txt").write_text("words")
    files = ["--sonar", place / "sonar.toml", "--segmenter", "none", "--out", tmp_path / "notes.txt"]
    said = complaint(2, "recognize", place / "a.npz", *targets, *files)
    assert "notes.txt: expected JSON lines to append to, got a file that begins with b'words'" in said
    assert (tmp_path / "notes.txt").read_text() == "words"


def test_a_missing_threshold_stops_a_batch_before_any_frame(complaint, recognize, stand_in, place, tmp_path):
    out = tmp_path / "r.jsonl"
    target = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", out]
    own = [place / "a.npz", place / "absent.npz", *target, "--segmenter", "own.safetensors"]
    stand_in.threshold, rule = None, SimpleNamespace(threshold=0.5)
    said = "--threshold: expected a number, because own.safetensors has no threshold of its own"
    assert said in complaint(2, "recognize", *own)
    stand_in.rule = rule
    assert said in complaint(2, "recognize", *own, "--no-refine")  # the rule is for refined matches
    assert not out.exists() and not stand_in.calls
    assert recognize([place / "a.npz"], out)[0] == 0
    stand_in.rule = None
    assert recognize([place / "a.npz"], out, "--threshold", "0.3")[0] == 0


def test_a_missing_weights_file_is_not_put_down_to_the_sonar(complaint, place, tmp_path):
    target = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", tmp_path / "r.jsonl"]
    said = complaint(2, "recognize", place / "a.npz", *target, "--segmenter", "no.safetensors")
    assert said == "sonarjax: error: no.safetensors: no such file\n"


@pytest.mark.parametrize("name", ["a.npz", "brick.stl", "sonar.toml"])
def test_results_never_take_the_place_of_an_input(complaint, stand_in, place, tmp_path, name):
    before = (place / name).read_bytes()
    os.symlink(place / name, tmp_path / "link")
    for out in (place / name, tmp_path / "link"):
        target = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", out]
        assert "would overwrite the input" in complaint(2, "recognize", place / "a.npz", *target)
    assert (place / name).read_bytes() == before


def test_results_never_take_the_place_of_the_weights(complaint, stand_in, place, tmp_path):
    (tmp_path / "w.safetensors").write_bytes(b"weights")
    files = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", tmp_path / "w.safetensors"]
    said = complaint(2, "recognize", place / "a.npz", *files, "--segmenter", tmp_path / "w.safetensors")
    assert "would overwrite the input" in said and (tmp_path / "w.safetensors").read_bytes() == b"weights"


def test_labels_never_take_the_place_of_an_input(complaint, stand_in, place, tmp_path):
    for name in ("a.npz", "labels_a.npz"):
        (tmp_path / name).write_bytes((place / "a.npz").read_bytes())
    frames = [tmp_path / "labels_a.npz", tmp_path / "a.npz"]
    assert "would overwrite the input" in complaint(2, "segment", *frames, "--out-dir", tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["a.npz", "labels_a.npz"]
    assert frames[0].read_bytes() == frames[1].read_bytes()


def test_segment_writes_labels_by_stem(command, stand_in, place, tmp_path):
    path = tmp_path / "two.aris"
    path.write_bytes(recording(2))
    folder = tmp_path / "new" / "labels"
    assert command("segment", place / "a.npz", path, "--out-dir", folder) == (0, "", "")
    assert sorted(file.name for file in folder.iterdir()) == [
        "labels_a.npz", "labels_two_0.npz", "labels_two_1.npz"
    ]  # fmt: skip
    with np.load(folder / "labels_a.npz") as labels:
        assert list(labels) == ["labels"]
        assert (labels["labels"].shape, labels["labels"].dtype) == (SHAPE, np.uint8)
    assert set(stand_in.calls) == {"pix2pix"}


def test_segment_uses_the_segmenter_that_is_named(command, complaint, place, tmp_path):
    """The real ones: `none` cuts the grey frame at 1/4 and 3/4, so the names give different labels."""
    for name, grey in (("none", [0.2, 0.5, 0.8]), ("otsu1", [0.5, 0.6, 0.7])):
        np.save(tmp_path / "f.npy", np.repeat(np.float32(grey), 32).reshape(12, 8))
        assert command("segment", tmp_path / "f.npy", "--segmenter", name, "--out-dir", tmp_path / name) == (0, "", "")
        labels = np.load(tmp_path / name / "labels_f.npz")["labels"]
        assert (labels == 2).any() == (name == "none") and (labels == 1).any()
    folder = tmp_path / "none of these"
    for name, said in (("unet", "expected one of"), ("no.safetensors", "error: no.safetensors: no such file")):
        assert said in complaint(2, "segment", place / "a.npz", "--segmenter", name, "--out-dir", folder)
    assert not folder.exists()


def test_segment_goes_on_after_an_unreadable_frame(command, stand_in, bad, place, tmp_path):
    code, out, err = command("segment", *bad, place / "b.npy", "--out-dir", tmp_path / "labels")
    assert (code, out) == (1, "")
    assert err.count("sonarjax: error: ") == err.count("\n") == len(bad)
    assert os.listdir(tmp_path / "labels") == ["labels_b.npz"]


def test_segment_never_overwrites_one_frame_by_another(complaint, stand_in, place, tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(SHAPE, np.float32))
    assert "same stem" in complaint(2, "segment", place / "a.npz", tmp_path / "a.npy", "--out-dir", tmp_path / "labels")


def test_two_recordings_of_one_stem_stop_a_batch_before_any_frame(complaint, stand_in, tmp_path):
    paths = [tmp_path / name / "log.aris" for name in ("one", "two")]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(recording(2))
    said = complaint(2, "segment", *paths, "--out-dir", tmp_path / "labels")
    assert f"{paths[1]}: its labels would overwrite those of {paths[0]} (same stem)" in said
    assert not (tmp_path / "labels").exists() and stand_in.calls == []


def test_one_frame_by_two_names_is_segmented_twice(command, stand_in, place, tmp_path):
    same = place / ".." / place.name / "a.npz"
    assert command("segment", place / "a.npz", same, "--out-dir", tmp_path / "labels") == (0, "", "")


@pytest.mark.parametrize("folder", ["file", "file/below", "/proc/labels"])
def test_segment_needs_a_folder(complaint, stand_in, place, tmp_path, folder):
    (tmp_path / "file").write_text("")
    assert "folder" in complaint(2, "segment", place / "a.npz", "--out-dir", tmp_path / folder)


def test_info_tells_what_a_file_holds(command, place, tmp_path):
    (tmp_path / "two.aris").write_bytes(recording(2))
    for path, word in ((place / "a.npz", "64 range bins x 24 beams"), (tmp_path / "two.aris", "48 beams")):
        code, out, err = command("info", path)
        assert (code, err) == (0, "")
        assert word in out


def test_info_tells_of_measured_pixels_alone(command, tmp_path):
    mask = np.arange(12).reshape(4, 3) < 6
    np.savez(tmp_path / "half.npz", image=np.where(mask, 0.5, np.nan), mask=mask)
    assert "4 range bins x 3 beams, values 0.500 to 0.500, mean 0.500\n" in command("info", tmp_path / "half.npz")[1]


def test_info_tells_how_weights_were_trained(command, complaint, tmp_path):
    path = tmp_path / "w.safetensors"
    about = {"step": 16, "recipe": {"name": "smoke", "networks": {"width": 4}}, "metrics": {"iou_mean": 0.25}}
    write_safetensors(path, {"a": np.zeros((4, 3), np.float32), "b": np.zeros(2, np.float16)}, about)
    code, out, err = command("info", path)
    assert (code, err) == (0, "")
    said = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert said["arrays"] == "2, together 14 numbers"
    assert (said["recipe.name"], said["recipe.networks.width"], said["metrics.iou_mean"]) == ("smoke", "4", "0.25")
    path.write_bytes(path.read_bytes()[:40])
    assert "complete safetensors file" in complaint(1, "info", path)


def test_info_of_what_cannot_be_read(complaint, bad, tmp_path):
    for path, said in bad.items():
        if not path.endswith("other.npz"):  # an NPZ without a frame is worth a look
            assert said in complaint(1, "info", path)
    assert "no such file" in complaint(2, "info", tmp_path / "absent.toml")


def test_the_bar_shows_only_on_a_terminal(recognize, stand_in, place, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    np.save(tmp_path / "nan.npy", np.full(SHAPE, np.nan))
    code, err, records = recognize([place / "a.npz", tmp_path / "nan.npy"], tmp_path / "r.jsonl")
    assert (code, len(records)) == (1, 2)
    assert "2/2" in err
    assert "sonarjax: error: " in err


def test_frames_of_a_sequence_are_one_belief(recognize, stand_in, place, tmp_path):
    """A frame that cannot be read keeps its own line of an error, and the sequence goes on."""
    out, stand_in.yaw_std = tmp_path / "r.jsonl", 0.02
    frames = [place / "a.npz", tmp_path / "absent.npz", place / "b.npy"]
    code, _, (first, absent, last) = recognize(frames, out, "--track", "--motion", "standing", "--no-refine")
    assert code == 1
    assert set(absent) == {"frame", "error", "schema"}
    assert [record["frame"] for record in (first, absent, last)] == [str(frame) for frame in frames]
    assert 0 < last["yaw_std_deg"] < first["yaw_std_deg"]
    assert last["yaw_deg"] == pytest.approx(last["frame_yaw_deg"], abs=0.01)  # the stand-in always finds the same
    assert last["x_m"] == pytest.approx(2.2, abs=1e-3)
    assert first["hypotheses"][0]["score"] == pytest.approx(first["probability"])
    assert last["rate_deg"] == 0.0
