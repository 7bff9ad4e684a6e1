"""ARIS files written by the test, and the real one where it is at hand."""

import math
import struct

import numpy as np
import pytest

from sonarjax.io import SonarjaxError, aris_azimuth_deg, describe, read_frames


def test_frames_geometry_and_names(make, saved):
    path = saved("dive.aris", make.aris(n_frames=3))
    frames = read_frames(path)
    assert [frame.source for frame in frames] == [f"{path}:{n}" for n in range(3)]
    assert [frame.stem for frame in frames] == ["dive_0", "dive_1", "dive_2"]
    for number, frame in enumerate(frames):
        assert frame.image.dtype == np.float32 and frame.mask is None
        np.testing.assert_allclose(frame.image * 255, make.ramp(10, 96, number), atol=1e-4)
    geometry = frames[0].geometry
    metres = 1e-6 * 1450.0 / 2
    assert geometry["range_min_m"] == pytest.approx(1000 * metres)
    assert geometry["range_max_m"] == pytest.approx((1000 + 5 * 10) * metres)
    assert (geometry["n_ranges"], geometry["frequency_hz"], geometry["elevation_aperture_deg"]) == (10, 1.8e6, 14.0)
    assert (geometry["tilt_deg"], geometry["roll_deg"], geometry["sound_speed_m_s"]) == (12.5, 2.5, 1450.0)
    assert frames[0].meta["n_frames"] == 3 and "80 dB" in frames[0].meta["stored_scale"]


def test_one_frame(make, saved):
    path = saved("dive.aris", make.aris(n_frames=3))
    (frame,) = read_frames(f"{path}:2")
    assert frame.stem == "dive_2" and frame.image[0, 0] == pytest.approx(2 / 255)
    with pytest.raises(SonarjaxError, match="frame 3: expected 0 to 2"):
        read_frames(f"{path}:3")


def test_a_file_of_one_frame_keeps_its_name(make, saved):
    path = saved("dive.aris", make.aris(n_frames=1))
    (frame,) = read_frames(path)
    assert (frame.source, frame.stem) == (path, "dive")


FIRST = [(0, 96, False, 13.749), (0, 48, False, 13.5735), (2, 48, False, 13.5735), (1, 64, False, 14.887)]
FIRST += [(1, 128, False, 15.007), (0, 96, True, 7.419), (2, 48, True, 7.339)]


@pytest.mark.parametrize(("system", "n_beams", "lens", "first"), FIRST)
def test_beam_tables(system, n_beams, lens, first):
    azimuth = aris_azimuth_deg(system, n_beams, lens)
    spacing = np.diff(azimuth)
    assert azimuth.shape == (n_beams,) and azimuth[0] == pytest.approx(-first, abs=1e-9)
    np.testing.assert_allclose(azimuth, -azimuth[::-1], atol=1e-9)
    assert (spacing > 0).all() and spacing[n_beams // 2 - 1] > spacing[0]


@pytest.mark.parametrize(("system", "n_beams", "middle", "edge"), [(0, 96, 0.342, 0.21), (1, 128, 0.246, 0.217)])
def test_beam_spacing(system, n_beams, middle, edge):
    spacing = np.diff(aris_azimuth_deg(system, n_beams, False))
    assert spacing[n_beams // 2 - 1] == pytest.approx(middle, abs=5e-4)
    assert spacing[0] == pytest.approx(edge, abs=5e-4)


def test_an_unknown_device_still_gives_its_image(make, saved):
    (frame,) = read_frames(saved("a.aris", make.aris(n_frames=1, system=7)))
    assert frame.geometry is None and "SystemType 7" in frame.meta["device"]


def test_nan_angles_are_left_out(make, saved):
    content = bytearray(make.aris(n_frames=1))
    struct.pack_into("<ff", content, 1024 + 248, math.nan, math.inf)
    (frame,) = read_frames(saved("a.aris", bytes(content)))
    assert "tilt_deg" not in frame.geometry and "roll_deg" not in frame.geometry


def test_an_unfinished_frame_is_left_out(make, saved):
    frames = read_frames(saved("a.aris", make.aris(n_frames=3)[:-1]))
    assert len(frames) == 2 and frames[0].meta["unfinished_bytes"] == 1024 + 959


BAD = [
    (0, "I", 0, "signature: expected 0x05464444"),
    (1024 + 12, "I", 1, "frame 0: signature"),
    (1024 + 436, "I", 13, "PingMode: expected 1 to 12, got 13"),
    (1024 + 468, "I", 0, "SamplesPerBeam: expected 1 to"),
    (1024 + 468, "I", 2**32 - 1, "SamplesPerBeam: expected 1 to"),
    (1024 + 468, "I", 60000, "frame 0: SamplesPerBeam, PingMode: expected 10 x 96 as in other frames, got 60000 x 96"),
    (1024 + 436, "I", 6, "frame 0: SamplesPerBeam, PingMode: expected 10 x 96 as in other frames, got 10 x 64"),
    (1024 + 464, "f", math.nan, "SoundSpeed: expected 1000 to 2000 m/s, got nan"),
    (1024 + 452, "I", 0, "SamplePeriod: expected 1 to"),
    (1024 + 476, "I", 2**32 - 1, "range window: expected 0 to 1000 m"),
    (1024 + 516, "I", 0, "frame 0: ReorderedSamples: expected 1, got 0"),
    (2 * 1024 + 960 + 468, "I", 9, "frame 1: SamplesPerBeam, PingMode: expected 10 x 96"),
    (2 * 1024 + 960 + 468, "I", 60000, "frame 1: SamplesPerBeam, PingMode: expected 10 x 96"),
]


@pytest.mark.parametrize(("offset", "layout", "value", "message"), BAD)
def test_bad_headers(make, saved, offset, layout, value, message):
    content = bytearray(make.aris())
    struct.pack_into("<" + layout, content, offset, value)
    path = saved("a.aris", bytes(content))
    with pytest.raises(SonarjaxError, match=message) as caught:
        read_frames(path)
    assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [1, 3, 100, 1024, 1500, 2047, 2048 + 959])
def test_truncated(make, saved, size):
    with pytest.raises(SonarjaxError, match="truncated"):
        read_frames(saved("a.aris", make.aris()[:size]))


def test_real_file(real):
    path = real("aris/sample.aris")
    frames = read_frames(path)
    assert len(frames) == 6 and frames[0].shape == (2000, 48)
    geometry = frames[0].geometry
    assert geometry["range_min_m"] == pytest.approx(3.298, abs=5e-4)
    assert geometry["range_max_m"] - geometry["range_min_m"] == pytest.approx(20.10, abs=5e-3)
    assert geometry["azimuth_deg"][0] == pytest.approx(-7.339) and "roll_deg" not in geometry
    assert 0.2 < frames[0].image.mean() < 0.6
    assert "ARIS 1200" in describe(path) and "48 beams" in describe(path)


@pytest.mark.parametrize(
    ("system", "mode", "low", "high"), [(0, 3, 1.1e6, 1.8e6), (1, 9, 1.8e6, 3.0e6), (2, 1, 0.7e6, 1.2e6)]
)
def test_the_header_says_which_of_two_frequencies(make, saved, system, mode, low, high):
    content = bytearray(make.aris(n_frames=1, system=system, ping_mode=mode))
    (frame,) = read_frames(saved("a.aris", bytes(content)))
    assert frame.geometry["frequency_hz"] == high and len(frame.geometry["azimuth_deg"]) == frame.shape[1]
    content[1024 + 440 : 1024 + 444] = bytes(4)
    (frame,) = read_frames(saved("b.aris", bytes(content)))
    assert frame.geometry["frequency_hz"] == low


def test_a_large_lens_has_another_aperture(make, saved):
    (frame,) = read_frames(saved("a.aris", make.aris(n_frames=1, lens=1)))
    assert "elevation_aperture_deg" not in frame.geometry and frame.meta["large_lens"]
