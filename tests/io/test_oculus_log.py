"""Logs of the Oculus viewer, written by the test from the published layout."""

import struct

import numpy as np
import pytest

from sonarjax.io import Frame, SonarjaxError, describe, iter_records, parse_oculus_log, read_frames


@pytest.fixture
def packets(make) -> list[bytes]:
    return [make.oculus(n_pings=1, n_ranges=12 + number) for number in range(3)]


@pytest.mark.parametrize("compress", [False, True])
def test_the_pings_are_those_of_the_packets(make, saved, packets, compress):
    path = saved("log.oculus", make.oculus_log(packets, compress))
    frames = read_frames(path)
    raw = read_frames(saved("o.raw", b"".join(packets)))
    assert [frame.source for frame in frames] == [f"{path}:{number}" for number in range(3)]
    for one, other in zip(frames, raw, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        assert one.geometry == other.geometry
    assert read_frames(f"{path}:2")[0].shape == (14, 16)
    assert "Oculus raw ping" in describe(path)


def test_messages_that_are_no_pings_are_skipped(make, packets):
    status = struct.pack("<HHHHHIH", 0x4F53, 0, 0, 0x02, 0, 4, 0) + b"abcd"
    assert len(list(parse_oculus_log(make.oculus_log([status, packets[0], b"", status]), "l.oculus"))) == 1


def test_an_unfinished_ping_is_left_out(make, packets):
    content = make.oculus_log(packets)
    assert len(list(parse_oculus_log(content[:-20], "l.oculus"))) == 2


@pytest.mark.parametrize("compress", [False, True])
def test_a_damaged_item_costs_its_ping_alone(make, saved, packets, compress):
    whole = make.oculus_log(packets, compress)
    second = make.oculus_log(packets[:1], compress)
    at = len(second) + 43  # header of the second ping's item
    assert whole[at : at + 4] == struct.pack("<I", 0xAABBCCDD)
    lost = saved("a.oculus", whole[:at] + b"oops" + whole[at + 4 :])
    first, error, last = iter_records(lost)
    assert (first.shape, last.shape) == ((12, 16), (14, 16)) and f"item at byte {at}: item header: " in str(error)
    swollen = saved("c.oculus", whole[: at + 32] + struct.pack("<I", 500_000_000) + whole[at + 36 :])
    first, error, last = iter_records(swollen)
    assert (first.shape, last.shape) == ((12, 16), (14, 16)) and "and 500000000 bytes" in str(error)
    payload = at + 40 + 8
    wrong = saved("b.oculus", whole[:payload] + b"\xff" * 100 + whole[payload + 100 :])
    found = list(iter_records(wrong))
    assert [isinstance(record, Frame) for record in found].count(True) == 2
    if compress:
        assert "ping 1: payload: expected a zlib stream" in str(found[1])


@pytest.mark.parametrize("compress", [False, True])
def test_bytes_that_are_missing_from_an_item_cost_its_ping_alone(make, saved, packets, compress):
    content = make.oculus_log(packets, compress)
    at = len(make.oculus_log(packets[:1], compress)) + 43  # header of the second ping's item
    path = saved("a.oculus", content[: at + 80] + content[at + 100 :])
    first, error, last = iter_records(path)
    assert (first.shape, last.shape) == ((12, 16), (14, 16))
    assert f"item at byte {at}: item header: expected id 0xaabbccdd, 40 bytes or more and a payload up to" in str(error)


def test_a_packet_larger_than_it_says_is_refused(make, packets):
    content = make.oculus_log(packets[:1], True)
    at = content.rindex(struct.pack("<I", len(packets[0])), 0, content.rindex(struct.pack(">I", len(packets[0]))))
    short = content[:at] + struct.pack("<I", 100) + content[at + 4 :]
    with pytest.raises(SonarjaxError, match="originalSize: expected 100 bytes, got 101 or more"):
        list(parse_oculus_log(short, "l.oculus"))
    huge = content[:at] + struct.pack("<I", 2**31) + content[at + 4 :]
    with pytest.raises(SonarjaxError, match="originalSize: expected at most"):
        list(parse_oculus_log(huge, "l.oculus"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"abcdefgh" * 8, "file header: expected 0x11223344"),
        (b"\x44\x33\x22\x11", "file header: truncated"),
        (struct.pack("<II16sHH4xqd", 0x11223344, 48, b"Oculus", 1, 1, 0, 0.0), "encryption: expected 0"),
        (struct.pack("<II16sHH4xqd", 0x11223344, 48, b"Oculus", 1, 0, 0, 0.0), "items: expected a complete ping"),
    ],
)
def test_what_is_no_log(content, said):
    with pytest.raises(SonarjaxError, match=said) as caught:
        list(parse_oculus_log(content, "l.oculus"))
    assert str(caught.value).startswith("l.oculus: ") and "\n" not in str(caught.value)


def test_real_packets_as_a_log(make, saved, real):
    with open(real("oculus/three_pings_8bit.raw"), "rb") as file:
        content = file.read()
    size = len(content) // 3
    log = saved("real.oculus", make.oculus_log([content[k * size : (k + 1) * size] for k in range(3)], True))
    for one, other in zip(read_frames(log), read_frames(real("oculus/three_pings_8bit.raw")), strict=True):
        np.testing.assert_array_equal(one.image, other.image)
