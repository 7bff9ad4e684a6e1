"""Files written header by header, from the format notes, by code that shares nothing with the loaders."""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

SOUND_SPEED = 1450.0


def put(buffer: bytearray, offset: int, layout: str, *values) -> None:
    struct.pack_into("<" + layout, buffer, offset, *values)


def ramp(n_ranges: int, n_beams: int, frame: int = 0) -> np.ndarray:
    """Bytes that differ in both axes and from frame to frame."""
    return ((np.arange(n_ranges)[:, None] * 7 + np.arange(n_beams) * 3 + frame) % 256).astype(np.uint8)


def aris(n_frames=2, n_ranges=10, ping_mode=3, system=0, lens=0, period=5, delay=1000, speed=SOUND_SPEED) -> bytes:
    n_beams = {1: 48, 2: 48, 3: 96, 4: 96, 5: 96, 6: 64, 7: 64, 8: 64, 9: 128, 10: 128, 11: 128, 12: 128}[ping_mode]
    content = bytearray(1024)
    put(content, 0, "I", 0x05464444)
    put(content, 4, "I", 999)  # the header's own count of frames: wrong on purpose
    for number in range(n_frames):
        header = bytearray(1024)
        put(header, 0, "IQI", number, 10**15 + number, 0x05464444)
        put(header, 52, "ff", 0.7, 5.0)
        put(header, 244, "fff", 1.0, -12.5, 2.5)
        put(header, 436, "II", ping_mode, 1)
        put(header, 452, "I", period)
        put(header, 464, "fI", speed, n_ranges)
        put(header, 476, "III", delay, lens, system)
        put(header, 516, "I", 1)
        content += header + ramp(n_ranges, n_beams, number).tobytes()
    return bytes(content)


def didson(n_frames=2, version=3, n_beams=96, file_header=None, flags=1, reverse=0, start=3, length=1, high=1) -> bytes:
    sizes = {3: (512, 256), 4: (1024, 1024)}[version]
    content = bytearray(file_header or sizes[0])
    put(content, 0, "3sBii", b"DDF", version, n_frames, 8)
    put(content, 12, "ii", high, n_beams)
    put(content, 24, "i", 512)
    put(content, 40, "ii", reverse, 42)
    for number in range(n_frames):
        header = bytearray(sizes[1])
        put(header, 0, "iii3sB", number, 0, 0, b"DDF", version)
        put(header, 20, "7i", 2009, 6, 1, 12, 30, 15, 50)
        put(header, 52, "ii", start, length)
        put(header, 160, "fff", 1.0, -15.0, 0.5)
        put(header, 192, "i", flags)
        content += header + ramp(512, n_beams, number).tobytes()
    return bytes(content)


def oculus(n_pings=2, n_ranges=12, n_beams=16, bits=8, half_angle=3000, sound_speed=1490.0, resolution=0.0025) -> bytes:
    content = bytearray()
    bearings = np.round(np.linspace(-half_angle, half_angle, n_beams)).astype("<i2")
    image_at = 256
    for number in range(n_pings):
        image = ramp(n_ranges, n_beams, number).astype("<u1" if bits == 8 else "<u2")
        total = image_at + image.nbytes
        message = bytearray(image_at)
        put(message, 0, "HHHHHIH", 0x4F53, 7892, 0, 0x23, 0, total - 16, 0)
        put(message, 16, "BBBBBdddd", 2, 195, 25, 127, 25, 2.0, 50.0, sound_speed, 0.0)
        put(message, 53, "IIdddd", 100 + number, 0, 2.1e6, 2.6e-76, -1.4e194, sound_speed)
        put(message, 93, "IBdHHIII", 7, bits // 8 - 1, resolution, n_ranges, n_beams, image_at, image.nbytes, total)
        message[122 : 122 + bearings.nbytes] = bearings.tobytes()
        content += message + image.tobytes()
    return bytes(content)


def oculus_log(packets: list[bytes], compress: bool = False) -> bytes:
    """The viewer's log of these packets, between items of another kind."""
    content = struct.pack("<II16sHH4xqd", 0x11223344, 48, b"Oculus", 1, 0, 0, 1.5)
    for number, packet in enumerate(packets):
        stored = struct.pack(">I", len(packet)) + zlib.compress(packet) if compress else packet
        content += struct.pack("<IIHH4xdH2xII4x", 0xAABBCCDD, 40, 1, 0, 0.1 * number, 0, 3, 3) + b"abc"
        content += struct.pack(
            "<IIHH4xdH2xII4x", 0xAABBCCDD, 40, 10, 0, 0.1 * number, int(compress), len(packet), len(stored)
        )
        content += stored
    return content


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npy_header(text: str, numbers: bytes = b"") -> bytes:
    """An NPY with a header of one's own."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode("latin-1") + numbers


def npz(**members) -> bytes:
    """Arrays, or raw bytes of a member."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in members.items():
            archive.writestr(f"{key}.npy", value if isinstance(value, bytes) else npy(value))
    return stream.getvalue()


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(array: np.ndarray, width=None, height=None, extra: bytes = b"") -> bytes:
    """A grey or RGB(A) PNG; `width` and `height` may lie."""
    depth = 8 * array.dtype.itemsize
    colour = 0 if array.ndim == 2 else {3: 2, 4: 6}[array.shape[2]]
    size = struct.pack(">IIBBBBB", width or array.shape[1], height or array.shape[0], depth, colour, 0, 0, 0)
    rows = array.astype(array.dtype.newbyteorder(">"))
    packed = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + extra + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """The writers above."""
    writers = (aris, didson, oculus, oculus_log, npy, npy_header, npz, png, chunk, ramp)
    return SimpleNamespace(**{writer.__name__: writer for writer in writers})


@pytest.fixture
def saved(tmp_path):
    """`saved(name, content)` writes a file and gives its path as a string."""

    def save(name: str, content: bytes) -> str:
        path = tmp_path / name
        path.write_bytes(content)
        return str(path)

    return save


@pytest.fixture
def real():
    """`real("aris/sample.aris")`: a real file of the folder that SONARJAX_REAL_DATA names, or a skip."""

    def find(name: str) -> str:
        path = Path(os.environ.get("SONARJAX_REAL_DATA", "absent")) / name
        if not path.exists():
            pytest.skip(f"no real sonar file {name}: SONARJAX_REAL_DATA names the folder of them")
        return str(path)

    return find
