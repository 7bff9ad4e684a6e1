"""Oculus pings written by the test, and the real ones where they are at hand."""

import struct

import numpy as np
import pytest

from sonarjax.io import SonarjaxError, describe, parse_oculus, read_frames


@pytest.mark.parametrize(("bits", "scale"), [(8, 255), (16, 65535)])
def test_pings(make, saved, bits, scale):
    frames = read_frames(saved("o.raw", make.oculus(n_pings=3, bits=bits)))
    assert [frame.stem for frame in frames] == ["o_0", "o_1", "o_2"]
    for number, frame in enumerate(frames):
        # Bearings grow to starboard, azimuth to port: the columns are reversed.
        np.testing.assert_allclose(frame.image[:, ::-1] * scale, make.ramp(12, 16, number), atol=1e-2)
    geometry = frames[0].geometry
    assert geometry["azimuth_deg"][0] == -30.0 and geometry["azimuth_deg"][-1] == 30.0
    assert (geometry["range_min_m"], geometry["range_max_m"], geometry["n_ranges"]) == (0.0, pytest.approx(0.03), 12)
    assert (geometry["frequency_hz"], geometry["sound_speed_m_s"]) == (2.1e6, 1490.0)


def test_bearing_sign(make):
    (frame,) = parse_oculus(make.oculus(n_pings=1), "o.raw", bearing_sign=1)
    np.testing.assert_allclose(frame.image * 255, make.ramp(12, 16), atol=1e-4)


def test_other_messages_are_skipped_and_an_unfinished_ping_left_out(make):
    other = struct.pack("<HHHHHIH", 0x4F53, 0, 0, 0x15, 0, 5, 0) + b"12345"
    content = other + make.oculus(n_pings=2) + other
    assert len(list(parse_oculus(content, "o.raw"))) == 2
    assert len(list(parse_oculus(content[: -len(other) - 1], "o.raw"))) == 1
    assert len(list(parse_oculus(content[:-20], "o.raw"))) == 2  # part of a message header
    with pytest.raises(SonarjaxError, match="expected a ping result"):
        list(parse_oculus(other, "o.raw"))


BAD = [
    (0, "H", (1,), "id: expected 0x4f53"),
    (8, "H", (2,), "version: expected 0, got 2"),
    (10, "I", (2**32 - 1,), "truncated"),
    (97, "B", (3,), "dataSize"),
    (98, "d", (float("nan"),), "rangeResolution"),
    (106, "H", (0,), "nRanges"),
    (108, "H", (65535,), "nBeams"),
    (106, "HH", (4000, 4000), "imageSize"),
    (110, "I", (2**31,), "imageOffset"),
    (110, "I", (4,), "imageOffset"),
    (122, "hh", (5, 5), "bearings: expected"),
]


@pytest.mark.parametrize(("offset", "layout", "values", "message"), BAD)
def test_bad_headers(make, saved, offset, layout, values, message):
    content = bytearray(make.oculus())
    struct.pack_into("<" + layout, content, offset, *values)
    with pytest.raises(SonarjaxError, match=message):
        read_frames(saved("o.raw", bytes(content)))


def test_garbage_in_unused_fields_is_left_out(make):
    (frame,) = parse_oculus(make.oculus(n_pings=1, sound_speed=float("nan")), "o.raw")
    assert "sound_speed_m_s" not in frame.geometry


@pytest.mark.parametrize("size", [1, 15, 16, 60, 121, 200, 300])
def test_truncated(make, saved, size):
    with pytest.raises(SonarjaxError, match="truncated"):
        read_frames(saved("o.raw", make.oculus(n_pings=1)[:size]))


@pytest.mark.parametrize(("name", "n_pings"), [("one_ping_8bit.raw", 1), ("three_pings_8bit.raw", 3)])
def test_real_files(real, name, n_pings):
    path = real(f"oculus/{name}")
    frames = read_frames(path)
    assert len(frames) == n_pings and frames[-1].shape == (703, 256)
    geometry = frames[0].geometry
    assert geometry["frequency_hz"] == pytest.approx(2.0989e6, rel=1e-4)
    assert geometry["range_max_m"] / 703 == pytest.approx(2.842e-3, abs=1e-6)
    assert geometry["azimuth_deg"][0] == -30.0 and geometry["azimuth_deg"][-1] == 30.0
    assert len({round(step, 2) for step in np.diff(geometry["azimuth_deg"])}) > 1  # uneven
    assert "703 range bins x 256 beams" in describe(path)
