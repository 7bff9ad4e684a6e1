"""ARIS recordings (`.aris`, DDF_05): bytes in, frames out.

The layout was checked on a real file of six frames: a 1024-byte file header, then for each frame a 1024-byte header and
SamplesPerBeam x BeamCount bytes stored (range, beam), beam 0 the rightmost. The number of frames follows from the size
of the file, never from the header. Offsets, PingMode and SystemType follow Sound Metrics' published ARIS file SDK.

Not checked on a file: the signs of SonarTilt (assumed positive up, so `tilt_deg` is its negative) and of SonarRoll, the
meaning of FrequencyHiLow, and an aperture of 14 deg without the large lens.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sonarjax.io.aris_beams import ARIS_1200, ARIS_1800, ARIS_3000, aris_azimuth_deg
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content
from sonarjax.io.frame import Frame, Geometry
from sonarjax.io.header import RANGE_LIMIT_M, Fields, Header, angles, time_stamp
from sonarjax.io.naming import named
from sonarjax.io.recording import Record, each_record, frames_of

SIGNATURE = 0x05464444
HEADER_BYTES = 1024
MAX_SAMPLES = 65536
LONGEST_SEARCH = 2**26
"""Where the search for another frame header ends if frame 0 is damaged, 64 MiB [bytes]: several frames."""
SIGNATURES_TRIED = 64
"""How many candidates for a frame header are tried if frame 0 is damaged."""
FRAME_FIELDS: Fields = {
    "FrameIndex": (0, "I"),
    "FrameTime": (4, "Q"),
    "Version": (12, "I"),
    "WindowStart": (52, "f"),
    "WindowLength": (56, "f"),
    "CompassHeading": (160, "f"),
    "SonarPan": (244, "f"),
    "SonarTilt": (248, "f"),
    "SonarRoll": (252, "f"),
    "PingMode": (436, "I"),
    "FrequencyHiLow": (440, "I"),
    "SamplePeriod": (452, "I"),
    "SoundSpeed": (464, "f"),
    "SamplesPerBeam": (468, "I"),
    "SampleStartDelay": (476, "I"),
    "LargeLens": (480, "I"),
    "SystemType": (484, "I"),
    "ReorderedSamples": (516, "I"),
}
"""Fields that are read of a frame header; times in microseconds, lengths in metres, angles in degrees."""
SYSTEMS = {ARIS_1800: "ARIS 1800", ARIS_3000: "ARIS 3000", ARIS_1200: "ARIS 1200"}
FREQUENCIES_HZ = {ARIS_1800: (1.1e6, 1.8e6), ARIS_3000: (1.8e6, 3.0e6), ARIS_1200: (0.7e6, 1.2e6)}
"""SystemType -> frequency at FrequencyHiLow 0 and 1 [Hz]."""


@dataclass(frozen=True)
class ArisLayout:
    """Size of every frame of a file, and how many frames are complete."""

    n_ranges: int
    """Range bins of a frame."""
    n_beams: int
    """Beams of a frame."""
    n_frames: int
    """Complete frames in the file."""
    rest: int
    """Bytes after the last complete frame."""

    @property
    def frame_bytes(self) -> int:
        """Size of one frame with its header [bytes]."""
        return HEADER_BYTES + self.n_ranges * self.n_beams


def beam_count(ping_mode: int) -> int:
    """Number of beams of a PingMode; 0 if it is unknown."""
    table = ((1, 2, 48), (3, 5, 96), (6, 8, 64), (9, 12, 128))
    return next((beams for low, high, beams in table if low <= ping_mode <= high), 0)


def aris_layout(data: Content, name: str) -> ArisLayout:
    """Read the sizes from the first frame's header, or from a later one if the first is damaged.

    Raises:
        SonarjaxError: The signature is wrong, no frame is complete, or no frame has a valid PingMode and
            SamplesPerBeam.
    """
    file = Header(data, name)
    _check_signature(file, file.unpack("I", 0, "signature")[0])
    first = Header(data, name, HEADER_BYTES, "frame 0")
    try:
        n_ranges, n_beams = _size(first, first.fields(FRAME_FIELDS, HEADER_BYTES))
    except SonarjaxError:
        later = _later_size(data, name)
        if later is None:
            raise
        n_ranges, n_beams = later
    frame_bytes = HEADER_BYTES + n_ranges * n_beams
    n_frames, rest = divmod(len(data) - HEADER_BYTES, frame_bytes)
    if n_frames == 0:
        wanted = HEADER_BYTES + frame_bytes
        raise first.error("samples", f"truncated: expected {wanted} bytes or more, the file has {len(data)}")
    return ArisLayout(n_ranges, n_beams, n_frames, rest)


def _later_size(data: Content, name: str) -> tuple[int, int] | None:
    """Range bins and beams from the first later header whose sizes explain its position; None if there is none."""
    position = HEADER_BYTES + 12
    for _ in range(SIGNATURES_TRIED):
        position = data.find(struct.pack("<I", SIGNATURE), position + 1, LONGEST_SEARCH)
        if position < 0:
            return None
        header = Header(data, name, position - 12, f"frame at byte {position - 12}")
        try:
            n_ranges, n_beams = _size(header, header.fields(FRAME_FIELDS, HEADER_BYTES))
        except SonarjaxError:
            continue
        if (header.base - HEADER_BYTES) % (HEADER_BYTES + n_ranges * n_beams) == 0:
            return n_ranges, n_beams
    return None


def parse_aris(data: Content, name: str, index: int | None = None) -> Iterator[Frame]:
    """Yield the frames of an ARIS file, or only frame `index`.

    The image is the stored byte / 255. Stored bytes of 0 to 255 mean 0 to 80 dB.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the names of the frames.
        index: Number of a frame, from 0; None means all frames.

    Yields:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: The signature, sizes, sound speed, sample period or range window cannot be used; no frame is
            complete; a frame has another size, or its samples are still in the order in which the device sent them; or
            the index is out of range.
    """
    return frames_of(aris_records(data, name, index))


def aris_records(data: Content, name: str, index: int | None = None) -> Iterator[Record]:
    """As `parse_aris`, but a frame that cannot be read is yielded as its error; the others are not affected."""
    layout = aris_layout(data, name)
    yield from each_record(name, layout.n_frames, index, lambda number: _read(data, name, layout, number))


def _read(data: Content, name: str, layout: ArisLayout, number: int) -> Frame:
    header = Header(data, name, HEADER_BYTES + number * layout.frame_bytes, f"frame {number}")
    fields = header.fields(FRAME_FIELDS, HEADER_BYTES)
    _check_signature(header, fields["Version"])
    if _size(header, fields) != (layout.n_ranges, layout.n_beams):
        raise header.error("SamplesPerBeam, PingMode", f"expected {layout.n_ranges} x {layout.n_beams} as in frame 0")
    if fields["ReorderedSamples"] == 0:
        raise header.error(
            "ReorderedSamples", "expected 1, got 0: the samples are in the device's order, not beam after beam"
        )
    image = header.pixels(HEADER_BYTES, layout.n_ranges, layout.n_beams)
    meta = _meta(fields) | {"unfinished_bytes": layout.rest}
    return named(image, name, number, layout.n_frames, _geometry(header, fields, layout), meta)


def _check_signature(header: Header, found: int) -> None:
    if found != SIGNATURE:
        raise header.error("signature", f"expected 0x{SIGNATURE:08x} (ARIS, DDF_05), got 0x{found:08x}")


def _size(header: Header, fields: dict[str, Any]) -> tuple[int, int]:
    mode = fields["PingMode"]
    if not beam_count(mode):
        raise header.error("PingMode", f"expected 1 to 12, got {mode}")
    return header.count(fields["SamplesPerBeam"], "SamplesPerBeam", MAX_SAMPLES), beam_count(mode)


def _geometry(header: Header, fields: dict[str, Any], layout: ArisLayout) -> Geometry | None:
    sound_speed = header.quantity(fields["SoundSpeed"], "SoundSpeed", 1000.0, 2000.0, "m/s")
    metres = 1e-6 * sound_speed / 2  # range for each microsecond of two-way travel
    start = fields["SampleStartDelay"] * metres
    period = header.count(fields["SamplePeriod"], "SamplePeriod", 10**6)
    stop = header.quantity(start + period * layout.n_ranges * metres, "range window", 0.0, RANGE_LIMIT_M, "m")
    system, lens = fields["SystemType"], fields["LargeLens"] != 0
    azimuth = aris_azimuth_deg(system, layout.n_beams, lens)
    if azimuth is None:
        return None  # the image can still be used with a sonar.toml
    geometry: Geometry = {
        "azimuth_deg": azimuth.tolist(),
        "range_min_m": start,
        "range_max_m": stop,
        "n_ranges": layout.n_ranges,
        "sound_speed_m_s": sound_speed,
        "frequency_hz": FREQUENCIES_HZ[system][fields["FrequencyHiLow"] != 0],
    }
    if not lens:
        geometry["elevation_aperture_deg"] = 14.0
    return geometry | angles(-fields["SonarTilt"], fields["SonarRoll"])


def _meta(fields: dict[str, Any]) -> dict[str, Any]:
    return {
        "format": "ARIS (DDF_05)",
        "stored_scale": "u8, 0 to 255 is 0 to 80 dB",
        "device": SYSTEMS.get(fields["SystemType"], f"unknown SystemType {fields['SystemType']}"),
        "large_lens": fields["LargeLens"] != 0,
        "ping_mode": fields["PingMode"],
        "recorded_index": fields["FrameIndex"],
        "time_us": fields["FrameTime"],
        **time_stamp(1000 * fields["FrameTime"]),
        "header_window_m": [fields["WindowStart"], fields["WindowLength"]],
        "compass_heading_deg": fields["CompassHeading"],
        "pan_deg": fields["SonarPan"],
    }
