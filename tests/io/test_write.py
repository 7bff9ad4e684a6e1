"""Files out: all or nothing, and JSON Lines that survive a kill."""

import errno
import io
import json
import os
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest
from skimage import io as skimage_io

from sonarjax.io import JsonLines, SonarjaxError, read_frames, write_atomic, write_npz, write_png, write_text


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def read_only(*_):
    raise OSError(errno.EROFS, "Read-only file system")


def test_npz_round_trip_and_same_bytes(tmp_path):
    arrays = {"image": np.random.default_rng(1).random((5, 7), np.float32), "path": np.arange(3), "file": np.eye(2) > 0}
    write_npz(tmp_path / "a.npz", **arrays)
    write_npz(tmp_path / "b.npz", **arrays)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as loaded:
        assert set(loaded) == set(arrays)
        for key, value in arrays.items():
            np.testing.assert_array_equal(loaded[key], value)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npz")[0].image, arrays["image"])
    with pytest.raises(SonarjaxError, match="got Python objects"):
        write_npz(tmp_path / "c.npz", image=np.array([None]))


def test_png_round_trip(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    write_png(tmp_path / "a.png", grey)
    np.testing.assert_array_equal(skimage_io.imread(tmp_path / "a.png"), grey)
    write_png(tmp_path / "b.png", grey / 255.0)
    np.testing.assert_array_equal(skimage_io.imread(tmp_path / "b.png"), grey)
    colour = np.stack([grey, grey // 2, grey // 3], axis=2)
    write_png(tmp_path / "c.png", colour)
    np.testing.assert_array_equal(skimage_io.imread(tmp_path / "c.png"), colour)


@pytest.mark.parametrize("value", [np.nan, -0.5, 1.5])
def test_png_refuses_values(tmp_path, value):
    with pytest.raises(SonarjaxError, match=r"expected finite floats in \[0, 1\]"):
        write_png(tmp_path / "a.png", np.full((2, 2), value))
    assert not list(tmp_path.iterdir())


def test_text_follows_a_link_and_keeps_the_mode(tmp_path):
    target, link = tmp_path / "a.txt", tmp_path / "link.txt"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    write_text(link, "grün\n")
    assert target.read_text("utf-8") == "grün\n" and link.is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("old", [None, b"old content"])
@pytest.mark.parametrize(("function", "failure", "words"), [
    ("replace", read_only, "Read-only file system"),
    ("fsync", full, "No space left"),
    ("open", read_only, "Read-only file system"),
])  # fmt: skip
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, old, function, failure, words):
    path = tmp_path / "a.bin"
    if old is not None:
        path.write_bytes(old)
    before = sorted(tmp_path.iterdir())
    with monkeypatch.context() as patch, pytest.raises(SonarjaxError, match=words) as caught:
        patch.setattr(os, function, failure)
        write_atomic(path, lambda file: file.write(b"new"))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(tmp_path.iterdir()) == before
    assert old is None or path.read_bytes() == old


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt(), KeyError("x")]
)
def test_a_failing_writer_leaves_the_old_file(tmp_path, error):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def writer(file):
        file.write(b"half of it")
        raise error

    expected = SonarjaxError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        write_atomic(path, writer)
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


def test_bad_targets(tmp_path):
    with pytest.raises(SonarjaxError, match="this is a folder"):
        write_text(tmp_path, "x")
    with pytest.raises(SonarjaxError, match="cannot be written: No such file or directory"):
        write_text(tmp_path / "no" / "a.txt", "x")
    with pytest.raises(SonarjaxError, match="NUL"):
        write_text("a\0b", "x")
    (tmp_path / "file").write_text("x")
    with pytest.raises(SonarjaxError, match="Not a directory"):
        write_text(tmp_path / "file" / "a.txt", "x")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_device(tmp_path):
    link = tmp_path / "a.npz"
    link.symlink_to("/dev/full")
    with pytest.raises(SonarjaxError, match="No space left"):
        write_npz(link, image=np.zeros((2, 2)))
    with JsonLines("/dev/full") as lines, pytest.raises(SonarjaxError, match="No space left"):
        lines.write({"a": 1})
    assert os.path.exists("/dev/full")


def test_devices_and_pipes_take_an_archive(tmp_path):
    """An archive is filled out of order, and /dev/null claims that this is possible."""
    write_npz(os.devnull, image=np.eye(3))
    write_npz(tmp_path / "a.npz", image=np.eye(3))
    os.mkfifo(tmp_path / "pipe")
    found = []
    reader = threading.Thread(target=lambda: found.append((tmp_path / "pipe").read_bytes()))
    reader.start()
    write_npz(tmp_path / "pipe", image=np.eye(3))
    reader.join(60)
    assert found == [(tmp_path / "a.npz").read_bytes()]


@pytest.mark.skipif(not os.path.isdir("/dev/fd"), reason="no /dev/fd")
def test_a_pipe_that_nobody_reads_is_told_apart_from_a_file_that_cannot_be_written():
    read, write = os.pipe()
    try:
        write_text(f"/dev/fd/{write}", "a")
        assert os.read(read, 10) == b"a"
        os.close(read)
        with pytest.raises(BrokenPipeError):
            write_text(f"/dev/fd/{write}", "b")
    finally:
        os.close(write)


@pytest.mark.skipif(not os.path.exists("/dev/stdout"), reason="no /dev/stdout")
def test_a_pipe_is_written_to_directly():
    program = "from sonarjax.io import write_text, write_npz\nimport numpy as np\n"
    program += "write_text('/dev/stdout', 'said')\nwrite_npz('/dev/stderr', image=np.eye(2))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, timeout=60, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    with np.load(io.BytesIO(done.stderr), allow_pickle=False) as loaded:
        np.testing.assert_array_equal(loaded["image"], np.eye(2))
    assert done.stdout == b"said"


def test_json_lines_append(tmp_path):
    path = tmp_path / "r.jsonl"
    with JsonLines(path) as lines:
        lines.write({"nan": float("nan"), "inf": np.float32(np.inf), "list": np.array([1.0, -np.inf])})
        assert len(path.read_text().splitlines()) == 1  # there before the file is closed
    with JsonLines(path) as lines:
        lines.write({"yes": np.bool_(True), "n": np.int64(3), "x": np.float32(0.5), "none": None, "path": tmp_path})
        lines.write({"nested": {"t": (1, "ü\n")}})
    first, second, third = map(json.loads, path.read_text("utf-8").splitlines())
    assert first == {"nan": None, "inf": None, "list": [1.0, None]}
    assert second == {"yes": True, "n": 3, "x": 0.5, "none": None, "path": str(tmp_path)}
    assert third == {"nested": {"t": [1, "ü\n"]}}


def test_json_lines_ends_a_line_that_was_cut_off(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text('{"a": 1}\n{"b": ')
    with JsonLines(path) as lines:
        lines.write({"c": 3})
    assert path.read_text().splitlines() == ['{"a": 1}', '{"b": ', '{"c": 3}']


@pytest.mark.parametrize("held", [b'{"a": 1}\n{"b": ', b'{"a": 1}\n', b" \n\n"])
def test_json_lines_change_nothing_before_the_first_record(tmp_path, held):
    path = tmp_path / "r.jsonl"
    path.write_bytes(held)
    with JsonLines(path) as lines:
        assert path.read_bytes() == held
        lines.write({"c": 3})
        lines.write({"c": 4})
    ended = held if held.endswith(b"\n") else held + b"\n"
    assert path.read_bytes() == ended + b'{"c": 3}\n{"c": 4}\n'


@pytest.mark.parametrize("held", [b"solid brick", b"\n [1]\n", b"\x93NUMPY", b"\0{"])
def test_json_lines_leave_another_file_alone(tmp_path, held):
    path = tmp_path / "r.jsonl"
    path.write_bytes(held)
    (tmp_path / "link").symlink_to(path)
    for name in (path, tmp_path / "link"):
        with pytest.raises(SonarjaxError, match="expected JSON lines to append to, got a file that begins"):
            JsonLines(name)
    assert path.read_bytes() == held


@pytest.mark.skipif(not os.path.exists("/dev/stdout"), reason="no /dev/stdout")
def test_json_lines_go_where_a_shell_leads_them(tmp_path):
    """To a pipe, and to the end of a log of other text."""
    program = "from sonarjax.io import JsonLines\nwith JsonLines('/dev/stdout') as lines: lines.write({'a': 1})"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = partial(subprocess.run, [sys.executable, "-c", program], timeout=60, env=environment, check=True)
    assert run(stdout=subprocess.PIPE).stdout == b'{"a": 1}\n'
    log = tmp_path / "log"
    log.write_text("begun\n")
    with open(log, "a") as stdout:
        run(stdout=stdout)
    assert log.read_text() == 'begun\n{"a": 1}\n'


def test_json_lines_survive_a_kill(tmp_path):
    path = tmp_path / "r.jsonl"
    program = (
        "import os, signal, sys\nfrom sonarjax.io.jsonlines import JsonLines\nlines = JsonLines(sys.argv[1])\n"
        "lines.write({'n': 1})\nlines.write({'n': 2})\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", program, str(path)], check=False, timeout=60, env=environment)
    assert [json.loads(line)["n"] for line in path.read_text().splitlines()] == [1, 2]


def test_json_lines_take_back_half_a_line(tmp_path, monkeypatch):
    path = tmp_path / "r.jsonl"
    with JsonLines(path) as lines:
        lines.write({"n": 1})
        real = os.write
        calls = []

        def short(descriptor, data):
            calls.append(data)
            return real(descriptor, data[:4]) if len(calls) == 1 else full()

        with monkeypatch.context() as patch, pytest.raises(SonarjaxError, match="No space left"):
            patch.setattr(os, "write", short)
            lines.write({"n": 2})
        lines.write({"n": 3})
    assert [json.loads(line)["n"] for line in path.read_text().splitlines()] == [1, 3]


def test_json_lines_notice_that_the_reader_of_a_pipe_has_gone(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with JsonLines(path) as lines:
        lines.write({"n": 1})
        assert os.read(reader, 100) == b'{"n": 1}\n'
        os.close(reader)
        with pytest.raises(BrokenPipeError):
            lines.write({"n": 2})


@pytest.mark.parametrize("indent", [0, 1, 4])
def test_json_lines_leave_an_indented_json_file_alone(tmp_path, indent):
    path = tmp_path / "dataset.json"
    path.write_text(json.dumps({"version": 4, "frames": [{"a": 1}, {"a": 2}]}, indent=indent) + "\n")
    before = path.read_bytes()
    with pytest.raises(SonarjaxError, match=r"dataset.json: expected JSON lines to append to, got a file that begins"):
        JsonLines(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("held", [b"{not JSON}\n", b"{\n", b'{"a": 1}\nand so on', b"{" * 3000 + b"\n"])
def test_json_lines_leave_a_text_alone_that_begins_with_a_brace(tmp_path, held):
    path = tmp_path / "r.jsonl"
    path.write_bytes(held)
    with pytest.raises(SonarjaxError, match="expected JSON lines to append to"):
        JsonLines(path)


@pytest.mark.parametrize("held", [b'{"a": \n{"b": 2}\n', b'{"a": "' + b"x" * 9000 + b'"}\n{"b": 2}\n', b'{"a": 1}\r\n'])
def test_json_lines_go_on_after_a_cut_off_or_a_long_line(tmp_path, held):
    path = tmp_path / "r.jsonl"
    path.write_bytes(held)
    with JsonLines(path) as lines:
        lines.write({"c": 3})
    assert path.read_bytes() == held + b'{"c": 3}\n'


def test_json_lines_tell_names_apart_that_are_not_utf8(tmp_path):
    path, names = tmp_path / "r.jsonl", [b"w\xff.npz", b"w\xfe.npz", "ü.npz".encode()]
    with JsonLines(path) as lines:
        for name in names:
            lines.write({"frame": os.fsdecode(name)})
    held = path.read_text("utf-8").splitlines()
    assert [os.fsencode(json.loads(line)["frame"]) for line in held] == names


def test_json_lines_bad_targets(tmp_path):
    with pytest.raises(SonarjaxError, match="cannot be opened for writing"):
        JsonLines(tmp_path)
    with pytest.raises(SonarjaxError, match="cannot be opened for writing"):
        JsonLines(tmp_path / "no" / "r.jsonl")
    with JsonLines(tmp_path / "r.jsonl") as lines, pytest.raises(TypeError, match="not JSON"):
        lines.write({"a": object()})
