"""DIDSON files written by the test from the format notes (no real file is at hand)."""

import dataclasses
import struct

import numpy as np
import pytest

from sonarjax.io import DIDSON_TABLES, SonarjaxError, didson_azimuth_deg, parse_didson, read_frames


@pytest.mark.parametrize(("version", "file_header"), [(3, 512), (4, 1024), (4, 512)])
def test_versions(make, saved, version, file_header):
    frames = read_frames(saved("d.ddf", make.didson(version=version, file_header=file_header)))
    assert len(frames) == 2
    for number, frame in enumerate(frames):
        np.testing.assert_allclose(frame.image * 255, make.ramp(512, 96, number), atol=1e-4)
    geometry = frames[0].geometry
    assert geometry["range_min_m"] == pytest.approx(3 * 0.375)
    assert geometry["range_max_m"] == pytest.approx(3 * 0.375 + 2.25)
    assert (geometry["tilt_deg"], geometry["roll_deg"], geometry["frequency_hz"]) == (15.0, 0.5, 1.8e6)
    assert frames[0].meta["time"] == "2009-06-01 12:30:15.50"
    assert frames[0].meta["time_ns"] == 1_243_859_415_500_000_000  # `date -u -d "2009-06-01 12:30:15.5" +%s%N`


def test_a_date_that_is_none_is_left_out(make, saved):
    content = bytearray(make.didson())
    struct.pack_into("<i", content, 512 + 24, 13)
    first, second = read_frames(saved("d.ddf", bytes(content)))
    assert first.meta["time"].startswith("2009-13-01") and "time_ns" not in first.meta and "time_ns" in second.meta


def test_size_of_the_file_header_without_signed_frames(make):
    content = bytearray(make.didson(version=4, file_header=512))
    for number in range(2):
        at = 512 + number * (1024 + 512 * 96) + 12
        content[at : at + 4] = bytes(4)
    assert len(list(parse_didson(bytes(content), "d.ddf"))) == 2


@pytest.mark.parametrize(
    ("flags", "high", "start", "length"),
    [(1, 1, 0.375, 1.125), (0, 1, 0.419, 1.25), (1, 0, 0.75, 4.5), (0, 0, 0.838, 5)],
)
def test_windows(make, flags, high, start, length):
    content = make.didson(n_frames=1, flags=flags, high=high, start=1, length=0, n_beams=96 if high else 48)
    (frame,) = parse_didson(content, "d.ddf")
    assert frame.geometry["range_min_m"] == pytest.approx(start)
    assert frame.geometry["range_max_m"] == pytest.approx(start + length)
    assert frame.geometry["frequency_hz"] == (1.8e6 if high else 1.1e6)


@pytest.mark.parametrize(("high", "largest"), [(1, 5), (0, 3)])
def test_window_codes(make, high, largest):
    for code in (0, largest):
        assert len(list(parse_didson(make.didson(high=high, length=code), "d.ddf"))) == 2
    for code in (-3, -2, -1, largest + 1):
        said = f"d.ddf: frame 0: window length: expected a code of 0 to {largest}, got {code}"
        with pytest.raises(SonarjaxError, match=said):
            list(parse_didson(make.didson(high=high, length=code), "d.ddf"))


def test_lens():
    azimuth = didson_azimuth_deg(96)
    beam = 1.012 * (0.0030 * azimuth**3 - 0.0055 * azimuth**2 + 2.6829 * azimuth + 48.04) + 1
    np.testing.assert_allclose(beam, np.arange(1, 97), atol=1e-4)
    np.testing.assert_allclose(azimuth[[0, -1]], [-14.25, 14.25], atol=0.03)
    np.testing.assert_allclose(didson_azimuth_deg(48), (azimuth[::2] + azimuth[1::2]) / 2, atol=1e-3)


def test_reverse_mirrors_the_beams(make):
    (plain,) = parse_didson(make.didson(n_frames=1), "d.ddf")
    (mirrored,) = parse_didson(make.didson(n_frames=1, reverse=1), "d.ddf")
    np.testing.assert_array_equal(mirrored.image, plain.image[:, ::-1])


def test_tables_can_be_replaced(make):
    tables = dataclasses.replace(DIDSON_TABLES, lengths_m=((0.83,) * 6,) * 4, lens=(0.0, 0.0, 3.0, 48.0))
    (frame,) = parse_didson(make.didson(n_frames=1), "d.ddf", tables=tables)
    assert frame.geometry["range_max_m"] - frame.geometry["range_min_m"] == pytest.approx(0.83)
    assert np.ptp(np.diff(frame.geometry["azimuth_deg"])) < 1e-6


BAD = [
    (0, "3sB", (b"DDF", 2), "signature: expected DDF_03 or DDF_04"),
    (16, "i", (95,), "numbeams: expected 48 or 96, got 95"),
    (24, "i", (-5,), "samples: expected 1 to"),
    (24, "i", (60000,), "truncated"),
    (512 + 52, "i", (-1,), "frame 0: window start"),
    (512 + 56, "i", (6,), "frame 0: window length: expected a code of 0 to 5, got 6"),
]


@pytest.mark.parametrize(("offset", "layout", "values", "message"), BAD)
def test_bad_headers(make, saved, offset, layout, values, message):
    content = bytearray(make.didson())
    struct.pack_into("<" + layout, content, offset, *values)
    with pytest.raises(SonarjaxError, match=message):
        read_frames(saved("d.ddf", bytes(content)))


@pytest.mark.parametrize("size", [2, 30, 511, 512, 700, 512 + 256 + 512 * 96 - 1])
def test_truncated(make, saved, size):
    with pytest.raises(SonarjaxError, match="truncated"):
        read_frames(saved("d.ddf", make.didson()[:size]))
