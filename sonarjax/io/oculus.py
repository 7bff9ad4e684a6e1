"""Raw pings of a Blueprint Oculus (`.raw`, its network packets one after another): bytes in, frames out.

The layout was checked on real files of one and of three pings: a 16-byte message header, the fire message, the ping
result, int16 bearings of 0.01 deg, then the image (range, beam) at `imageOffset`. Messages of another kind are skipped.
The viewer's `.oculus` log is read by `oculus_log.py`.

Oculus bearings grow to starboard (the maker's viewer draws them at x = sin(bearing), x to the right), so azimuth is
their negative and the columns are reversed. `bearing_sign=1` reads them as growing to port. Ranges start at 0. Not
checked on a file: 16-bit images (assumed little-endian), and packets of version 2, which are refused.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content
from sonarjax.io.frame import Frame, Geometry
from sonarjax.io.header import RANGE_LIMIT_M, Header
from sonarjax.io.naming import named
from sonarjax.io.recording import Record, each_record, frames_of

MAGIC, SIMPLE_PING = 0x4F53, 0x23
MARK = struct.pack("<H", MAGIC)
"""The id with which a message begins, as it is stored."""
MESSAGE, FIRE, RESULT = "HHHHHIH", "BBBBBdddd", "IIddddIBdHHIII"
FIRE_AT = struct.calcsize("<" + MESSAGE)
RESULT_AT = FIRE_AT + struct.calcsize("<" + FIRE)
BEARINGS_AT = RESULT_AT + struct.calcsize("<" + RESULT)


@dataclass(frozen=True)
class OculusPing:
    """The fields of a ping that are used."""

    frequency: float
    """Frequency [Hz], as stored."""
    sound_speed: float
    """Speed of sound [m/s], as stored."""
    resolution: float
    """Length of a range bin [m]."""
    n_ranges: int
    """Range bins of the image."""
    n_beams: int
    """Beams of the image."""
    image_at: int
    """Where the image starts in the message [bytes]."""
    dtype: str
    """NumPy's name for the type of a pixel."""
    ping_id: int
    """Number of the ping."""
    start_time: int
    """When the ping was sent, in the device's own count."""
    range_setting: float
    """Range setting of the device, as stored."""
    gain_percent: float
    """Gain setting of the device [%], as stored."""


def parse_oculus(data: Content, name: str, index: int | None = None, bearing_sign: int = -1) -> Iterator[Frame]:
    """Yield the pings of a raw Oculus file, or only ping `index`.

    The image is the stored value / 255, or / 65535 for 16 bits. An unfinished last ping is left out.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the names of the frames.
        index: Number of a ping, from 0; None means all pings.
        bearing_sign: -1 if the file's bearings grow to starboard, 1 if they grow to port.

    Yields:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: A message, its sizes, bearings or range step are wrong, there is no complete ping, or the index
            is out of range.
    """
    return frames_of(oculus_records(data, name, index, bearing_sign))


def oculus_records(data: Content, name: str, index: int | None = None, bearing_sign: int = -1) -> Iterator[Record]:
    """As `parse_oculus`, but a part that cannot be read is yielded as its error; the other pings are not affected."""
    starts = oculus_starts(data, name)

    def read(number: int) -> Frame:
        start = starts[number]
        if isinstance(start, SonarjaxError):
            raise start
        return read_ping(Header(data, name, start, f"ping {number}"), name, number, len(starts), bearing_sign)

    yield from each_record(name, len(starts), index, read)


def oculus_starts(data: Content, name: str) -> list[int | SonarjaxError]:
    """Positions [bytes] of the complete pings; a part of the file that is not a message is listed as its error.

    So is a message that another one begins inside of, if none begins where it should end: bytes of it are missing.

    Raises:
        SonarjaxError: The file begins with something else, or holds no ping.
    """
    starts: list[int | SonarjaxError] = []
    position = 0
    while position < len(data):
        header = Header(data, name, position, f"message at byte {position}")
        if starts and position + FIRE_AT > len(data):
            break  # the recording was cut off here
        magic, _, _, kind, _, payload, _ = header.unpack(MESSAGE, 0, "message header")
        if magic != MAGIC:
            error = header.error("id", f"expected 0x{MAGIC:04x} (Oculus), got 0x{magic:04x}")
            if not starts:
                raise error
            starts.append(error)
            position = _next_message(data, position + 1)
            continue
        end = position + FIRE_AT + payload
        if end > len(data):  # unfinished, or its size is wrong: then another ping follows
            there = len(data) - position - FIRE_AT
            error = header.error("payload", f"truncated: expected {payload} bytes, got {there}")
            end = _next_message(data, position + 1)
            if end < len(data):
                starts.append(error)
            elif not starts:
                raise error
        elif not _begins(data, end) and (following := _next_message(data, position + 1)) < end:
            there = following - position - FIRE_AT
            starts.append(header.error("payload", f"expected {payload} bytes to the next message, got {there}"))
            end = following
        elif kind == SIMPLE_PING:
            starts.append(position)
        position = end
    if not starts:
        raise Header(data, name).error("message", f"expected a ping result (0x{SIMPLE_PING:02x}), found none")
    return starts


def _next_message(data: Content, start: int) -> int:
    """Position [bytes] of the next complete message at or after `start`; the end of the file if there is none.

    The two bytes of the id may be pixels. A message of another kind than a ping counts only if one more follows.
    """
    position = start
    while (position := data.find(MARK, position)) >= 0:
        if position + FIRE_AT <= len(data):
            kind, _, payload = struct.unpack("<HHI", data[position + 6 : position + 14])
            end = position + FIRE_AT + payload
            if end <= len(data) and (kind == SIMPLE_PING or _begins(data, end)):
                return position
        position += 1
    return len(data)


def _begins(data: Content, position: int) -> bool:
    """Whether a message may begin at byte `position`: its id is there, or too little of the file is left to tell."""
    return MARK.startswith(data[position : position + len(MARK)])


def read_ping(header: Header, name: str, number: int, count: int, bearing_sign: int = -1) -> Frame:
    """Read the ping that starts with `header`, number `number` of the `count` pings of file `name`.

    Raises:
        SonarjaxError: As `parse_oculus`.
    """
    ping = _ping(header)
    azimuth, image = _columns(header, ping, bearing_sign)
    return named(image, name, number, count, _geometry(ping, azimuth), _meta(ping))


def _ping(header: Header) -> OculusPing:
    version, payload = header.unpack(MESSAGE, 0, "message header")[4:6]
    if version != 0:
        raise header.error("version", f"expected 0, got {version}")
    fire = header.unpack(FIRE, FIRE_AT, "fire message")
    result = header.unpack(RESULT, RESULT_AT, "ping result")
    data_size, n_ranges, n_beams, image_at, image_size = result[7], *result[9:13]
    if data_size not in (0, 1):
        raise header.error("dataSize", f"expected 0 (8 bits) or 1 (16 bits), got {data_size}")
    header.count(n_ranges, "nRanges", 65535)
    header.count(n_beams, "nBeams", 4096)
    wanted = n_ranges * n_beams * (1 + data_size)
    if image_size != wanted:
        raise header.error("imageSize", f"expected {n_ranges} x {n_beams} samples, {wanted} bytes, got {image_size}")
    if image_at < BEARINGS_AT + 2 * n_beams or image_at + image_size > FIRE_AT + payload:
        raise header.error("imageOffset", f"expected an image inside the message, got offset {image_at}")
    resolution = header.quantity(result[8], "rangeResolution", 1e-5, RANGE_LIMIT_M / n_ranges, "m")
    return OculusPing(
        frequency=result[2],
        sound_speed=result[5],
        resolution=resolution,
        n_ranges=n_ranges,
        n_beams=n_beams,
        image_at=image_at,
        dtype=("<u1", "<u2")[data_size],
        ping_id=result[0],
        start_time=result[6],
        range_setting=fire[5],
        gain_percent=fire[6],
    )


def _columns(
    header: Header, ping: OculusPing, bearing_sign: int
) -> tuple[Float64[np.ndarray, "beam"], Float32[np.ndarray, "range beam"]]:
    bearings = header.unpack(f"{ping.n_beams}h", BEARINGS_AT, "bearings")
    azimuth = bearing_sign * 0.01 * np.asarray(bearings, np.float64)
    image = header.pixels(ping.image_at, ping.n_ranges, ping.n_beams, ping.dtype)
    if ping.n_beams > 1 and azimuth[0] > azimuth[-1]:
        azimuth, image = azimuth[::-1], np.ascontiguousarray(image[:, ::-1])
    if np.any(np.diff(azimuth) <= 0) or np.abs(azimuth).max() > 180.0:
        raise header.error("bearings", "expected angles within 180 deg in ascending or descending order")
    return azimuth, image


def _geometry(ping: OculusPing, azimuth: Float64[np.ndarray, "beam"]) -> Geometry:
    geometry: Geometry = {
        "azimuth_deg": np.round(azimuth, 2).tolist(),
        "range_min_m": 0.0,
        "range_max_m": ping.n_ranges * ping.resolution,
        "n_ranges": ping.n_ranges,
    }
    if math.isfinite(ping.sound_speed) and 1000.0 <= ping.sound_speed <= 2000.0:
        geometry["sound_speed_m_s"] = ping.sound_speed
    if math.isfinite(ping.frequency) and 1e4 <= ping.frequency <= 1e8:
        geometry["frequency_hz"] = ping.frequency
    return geometry


def _meta(ping: OculusPing) -> dict[str, Any]:
    # Temperature and pressure are left out, because they are garbage in real files.
    return {
        "format": "Oculus raw ping",
        "stored_scale": f"u{8 * np.dtype(ping.dtype).itemsize}, about the square root of amplitude",
        "device": "Oculus",
        "ping_id": ping.ping_id,
        "ping_start_time": ping.start_time,
        "range_setting": ping.range_setting,
        "gain_percent": ping.gain_percent,
    }
