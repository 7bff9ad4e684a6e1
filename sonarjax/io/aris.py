"""ARIS recordings (`.aris`, DDF_05): bytes in, frames out.

The layout was checked on a real file of six frames: a 1024-byte file header, then for each frame a 1024-byte header and
SamplesPerBeam x BeamCount bytes stored (range, beam), beam 0 the rightmost. Offsets, PingMode and SystemType follow
Sound Metrics' published ARIS file SDK.

The number of frames follows from the size of the file and of its frames, never from the file header. Where all frames
are alike, one is found without reading those before it. Otherwise, as after damage, a change of the window or in joined
recordings, the file is walked from frame header to frame header.

Not checked on a file: the signs of SonarTilt (assumed positive up, so `tilt_deg` is its negative) and of SonarRoll, the
meaning of FrequencyHiLow, and an aperture of 14 deg without the large lens.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sonarjax.io.aris_beams import ARIS_1200, ARIS_1800, ARIS_3000, aris_azimuth_deg
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content
from sonarjax.io.frame import Frame, Geometry
from sonarjax.io.header import RANGE_LIMIT_M, Fields, Header, angles, time_stamp
from sonarjax.io.naming import named
from sonarjax.io.recording import Record, each_record, frames_of

SIGNATURE = 0x05464444
SIGNED = struct.pack("<I", SIGNATURE)
SIGNED_AT = 12
"""Where a frame header holds the signature [bytes]; the file header begins with it."""
HEADER_BYTES = 1024
MAX_SAMPLES = 65536
LONGEST_SEARCH = 2**26
"""Where the search for the usual size of frames ends if frame 0 is damaged, 64 MiB [bytes]: several frames."""
SIGNATURES_TRIED = 64
"""How many candidates for the next frame header are tried after damage."""
PROBES = 64
"""About how many frames of a long file are looked at to see if all are alike."""
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


class FrameSize(NamedTuple):
    """What determines how many bytes a frame takes."""

    n_ranges: int
    """Range bins of the frame."""
    n_beams: int
    """Beams of the frame."""

    @property
    def frame_bytes(self) -> int:
        """Size of the frame with its header [bytes]."""
        return HEADER_BYTES + self.n_ranges * self.n_beams


@dataclass(frozen=True)
class ArisLayout:
    """Where the frames of a file are."""

    starts: Sequence[int | SonarjaxError]
    """Where each frame begins [bytes]; for a frame that is cut short or states an impossible size, its error."""
    size: FrameSize | None
    """Every frame must take as many bytes as one of this size; None if they may differ."""
    rest: int
    """Bytes after the last complete frame."""


def beam_count(ping_mode: int) -> int:
    """Number of beams of a PingMode; 0 if it is unknown."""
    table = ((1, 2, 48), (3, 5, 96), (6, 8, 64), (9, 12, 128))
    return next((beams for low, high, beams in table if low <= ping_mode <= high), 0)


def aris_layout(data: Content, name: str) -> ArisLayout:
    """Find the frames: from the headers of a few if all are alike, or else from header to header.

    Raises:
        SonarjaxError: The signature is wrong, no frame is complete, or no frame has a valid PingMode and
            SamplesPerBeam.
    """
    file = Header(data, name)
    _check_signature(file, file.unpack("I", 0, "signature")[0])
    usual = _usual_size(data, name)
    layout = _even_layout(data, name, usual) or _walked_layout(data, name, usual)
    if not layout.starts:
        wanted = HEADER_BYTES + usual.frame_bytes
        problem = f"truncated: expected {wanted} bytes or more, the file has {len(data)}"
        raise Header(data, name, HEADER_BYTES, "frame 0").error("samples", problem)
    return layout


def _usual_size(data: Content, name: str) -> FrameSize:
    """The size of frame 0, or of a later frame if the first is damaged."""
    own = _size_at(data, name, HEADER_BYTES)
    if own is not None and _is_end(data, HEADER_BYTES + own.frame_bytes):
        return own
    later = [*_headers_after(data, name, HEADER_BYTES, LONGEST_SEARCH)]
    leading = [size for base, size in later if (base - HEADER_BYTES) % size.frame_bytes == 0]
    sizes = [*leading, own] if own else [*leading, *(size for _, size in later)]
    if sizes:
        return sizes[0]
    first = Header(data, name, HEADER_BYTES, "frame 0")
    return _size(first, first.fields(FRAME_FIELDS, HEADER_BYTES))  # this says what is wrong with it


def _even_layout(data: Content, name: str, size: FrameSize) -> ArisLayout | None:
    """The layout of frames that are all of this size; None if they are not.

    In a long file only some frames are looked at, and the last: where the size changes, the later frames lie elsewhere.
    """
    n_frames, rest = divmod(len(data) - HEADER_BYTES, size.frame_bytes)
    if n_frames == 0:
        return None
    end = len(data) - rest
    starts = range(HEADER_BYTES, end, size.frame_bytes)
    probed = [*starts[:: max(1, n_frames // PROBES)], *starts[-1:]]
    if any(_size_at(data, name, start) != size for start in probed):
        return None
    last = _size_at(data, name, end)
    complete = last is not None and last.frame_bytes <= rest
    later = next(_headers_after(data, name, end, len(data)), None)  # frames became smaller, the first is damaged
    if complete or later or _is_file_header(data, end) or not _is_end(data, end):
        return None
    return ArisLayout(starts, size, rest)


def _walked_layout(data: Content, name: str, usual: FrameSize) -> ArisLayout:
    """The layout of frames that may differ: each ends where its own size says, if another begins there.

    Otherwise all up to the next intact header is divided into frames of one size.
    """
    starts: list[int | SonarjaxError] = []
    position = HEADER_BYTES
    while position + HEADER_BYTES < len(data):
        if _is_file_header(data, position):  # recordings were joined
            position += HEADER_BYTES
            continue
        own = _size_at(data, name, position)
        end = position + (own or usual).frame_bytes
        if _is_end(data, end):
            starts.append(position)
            position, usual = end, own or usual
            continue
        following = _next_start(data, name, position)
        if own is not None and not _is_end(data, position + usual.frame_bytes):
            if following is None and end > len(data):
                break  # the last frame is larger than those before it, and unfinished
            fits = end <= (len(data) if following is None else following)
            usual = own if fits else usual  # then the next header is damaged, not the size in this one
        header = Header(data, name, position, f"frame {len(starts)}")
        pieces = _pieces(header, own, usual, following)
        starts += pieces
        if following is None:
            position += len(pieces) * usual.frame_bytes
            break
        position = following
    return ArisLayout(starts, None, len(data) - position)


def _pieces(
    header: Header, own: FrameSize | None, usual: FrameSize, following: int | None
) -> list[int | SonarjaxError]:
    """Frames of the usual size from `header`, which states `own`, to the next intact header or the end of the file."""
    stop = len(header.data) - usual.frame_bytes + 1 if following is None else following
    pieces: list[int | SonarjaxError] = [*range(header.base, stop, usual.frame_bytes)]
    if pieces and own is not None:
        if own != usual:
            pieces[0] = _other_size(header, own, usual)
        elif following is not None and following < header.base + own.frame_bytes:
            there = following - header.base
            pieces[0] = header.error("samples", f"expected {own.frame_bytes} bytes to the next frame, got {there}")
    return pieces


def _next_start(data: Content, name: str, position: int) -> int | None:
    """Where the next intact frame header begins, or the file header before it; None if there is none."""
    base = next((base for base, _ in _headers_after(data, name, position, len(data))), None)
    if base is None:
        return None
    before = base - HEADER_BYTES
    return before if before > position and _is_file_header(data, before) else base


def _headers_after(data: Content, name: str, base: int, end: int) -> Iterator[tuple[int, FrameSize]]:
    """Position and size of the intact frame headers after the one at byte `base`, as far as signatures are tried."""
    position = base + SIGNED_AT
    for _ in range(SIGNATURES_TRIED):
        position = data.find(SIGNED, position + 1, end)
        if position < 0:
            return
        size = _size_at(data, name, position - SIGNED_AT)
        if size is not None:
            yield position - SIGNED_AT, size


def _size_at(data: Content, name: str, base: int) -> FrameSize | None:
    """The size in the frame header at byte `base`; None if there is no such header, or it is damaged."""
    header = Header(data, name, base)
    try:
        fields = header.fields(FRAME_FIELDS, HEADER_BYTES)
        _check_signature(header, fields["Version"])
        return _size(header, fields)
    except SonarjaxError:
        return None


def _is_end(data: Content, end: int) -> bool:
    """True if a frame may end at byte `end`: another frame or a file header follows, or too little to tell."""
    if end + SIGNED_AT + len(SIGNED) > len(data):
        return end <= len(data)
    return data[end + SIGNED_AT : end + SIGNED_AT + len(SIGNED)] == SIGNED or _is_file_header(data, end)


def _is_file_header(data: Content, base: int) -> bool:
    """True if a file header is at byte `base`, with a frame behind it."""
    signatures = (base, base + HEADER_BYTES + SIGNED_AT)
    return all(data[at : at + len(SIGNED)] == SIGNED for at in signatures)


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
            complete; a frame is cut short, or its samples are still in the order in which the device sent them; or
            the index is out of range.
    """
    return frames_of(aris_records(data, name, index))


def aris_records(data: Content, name: str, index: int | None = None) -> Iterator[Record]:
    """As `parse_aris`, but a frame that cannot be read is yielded as its error; the others are not affected."""
    layout = aris_layout(data, name)
    yield from each_record(name, len(layout.starts), index, lambda number: _read(data, name, layout, number))


def _read(data: Content, name: str, layout: ArisLayout, number: int) -> Frame:
    start = layout.starts[number]
    if isinstance(start, SonarjaxError):
        raise start
    header = Header(data, name, start, f"frame {number}")
    fields = header.fields(FRAME_FIELDS, HEADER_BYTES)
    _check_signature(header, fields["Version"])
    size = _size(header, fields)
    if layout.size is not None and size.frame_bytes != layout.size.frame_bytes:
        raise _other_size(header, size, layout.size)
    if fields["ReorderedSamples"] == 0:
        raise header.error(
            "ReorderedSamples", "expected 1, got 0: the samples are in the device's order, not beam after beam"
        )
    image = header.pixels(HEADER_BYTES, *size)
    meta = _meta(fields) | {"unfinished_bytes": layout.rest}
    return named(image, name, number, len(layout.starts), _geometry(header, fields, size), meta)


def _check_signature(header: Header, found: int) -> None:
    if found != SIGNATURE:
        raise header.error("signature", f"expected 0x{SIGNATURE:08x} (ARIS, DDF_05), got 0x{found:08x}")


def _other_size(header: Header, found: FrameSize, usual: FrameSize) -> SonarjaxError:
    expected = f"expected {usual.n_ranges} x {usual.n_beams} as in other frames"
    return header.error("SamplesPerBeam, PingMode", f"{expected}, got {found.n_ranges} x {found.n_beams}")


def _size(header: Header, fields: dict[str, Any]) -> FrameSize:
    mode = fields["PingMode"]
    if not beam_count(mode):
        raise header.error("PingMode", f"expected 1 to 12, got {mode}")
    return FrameSize(header.count(fields["SamplesPerBeam"], "SamplesPerBeam", MAX_SAMPLES), beam_count(mode))


def _geometry(header: Header, fields: dict[str, Any], size: FrameSize) -> Geometry | None:
    sound_speed = header.quantity(fields["SoundSpeed"], "SoundSpeed", 1000.0, 2000.0, "m/s")
    metres = 1e-6 * sound_speed / 2  # range for each microsecond of two-way travel
    start = fields["SampleStartDelay"] * metres
    period = header.count(fields["SamplePeriod"], "SamplePeriod", 10**6)
    stop = header.quantity(start + period * size.n_ranges * metres, "range window", 0.0, RANGE_LIMIT_M, "m")
    system, lens = fields["SystemType"], fields["LargeLens"] != 0
    azimuth = aris_azimuth_deg(system, size.n_beams, lens)
    if azimuth is None:
        return None  # the image can still be used with a sonar.toml
    geometry: Geometry = {
        "azimuth_deg": azimuth.tolist(),
        "range_min_m": start,
        "range_max_m": stop,
        "n_ranges": size.n_ranges,
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
