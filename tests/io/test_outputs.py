"""An output can be a file, and never takes the place of an input or another output, whatever path or link names it."""

import os

import pytest

from sonarjax.io import SonarjaxError, check_ending, check_label_files, check_outputs


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The current folder, with the inputs `m.stl`, `f.npz`, `r.aris` and links to the first."""
    monkeypatch.chdir(tmp_path)
    for name in ("m.stl", "f.npz", "r.aris"):
        (tmp_path / name).write_bytes(b"kept")
    os.symlink("m.stl", "soft.stl")
    os.link("m.stl", "hard.stl")
    (tmp_path / "sub").mkdir()
    return tmp_path


@pytest.mark.parametrize("out", ["m.stl", "./m.stl", "sub/../m.stl", "soft.stl", "hard.stl"])
def test_an_output_that_names_an_input(out, folder):
    for path in (out, str(folder / out)):
        with pytest.raises(SonarjaxError, match="--out: .* would overwrite the input 'm.stl'"):
            check_outputs({"--out": path}, ["f.npz", "m.stl"])


def test_a_frame_of_a_recording_names_its_file():
    with pytest.raises(SonarjaxError, match="'r.aris'"):
        check_outputs({"--out": "r.aris"}, ["r.aris:3"])


def test_an_output_in_the_folder_of_a_bag_that_is_read(folder):
    (folder / "run").mkdir()
    (folder / "run" / "metadata.yaml").write_bytes(b"kept")
    os.symlink("run", "linked")
    for out in ("run/run.mcap", "linked/run.mcap", "sub/../run/new.npz"):
        for spec in ("run", "run/", "run:/sonar_image:3", "linked"):
            with pytest.raises(SonarjaxError, match="--out: .* lies in the input '.*': expected another folder"):
                check_outputs({"--out": out}, ["f.npz", spec])
    check_outputs({"--out": "running.npz"}, ["run"])
    check_outputs({"--out": "sub/r.jsonl"}, ["sub"])  # no bag: such as a folder named like a segmenter


def test_two_outputs_in_one_file():
    for png in ("new.npz", "sub/../new.npz"):
        with pytest.raises(SonarjaxError, match="--png: .* is also --out"):
            check_outputs({"--out": "new.npz", "--png": png}, ["m.stl"])


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("", "--out: expected the name of a file, got ''"),
        ("sub", "--out: 'sub': expected a file, this is a folder"),
        ("sub/", "--out: 'sub/': expected a file, this is a folder"),
        ("no/r.toml", "--out: 'no/r.toml' cannot be written: expected a folder that exists, got 'no'"),
        ("f.npz/r.toml", "--out: 'f.npz/r.toml' cannot be written: expected a folder that exists, got 'f.npz'"),
    ],
)
def test_an_output_that_can_be_no_file(path, said):
    with pytest.raises(SonarjaxError) as caught:
        check_outputs({"--png": None, "--out": path}, ["m.stl"])
    assert str(caught.value) == said


def test_outputs_that_are_fine():
    check_outputs({"--out": "new.npz", "--png": None}, ["m.stl", "absent.toml", "nul\0"])
    check_outputs({"--out": "/dev/null", "--png": "/dev/null"}, ["m.stl"])
    check_outputs({"--out": "f.npz", "--png": "f.png"}, ["m.stl"])
    check_outputs({"--out": "sub/new.npz", "--png": os.path.abspath("sub/../f.png")}, ["m.stl"])


def test_ending_of_an_output():
    for name in ("a.npz", "b.NPZ", "/dev/null", "/dev/stdout", None):
        check_ending("--out", name, (".npz",))
    for name in ("a.png", "npz", "a.npz/", "sub"):
        with pytest.raises(SonarjaxError, match=f"--out: '{name}': expected a name that ends in .npz or .npy"):
            check_ending("--out", name, (".npz", ".npy"))


def test_labels_that_name_an_input(folder):
    for name in ("labels_f.npz", "labels_r_12.npz"):
        (folder / name).write_bytes(b"kept")
    for specs in (["f.npz", "labels_f.npz"], ["labels_r_12.npz", "r.aris:12"]):
        with pytest.raises(SonarjaxError, match="its labels would overwrite the input 'labels_"):
            check_label_files(".", specs)
        check_label_files("sub", specs)
        check_label_files("absent", specs)
    check_label_files(".", ["labels_f.npz"])
    check_label_files(".", ["f.npz", "labels_r_12.npz"])
    os.symlink("../f.npz", "sub/labels_f.npz")
    with pytest.raises(SonarjaxError, match="'f.npz'"):
        check_label_files("sub", ["f.npz"])


def test_two_inputs_of_one_stem():
    with pytest.raises(SonarjaxError, match="f.png: its labels would overwrite those of f.npz .same stem"):
        check_label_files("sub", ["f.npz", "f.png"])
    check_label_files("sub", ["f.npz", "./f.npz", "r.aris", "r.aris:3"])


@pytest.mark.parametrize(
    "specs",
    [
        ["r.aris", "sub/r.aris"], ["r.aris:3", "sub/r.aris:3"], ["r.aris", "r.aris:3", "sub/r.aris:3"],
        ["r.raw", "sub/r.aris"], ["r.mcap", "sub/r.mcap"], ["bag:/a", "sub/bag/:/a"],
    ],
)  # fmt: skip
def test_two_recordings_of_one_stem(folder, specs):
    for bag in ("bag", "sub/bag"):
        (folder / bag).mkdir()
        (folder / bag / "metadata.yaml").write_bytes(b"kept")
    (folder / "sub" / "r.aris").write_bytes(b"kept")
    with pytest.raises(SonarjaxError, match=r"sub/.*: its labels would overwrite those of .* .same stem"):
        check_label_files("out", specs)


def test_recordings_whose_labels_have_names_of_their_own(folder):
    (folder / "sub" / "r.aris").write_bytes(b"kept")
    (folder / "bag").mkdir()
    (folder / "bag" / "metadata.yaml").write_bytes(b"kept")
    for specs in (
        ["r.aris:2", "sub/r.aris:3"], ["r.aris", "sub/../r.aris"], ["r.aris", "sub/q.aris"],
        ["r.mcap:/a", "sub/r.mcap:/b"], ["bag:/a", "./bag/:/a"], ["r.aris", "r.png"],
    ):  # fmt: skip
        check_label_files("out", specs)


def test_a_folder_that_may_not_be_written_in_is_refused_before_anything_runs(tmp_path, monkeypatch):
    locked = tmp_path / "locked"
    locked.mkdir()
    allowed = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: os.path.realpath(path) != os.path.realpath(locked) and allowed(path, mode)
    )
    (tmp_path / "into.jsonl").symlink_to(locked / "r.jsonl")
    (locked / "out_of.jsonl").symlink_to(tmp_path / "r.jsonl")
    for path in (locked / "r.jsonl", tmp_path / "into.jsonl"):
        with pytest.raises(
            SonarjaxError, match=r"--out: .*jsonl' cannot be written: no permission to write to .*locked"
        ):
            check_outputs({"--out": str(path)}, [])
    for path in (tmp_path / "r.jsonl", locked / "out_of.jsonl"):  # a link is followed
        check_outputs({"--out": str(path)}, [])
    (locked / "old.jsonl").touch()  # it may be appended to, but not replaced
    check_outputs({"--out": str(locked / "old.jsonl")}, [], appended=("--out",))
    with pytest.raises(SonarjaxError, match=r"no permission to write to .*locked"):
        check_outputs({"--out": str(locked / "old.jsonl")}, [])
    with pytest.raises(SonarjaxError, match=r"no permission to write to .*locked"):
        check_outputs({"--out": str(locked / "new.jsonl")}, [], appended=("--out",))


def test_a_link_to_a_folder_that_is_not_there_is_refused_as_such(tmp_path):
    (tmp_path / "a.npz").symlink_to(tmp_path / "nowhere" / "a.npz")
    with pytest.raises(SonarjaxError, match=r"expected a folder that exists, got .*nowhere'"):
        check_outputs({"--out": str(tmp_path / "a.npz")}, [])
