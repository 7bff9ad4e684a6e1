"""DIDSON recordings (`.ddf`, DDF_03 and DDF_04): bytes in, frames out.

**Not checked on a real file.** Everything comes from published readers. Doubtful numbers are fields of `DidsonTables`,
an argument of the reader:
- the file header of version 4 (1024 bytes; one source says 512): found by the frame's own signature if it has one.
  Then every frame must have one, because without it nothing tells that bytes are missing before a frame;
- the window starts and lengths, above all the shortest extended window (1.25 m; one source says 0.83 m), and the tables
  and frequencies of the long-range model;
- the lens polynomial and its direction: it is read as beam number over azimuth growing to port.

Doubtful choices in the code:
- stored beam 0 is assumed to be the rightmost, as in ARIS files, unless the file's `reverse` flag is set;
- the sign of the tilt (assumed positive up, so `tilt_deg` is its negative) and that of the roll;
- the time zone, which the file does not say: `time_ns` takes the date and time for UTC.

Known and ignored: sonars with serial numbers under 19 use the classic windows whatever the flag says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from jaxtyping import Float64

from sonarjax.io.files import Content
from sonarjax.io.frame import Frame, Geometry
from sonarjax.io.header import Fields, Header, angles, time_stamp
from sonarjax.io.naming import named
from sonarjax.io.recording import Record, each_record, frames_of

Lengths = tuple[float, ...]

SIGNATURE = b"DDF"
"""With it a file begins; the version follows. Frame headers may hold it too."""
FILE_FIELDS: Fields = {
    "resolution": (12, "i"),
    "numbeams": (16, "i"),
    "samples": (24, "i"),
    "reverse": (40, "i"),
    "serial": (44, "i"),
}
"""Fields that are read of the file header."""
FRAME_FIELDS: Fields = {
    "window start": (52, "i"),
    "window length": (56, "i"),
    "pan": (160, "f"),
    "tilt": (164, "f"),
    "roll": (168, "f"),
    "configflags": (192, "I"),
}
"""Fields that are read of a frame header: codes, and angles in degrees."""


@dataclass(frozen=True)
class DidsonTables:
    """What published readers say about the format; replace a field to try another interpretation."""

    file_header_bytes: dict[int, tuple[int, ...]] = field(default_factory=lambda: {3: (512,), 4: (1024, 512)})
    """Version -> possible sizes of the file header, the most likely first [bytes]."""
    frame_header_bytes: dict[int, int] = field(default_factory=lambda: {3: 256, 4: 1024})
    """Version -> size of a frame header [bytes]."""
    start_step_m: tuple[float, float] = (0.419, 0.375)
    """Range for each unit of the window-start code, extended and classic; doubled at low frequency [m]."""
    lengths_m: tuple[Lengths, Lengths, Lengths, Lengths] = (
        (1.25, 2.5, 5.0, 10.0, 20.0, 40.0),
        (1.125, 2.25, 4.5, 9.0, 18.0, 36.0),
        (2.5, 5.0, 10.0, 20.0, 40.0, 70.0),
        (2.25, 4.5, 9.0, 18.0, 36.0, 72.0),
    )
    """Window lengths [m] by configflags: extended, classic, long range extended, long range classic."""
    lens: tuple[float, float, float, float] = (0.0030, -0.0055, 2.6829, 48.04)
    """Coefficients c3 … c0 of a cubic in azimuth [deg]; times `lens_scale`, plus 1, it is the beam number, 1 … 96."""
    lens_scale: float = 1.012
    """Factor on the lens cubic."""
    frequencies_hz: tuple[tuple[float, float], tuple[float, float]] = ((1.1e6, 1.8e6), (0.7e6, 1.2e6))
    """(low, high) frequency of the standard model and of the long-range model [Hz]."""


DIDSON_TABLES = DidsonTables()


@dataclass(frozen=True)
class DidsonFile:
    """What the file header says."""

    version: int
    """3 for DDF_03, 4 for DDF_04."""
    high_frequency: bool
    """True for the higher of the model's two frequencies."""
    n_beams: int
    """Beams of a frame, 48 or 96."""
    n_ranges: int
    """Range bins of a frame."""
    reverse: bool
    """True if stored beam 0 is taken as the port-most beam."""
    serial: int
    """Serial number of the sonar."""
    header_bytes: int
    """Size of the file header [bytes]."""
    frame_header_bytes: int
    """Size of a frame header [bytes]."""
    signed: bool
    """True if frame 0 has a signature of its own, so that every frame must have one."""

    @property
    def frame_bytes(self) -> int:
        """Size of one frame with its header [bytes]."""
        return self.frame_header_bytes + self.n_ranges * self.n_beams


def didson_azimuth_deg(n_beams: int, tables: DidsonTables = DIDSON_TABLES) -> Float64[np.ndarray, "beam"]:
    """Return the azimuths of a DIDSON's beam centres.

    They come from the cubic of the lens, which is inverted by a fine table. Each of 48 beams is a pair of the 96.

    Args:
        n_beams: Number of beams, 48 or 96.
        tables: How to interpret the format.

    Returns:
        Beam centres (beam,) in ascending order [deg].
    """
    azimuth = np.linspace(-20.0, 20.0, 4001)
    beam = tables.lens_scale * np.polyval(tables.lens, azimuth) + 1
    wanted = np.arange(1.0, 97.0) if n_beams == 96 else np.arange(1.5, 97.0, 2.0)
    return np.interp(wanted, beam, azimuth)


def parse_didson(
    data: Content, name: str, index: int | None = None, tables: DidsonTables = DIDSON_TABLES
) -> Iterator[Frame]:
    """Yield the frames of a DIDSON file, or only frame `index`.

    The image is the stored byte / 255.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the names of the frames.
        index: Number of a frame, from 0; None means all frames.
        tables: How to interpret the format.

    Yields:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: The signature, sizes or window codes are wrong, a frame is not where it should be, no frame is
            complete, or the index is out of range.
    """
    return frames_of(didson_records(data, name, index, tables))


def didson_records(
    data: Content, name: str, index: int | None = None, tables: DidsonTables = DIDSON_TABLES
) -> Iterator[Record]:
    """As `parse_didson`, but a frame that cannot be read is yielded as its error; the others are not affected."""
    file = didson_file(data, name, tables)
    n_frames = didson_frame_count(data, file)
    if n_frames == 0:
        wanted = file.header_bytes + file.frame_bytes
        raise Header(data, name).error("samples", f"truncated: expected {wanted} bytes or more, got {len(data)}")
    yield from each_record(name, n_frames, index, lambda number: _read(data, name, file, n_frames, number, tables))


def didson_frame_count(data: Content, file: DidsonFile) -> int:
    """Number of complete frames in the file, from its size alone."""
    return max(0, len(data) - file.header_bytes) // file.frame_bytes


def didson_file(data: Content, name: str, tables: DidsonTables = DIDSON_TABLES) -> DidsonFile:
    """Read the file header. Raises a SonarjaxError that names the wrong field."""
    header = Header(data, name)
    signature = header.unpack("3sB", 0, "signature")
    if signature[0] != SIGNATURE or signature[1] not in (3, 4):
        raise header.error("signature", f"expected DDF_03 or DDF_04, got {bytes(data[:4])!r}")
    fields = header.fields(FILE_FIELDS, 48)
    version, n_beams = int(signature[1]), fields["numbeams"]
    if n_beams not in (48, 96):
        raise header.error("numbeams", f"expected 48 or 96, got {n_beams}")
    n_ranges = header.count(fields["samples"] or 512, "samples", 65536)
    frame_header = tables.frame_header_bytes[version]
    candidates = tables.file_header_bytes[version]
    header_bytes = _file_header_bytes(data, candidates, frame_header + n_ranges * n_beams)
    return DidsonFile(
        version=version,
        high_frequency=fields["resolution"] != 0,
        n_beams=n_beams,
        n_ranges=n_ranges,
        reverse=fields["reverse"] != 0,
        serial=fields["serial"],
        header_bytes=header_bytes,
        frame_header_bytes=frame_header,
        signed=_signature(data, header_bytes) == SIGNATURE,
    )


def _file_header_bytes(data: Content, candidates: tuple[int, ...], frame_bytes: int) -> int:
    signed = [size for size in candidates if _signature(data, size) == SIGNATURE]
    exact = [size for size in candidates if len(data) > size and (len(data) - size) % frame_bytes == 0]
    return (signed + exact + list(candidates))[0]


def _signature(data: Content, base: int) -> bytes:
    """What stands in place of the signature in the frame header at byte `base`."""
    return data[base + 12 : base + 12 + len(SIGNATURE)]


def _read(data: Content, name: str, file: DidsonFile, n_frames: int, number: int, tables: DidsonTables) -> Frame:
    header = Header(data, name, file.header_bytes + number * file.frame_bytes, f"frame {number}")
    found = _signature(data, header.base)
    if file.signed and found != SIGNATURE:
        raise header.error("signature", f"expected {SIGNATURE!r} as in frame 0, got {found!r}")
    image = header.pixels(file.frame_header_bytes, file.n_ranges, file.n_beams)
    if file.reverse:
        image = np.ascontiguousarray(image[:, ::-1])
    fields = header.fields(FRAME_FIELDS, file.frame_header_bytes)
    geometry = _geometry(header, fields, file, tables)
    return named(image, name, number, n_frames, geometry, _meta(header, fields, file))


def _window(header: Header, fields: dict[str, Any], file: DidsonFile, tables: DidsonTables) -> tuple[float, float]:
    flags, low = fields["configflags"], not file.high_frequency
    start_code = fields["window start"]
    if not 0 <= start_code <= 1000:
        raise header.error("window start", f"expected a code of 0 to 1000, got {start_code}")
    lengths, code = tables.lengths_m[flags & 3], fields["window length"]
    largest = len(lengths) - 1 - 2 * low
    if not 0 <= code <= largest:
        raise header.error("window length", f"expected a code of 0 to {largest}, got {code}")
    return start_code * tables.start_step_m[flags & 1] * (1 + low), lengths[code + 2 * low]


def _geometry(header: Header, fields: dict[str, Any], file: DidsonFile, tables: DidsonTables) -> Geometry:
    start, length = _window(header, fields, file, tables)
    long_range = bool(fields["configflags"] & 2)
    return {
        "azimuth_deg": didson_azimuth_deg(file.n_beams, tables).tolist(),
        "range_min_m": start,
        "range_max_m": start + length,
        "n_ranges": file.n_ranges,
        "frequency_hz": tables.frequencies_hz[long_range][file.high_frequency],
        "elevation_aperture_deg": 14.0,
    } | angles(-fields["tilt"], fields["roll"])


def _meta(header: Header, fields: dict[str, Any], file: DidsonFile) -> dict[str, Any]:
    *date, hundredth = header.unpack("7i", 20, "date and time")
    year, month, day, hour, minute, second = date
    return {
        "format": f"DIDSON (DDF_0{file.version}, read without a real file to check against)",
        "stored_scale": "u8",
        "device": "DIDSON",
        "serial": file.serial,
        "reverse": file.reverse,
        "time": f"{year:04d}-{month:02d}-{day:02d} {hour:02d}:{minute:02d}:{second:02d}.{hundredth:02d}",
        **_time_stamp(date, 10_000 * hundredth),
        "configflags": fields["configflags"],
        "pan_deg": fields["pan"],
    }


def _time_stamp(date: list[int], microsecond: int) -> dict[str, int]:
    """`time_ns` of a date of year, month, day, hour, minute and second; empty if there is no such time."""
    year, month, day, hour, minute, second = date
    try:
        time = datetime(year, month, day, hour, minute, second, microsecond, UTC)
        passed = time - datetime(1970, 1, 1, tzinfo=UTC)
    except (ValueError, OverflowError):
        return {}
    return time_stamp(1000 * (passed // timedelta(microseconds=1)))
