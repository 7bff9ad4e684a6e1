"""What a folder holds, and a recording."""

from __future__ import annotations

import struct
from pathlib import Path


def content(folder: Path) -> dict[str, bytes]:
    """The bytes of every file of a folder, by its path in it."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def recording(n_frames: int, n_ranges: int = 64) -> bytes:
    """A DDF_05 (ARIS) file with 48 beams."""
    content = bytearray(1024)
    struct.pack_into("<I", content, 0, 0x05464444)
    for number in range(n_frames):
        header = bytearray(1024)
        for offset, layout, *values in (
            (0, "IQI", number, 10**15, 0x05464444),
            (436, "II", 1, 1),
            (452, "I", 5),
            (464, "fI", 1450.0, n_ranges),
            (476, "III", 1000, 0, 0),
            (516, "I", 1),
        ):
            struct.pack_into("<" + layout, header, offset, *values)
        content += header + bytes(n_ranges * 48)
    return bytes(content)
