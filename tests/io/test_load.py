"""Specs, endings, files that are not files, TOML and descriptions."""

import os

import numpy as np
import pytest

from sonarjax.io import SonarjaxError, describe, iter_frames, read_frames, read_toml, split_spec

UNIT = np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3)


def test_specs(make, saved):
    assert split_spec("a/b.aris:12") == ("a/b.aris", 12, None)
    assert split_spec("a/b.aris:-1") == ("a/b.aris", -1, None)
    assert split_spec("a/b.aris") == ("a/b.aris", None, None)
    assert split_spec("C:/b.aris") == ("C:/b.aris", None, None)
    odd = saved("odd:3", b"x")
    assert split_spec(odd) == (odd, None, None)  # a file of that very name


def test_endings_do_not_mind_case(make, saved):
    assert read_frames(saved("A.NPY", make.npy(UNIT)))[0].stem == "A"


@pytest.mark.parametrize("ending", ["npz", "npy", "png", "aris", "ddf", "raw", "toml", "xyz"])
def test_missing_and_folder(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    for reader in (read_frames, describe, read_toml):
        with pytest.raises(SonarjaxError, match="no such file"):
            reader(path)
    path.mkdir()
    for reader in (read_frames, describe, read_toml):
        with pytest.raises(SonarjaxError, match="this is a folder"):
            reader(path)


@pytest.mark.parametrize("ending", ["npz", "npy", "png", "aris", "ddf", "raw"])
def test_empty(saved, ending):
    path = saved(f"a.{ending}", b"")
    for reader in (read_frames, describe):
        with pytest.raises(SonarjaxError, match="the file is empty"):
            reader(path)


def test_other_bad_specs(make, saved):
    with pytest.raises(SonarjaxError, match="unknown ending '.jpg': expected one of .npz"):
        read_frames(saved("a.jpg", b"x"))
    with pytest.raises(SonarjaxError, match="unknown ending ''"):
        read_frames(saved("frame", b"x"))
    path = saved("a.npy", make.npy(UNIT))
    for index in ("1", "-1", "99999999999999999"):
        with pytest.raises(SonarjaxError, match=f"frame {index}: expected 0 to 0"):
            read_frames(f"{path}:{index}")
    with pytest.raises(SonarjaxError, match="frame -1: expected 0 to 1, the file holds 2"):
        read_frames(f"{saved('b.aris', make.aris())}:-1")
    with pytest.raises(SonarjaxError):
        read_frames("a\0.npy")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no /dev/zero")
def test_a_device_is_not_read(tmp_path):
    link = tmp_path / "endless.npy"
    link.symlink_to("/dev/zero")
    with pytest.raises(SonarjaxError, match="regular file"):
        read_frames(link)


def test_frames_come_one_at_a_time(make, saved):
    content = bytearray(make.aris(n_frames=3))
    content[1024 + 2 * (1024 + 960) + 12] = 0  # only the last frame is damaged
    path = saved("a.aris", bytes(content))
    frames = iter_frames(path)
    assert next(frames).stem == "a_0" and next(frames).stem == "a_1"
    with pytest.raises(SonarjaxError, match="frame 2: signature"):
        next(frames)
    assert len(read_frames(f"{path}:1")) == 1


def test_toml(saved):
    path = saved("s.toml", b'preset = "didson-hf"\n[floor]\nx_m = 1.5\nazimuth_deg = [1, 2, 3, 4, 5, 6, 7.5]\n')
    assert read_toml(path)["floor"]["x_m"] == 1.5
    text = describe(path)
    assert "didson-hf" in text and "floor.x_m" in text and "7 values, 1 to 7.5" in text
    assert read_toml(saved("empty.toml", b"")) == {}
    assert read_toml(saved("mark.toml", b"\xef\xbb\xbfheight_m = 1.5\n")) == {"height_m": 1.5}  # a byte order mark


@pytest.mark.parametrize("content", [b"a = ", b"\xff\xfe", b"a = 1\na = 2", b"[" * 5000, b"a = " + b"9" * 5000])
def test_bad_toml(saved, content):
    path = saved("s.toml", content)
    with pytest.raises(SonarjaxError, match="expected a TOML file") as caught:
        read_toml(path)
    assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


def test_describe(make, saved):
    recording = saved("a.aris", make.aris(n_frames=4, lens=1))
    text = describe(recording)
    for part in ("10 range bins x 96 beams", "n_frames", "4", "ARIS 1800", "96 beams, -7.419 to 7.419"):
        assert part in text
    assert "_index" in describe(f"{recording}:3")
    assert "not in the file" in describe(saved("a.npy", make.npy(UNIT)))
    assert "DDF_03" in describe(saved("a.ddf", make.didson()))
    assert "Oculus" in describe(saved("a.raw", make.oculus()))
    assert "PNG" in describe(saved("a.png", make.png((UNIT * 255).astype(np.uint8))))
    labels = describe(saved("l.npz", make.npz(labels=np.zeros((2, 3), np.uint8), odd=np.array([None]))))
    assert "uint8 (2, 3)" in labels and "array odd" in labels


@pytest.mark.parametrize(
    "content", [b".".join([b"a"] * 3000) + b" = 1", b"[" + b".".join([b"a"] * 3000) + b"]\nb = 1"], ids=["key", "table"]
)
def test_deeply_nested_toml(saved, content):
    path = saved("s.toml", content)
    for read in (read_toml, describe):
        with pytest.raises(SonarjaxError, match="at most 64 levels") as caught:
            read(path)
        assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", [".npz", ".npy", ".png", ".toml"])
def test_a_file_larger_than_memory(saved, ending):
    path = saved(f"huge{ending}", b"x")
    os.truncate(path, 2**40)  # sparse: it takes no space on the disk
    with pytest.raises(SonarjaxError, match="too large: expected at most .*iB, got 1024 GiB") as caught:
        read_toml(path) if ending == ".toml" else read_frames(path)
    assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


def test_memory_that_does_not_suffice_is_said(saved, monkeypatch):
    path = saved("a.npy", b"x")

    def full(*_):
        raise MemoryError

    monkeypatch.setattr("builtins.open", full)
    with pytest.raises(SonarjaxError, match="a.npy: the file is too large for the free memory"):
        read_frames(path)
