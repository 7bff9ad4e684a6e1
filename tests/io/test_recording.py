"""Recordings: a damaged record costs that record alone, and a long file takes no more memory than a short one."""

import os
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from sonarjax.io import Frame, SonarjaxError, iter_records, read_frames
from sonarjax.io.files import FileContent, open_content


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


def whole(path: str) -> list[tuple[int, int] | str]:
    """Range bins and number in the header of each frame, or its error; a frame asked for by its number is the same."""
    found = []
    for number, record in enumerate(iter_records(path)):
        (alone,) = iter_records(f"{path}:{number}")
        assert str(alone) == str(record) if isinstance(record, SonarjaxError) else alone.source == record.source
        if isinstance(record, Frame):
            assert np.array_equal(alone.image, record.image) and record.source == f"{path}:{number}"
            found.append((record.shape[0], record.meta["recorded_index"]))
        else:
            found.append(str(record).removeprefix(f"{path}: "))
    return found


def test_aris_frames_of_another_size_cost_no_others(make, saved):
    long, short = make.aris(n_frames=2), make.aris(n_frames=3, n_ranges=5)[1024:]
    path = saved("a.aris", long + short + long[1024:])
    sizes = [(10, 0), (10, 1), (5, 0), (5, 1), (5, 2), (10, 0), (10, 1)]
    assert whole(path) == sizes
    assert whole(saved("b.aris", long + short)) == sizes[:5]
    assert whole(saved("c.aris", long + short[:1600])) == sizes[:3]  # the last is unfinished
    unsigned = damaged(long + short + long[1024:], 1024 + 2 * 1984 + 12, b"xxxx")
    error = "frame 2: signature: expected 0x05464444 (ARIS, DDF_05), got 0x78787878"
    assert whole(saved("d.aris", unsigned)) == [*sizes[:2], error, *sizes[3:]]
    unsigned = damaged(long + short + long[1024:], 1024 + 2 * 1984 + 1504 + 12, b"xxxx")
    assert whole(saved("e.aris", unsigned)) == [*sizes[:3], error.replace("frame 2", "frame 3"), *sizes[4:]]


def test_aris_recordings_that_were_joined(make, saved):
    one, other = make.aris(n_frames=2), make.aris(n_frames=3, n_ranges=5)
    assert whole(saved("a.aris", one + one + other)) == [(10, 0), (10, 1)] * 2 + [(5, 0), (5, 1), (5, 2)]
    for cut in (100, 1500):  # the first was not finished
        error = f"frame 1: samples: expected 1984 bytes to the next frame, got {1984 - cut}"
        assert whole(saved("b.aris", one[:-cut] + other)) == [(10, 0), error, (5, 0), (5, 1), (5, 2)]


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_bytes_that_are_missing_from_an_aris_frame_cost_that_frame(make, saved, broken):
    content, at = make.aris(n_frames=4), 1024 + broken * 1984 + 1100
    error = f"frame {broken}: samples: expected 1984 bytes to the next frame, got 1884"
    wanted = [(10, number) if number != broken else error for number in range(4)]
    assert whole(saved("a.aris", content[:at] + content[at + 100 :])) == wanted


def test_bytes_that_are_missing_from_the_first_header_of_an_aris_file_cost_its_frame(make, saved):
    content = make.aris(n_frames=3)
    first, *others = whole(saved("a.aris", content[:1400] + content[1500:]))
    assert first.startswith("frame 0: ") and others == [(10, 1), (10, 2)]


def test_a_stretch_of_an_aris_file_that_is_none(make, saved):
    """It counts as the frames that fit into it, and those before and after it are read."""
    content, error = make.aris(n_frames=4), "signature: expected 0x05464444 (ARIS, DDF_05), got 0x61616161"
    filled = damaged(content, 1024 + 1984, b"a" * (2 * 1984))
    wanted = [(10, 0), f"frame 1: {error}", f"frame 2: {error}", (10, 3)]
    assert whole(saved("a.aris", filled)) == wanted
    assert whole(saved("b.aris", filled[: 1024 + 1984] + filled[1024 + 1984 + 700 :])) == wanted
    assert whole(saved("c.aris", filled[: 1024 + 3 * 1984])) == wanted[:3]


def test_a_frame_of_a_long_aris_file_is_found_without_reading_it_all(make, saved, monkeypatch):
    path = saved("a.aris", make.aris(n_frames=2000))
    sizes, plain = [], FileContent.__getitem__

    def noted(content: FileContent, part: slice) -> bytes:
        sizes.append(len(found := plain(content, part)))
        return found

    monkeypatch.setattr(FileContent, "__getitem__", noted)
    (frame,) = iter_records(f"{path}:1998")
    assert frame.meta["recorded_index"] == 1998 and frame.meta["n_frames"] == 2000
    assert sum(sizes) < 80_000 and len(sizes) < 100


def test_a_damaged_frame_where_aris_frames_become_smaller_costs_no_others(make, saved):
    """All the smaller frames together are shorter than one of the larger."""
    content = make.aris(n_frames=3, n_ranges=60) + make.aris(n_frames=3, n_ranges=5)[1024:]
    unknown = damaged(content, 1024 + 3 * 6784 + 436, struct.pack("<I", 77))
    wanted = [(60, 0), (60, 1), (60, 2), "frame 3: PingMode: expected 1 to 12, got 77", (5, 1), (5, 2)]
    assert whole(saved("a.aris", unknown)) == wanted


@pytest.mark.parametrize("cut", [1500, 3000, 4500, 6774])
def test_an_unfinished_aris_frame_that_is_larger_than_those_before_it_is_left_out(make, saved, cut):
    longer = make.aris(n_frames=1, n_ranges=60)[1024:]
    assert whole(saved("a.aris", make.aris(n_frames=2, n_ranges=5) + longer[:cut])) == [(5, 0), (5, 1)]


@pytest.mark.parametrize("n_frames", [60, 200])
def test_an_aris_frame_of_another_shape_and_as_many_bytes_is_read(make, saved, n_frames):
    other = make.aris(n_frames=1, n_ranges=20, ping_mode=1)[1024:]
    content = damaged(make.aris(n_frames=n_frames), 1024 + 1984, other)
    shapes = [record.shape for record in iter_records(saved("a.aris", content))]
    assert shapes == [(10, 96), (20, 48), *[(10, 96)] * (n_frames - 2)]


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


def test_bytes_that_are_missing_from_a_didson_file(make, saved):
    """Frames after them lie elsewhere: no error in their place would be a frame of shifted pixels."""
    content = make.didson(n_frames=4)
    path = saved("d.ddf", content[:40_000] + content[41_000:])
    assert kinds(path) == [True, False, False]
    said = [str(record) for record in iter_records(path)][1:]
    for number, error in enumerate(said, start=1):
        assert error.startswith(f"{path}: frame {number}: signature: expected b'DDF' as in frame 0, got b'")


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


STATUS = struct.pack("<HHHHHIH", 0x4F53, 0, 0, 0x15, 0, 90, 0) + bytes(90)


@pytest.mark.parametrize("after", [b"", STATUS])
@pytest.mark.parametrize("damaged_ping", [0, 1])
def test_bytes_that_are_missing_from_an_oculus_ping_cost_that_ping(make, saved, damaged_ping, after):
    """Also if a message of another kind follows, which is longer than what is missing."""
    pings = [make.oculus(n_pings=1, n_ranges=12 + k) + after for k in range(3)]
    there = len(pings[damaged_ping]) - len(after) - 16
    pings[damaged_ping] = pings[damaged_ping][:260] + pings[damaged_ping][300:]
    path = saved("o.raw", b"".join(pings))
    shapes = [record.shape if isinstance(record, Frame) else str(record) for record in iter_records(path)]
    at = damaged_ping * len(pings[0])
    error = f"{path}: message at byte {at}: payload: expected {there} bytes to the next message, got {there - 40}"
    assert shapes == [error if number == damaged_ping else (12 + number, 16) for number in range(3)]


def test_an_oculus_ping_with_the_id_of_messages_among_its_pixels_is_whole(make, saved):
    """Even if no message begins where it ends."""
    ping = damaged(make.oculus(n_pings=1), 300, struct.pack("<HHHHHI", 0x4F53, 0, 0, 0x15, 0, 3) * 5)
    first, lost, last = iter_records(saved("o.raw", ping + damaged(make.oculus(n_pings=2), 0, b"xxxx")))
    np.testing.assert_array_equal(first.image, read_frames(saved("one.raw", ping))[0].image)
    assert "id: expected 0x4f53" in str(lost) and last.shape == (12, 16)


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
