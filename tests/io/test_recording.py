"""Recordings: a damaged record costs that record alone, and a long file takes no more memory than a short one."""

import os
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from sonarjax.io import Frame, SonarjaxError, iter_records, read_frames
from sonarjax.io.files import open_content


def kinds(path: str) -> list[bool]:
    return [isinstance(record, Frame) for record in iter_records(path)]


def damaged(content: bytes, at: int, bytes_: bytes) -> bytes:
    return content[:at] + bytes_ + content[at + len(bytes_) :]


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_an_aris_frame(make, saved, broken):
    frame = 1024 + 10 * 96
    content = damaged(make.aris(n_frames=3), 1024 + broken * frame + 436, struct.pack("<I", 77))  # PingMode
    path = saved("a.aris", content)
    assert kinds(path) == [number != broken for number in range(3)]
    error = list(iter_records(path))[broken]
    assert str(error).startswith(f"{path}: frame {broken}: PingMode")
    whole = read_frames(saved("whole.aris", make.aris(n_frames=3)))
    kept = next(number for number in range(3) if number != broken)
    np.testing.assert_array_equal(read_frames(f"{path}:{kept}")[0].image, whole[kept].image)
    with pytest.raises(SonarjaxError, match="PingMode"):
        read_frames(path)


def test_an_aris_file_of_broken_frames_says_what_is_wrong_with_the_first(make, saved):
    content = make.aris(n_frames=2)
    for number in range(2):
        content = damaged(content, 1024 + number * (1024 + 10 * 96) + 436, struct.pack("<I", 77))
    with pytest.raises(SonarjaxError, match="frame 0: PingMode"):
        list(iter_records(saved("a.aris", content)))


def test_a_didson_frame(make, saved):
    content = make.didson(n_frames=3)
    path = saved("d.ddf", damaged(content, 512 + 256 + 512 * 96 + 52, struct.pack("<i", -5)))  # window start of frame 1
    assert kinds(path) == [True, False, True]


def test_an_oculus_ping_and_a_stretch_that_is_none(make, saved):
    pings = [make.oculus(n_pings=1, n_ranges=12 + k) for k in range(4)]
    content = pings[0] + damaged(pings[1], 0, b"xxxx") + pings[2] + damaged(pings[3], 93 + 5, b"\xff" * 8)
    path = saved("o.raw", content)
    assert kinds(path) == [True, False, True, False]
    first, lost, third, last = iter_records(path)
    assert (first.shape, third.shape) == ((12, 16), (14, 16))
    assert "id: expected 0x4f53" in str(lost) and "ping 3" in str(last)


@pytest.mark.parametrize("damaged_ping", [0, 1, 2])
def test_an_oculus_ping_that_says_it_is_larger_than_the_file(make, saved, damaged_ping):
    pings = [make.oculus(n_pings=1, n_ranges=12 + k) for k in range(3)]
    pings[damaged_ping] = damaged(pings[damaged_ping], 10, struct.pack("<I", 500_000_000))
    path = saved("o.raw", b"".join(pings))
    if damaged_ping == 2:  # nothing follows: it may still be being written
        assert kinds(path) == [True, True]
        return
    assert kinds(path) == [number != damaged_ping for number in range(3)]
    error = list(iter_records(path))[damaged_ping]
    assert "payload: truncated: expected 500000000 bytes" in str(error)


@pytest.mark.parametrize(("name", "written"), [("a.aris", "aris"), ("a.raw", "oculus")])
def test_a_file_that_becomes_shorter_while_it_is_read(make, saved, name, written):
    path = saved(name, getattr(make, written)(2, n_ranges=2000))  # frames larger than what is read ahead
    records = iter_records(path)
    assert isinstance(next(records), Frame)
    os.truncate(path, os.path.getsize(path) // 2)
    (error,) = records
    assert str(error).startswith(f"{path}: became shorter while it was read: expected ")


def test_content_is_found_across_pieces(saved):
    """As `bytes.find`, whatever piece it lies in."""
    data = bytearray(300_000)
    for at in (4_094, 4_095, 200_001):
        data[at : at + 4] = b"here"
    with open_content(saved("x.bin", bytes(data))) as content:
        for start in (0, 4_095, 4_096, 200_002):
            for end in (None, 4_098, 4_099, 200_004, 200_005, 10**9):
                assert content.find(b"here", start, end) == bytes(data).find(b"here", start, end)


@pytest.mark.slow
def test_a_long_recording_is_read_in_little_memory(make, saved):
    """2 GB of frames, mostly a hole in the file."""
    n_ranges, frames = 20_000, 1000
    one = make.aris(n_frames=1, n_ranges=n_ranges)
    header, frame_bytes = one[1024:2048], len(one) - 1024
    path = saved("long.aris", one)
    with open(path, "r+b") as file:
        for number in range(frames):
            file.seek(1024 + number * frame_bytes)
            file.write(header)
        file.truncate(1024 + frames * frame_bytes)
    assert os.path.getsize(path) > 1.9e9
    first = own_memory()
    count = 0
    for record in iter_records(path):
        count += record.shape == (n_ranges, 96)
        assert own_memory() - first < 60e6  # some frames of 7.7 MB as float32
    assert count == frames


def own_memory() -> int:
    """Resident memory of this process that is no file's [bytes]."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("this system does not tell")
    return 1024 * int(re.search(r"RssAnon:\s+(\d+) kB", status.read_text())[1])
