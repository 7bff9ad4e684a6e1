"""Logs of Blueprint's Oculus viewer (`.oculus`): raw ping packets, each behind a header of the log.

The layout is taken from the maker's published viewer source, which writes its C structs as they lie in memory (8-byte
alignment), and from published readers that agree with it. It was not checked on a file. A file header gives its own
size, then items follow. Each has a header with its size, the kind of the payload, whether it is compressed, and the
payload's size. Compression 1 is Qt's: the uncompressed size in four bytes, most significant first, then a zlib stream.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content
from sonarjax.io.frame import Frame
from sonarjax.io.header import Header
from sonarjax.io.oculus import FIRE_AT, SIMPLE_PING, read_ping
from sonarjax.io.recording import Record, each_record, frames_of

FILE_MAGIC, ITEM_MAGIC = 0x11223344, 0xAABBCCDD
ITEM_MARK = struct.pack("<I", ITEM_MAGIC)
"""The id with which an item begins, as it is stored."""
FILE_HEADER, ITEM_HEADER = "II16sHH4xqd", "IIHH4xdH2xII4x"
LEAST = struct.calcsize("<" + ITEM_HEADER)
"""Smallest size that an item's header can have [bytes]."""
SONAR_ITEM = 10
"""Kind of an item whose payload is a packet from the sonar."""
PACKET_LIMIT = 2**28
"""Largest packet that is unpacked, 256 MiB [bytes], so that a hostile stream cannot fill the memory."""


@dataclass(frozen=True)
class LogItem:
    """Where an item's payload lies in the log."""

    payload_at: int
    """Its first byte [bytes]."""
    payload_size: int
    """Its size as stored [bytes]."""
    original_size: int
    """Its size before compression [bytes]."""
    compressed: bool
    """Whether it is a zlib stream."""


def parse_oculus_log(data: Content, name: str, index: int | None = None) -> Iterator[Frame]:
    """Yield the pings of an Oculus viewer's log, or only ping `index`.

    The image is scaled as in `parse_oculus`.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the names of the frames.
        index: Number of a ping, from 0; None means all pings.

    Yields:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: The file is of another kind, encrypted or without a complete ping, a ping cannot be read, or the
            index is out of range.
    """
    return frames_of(oculus_log_records(data, name, index))


def oculus_log_records(data: Content, name: str, index: int | None = None) -> Iterator[Record]:
    """As `parse_oculus_log`, but a ping that cannot be read is yielded as its error; the others are not affected."""
    pings = _pings(data, name)

    def read(number: int) -> Frame:
        ping = pings[number]
        if isinstance(ping, SonarjaxError):
            raise ping
        packet = _packet(Header(data, name, ping.payload_at, f"ping {number}"), ping)
        return read_ping(Header(packet, name, 0, f"ping {number}"), name, number, len(pings))

    yield from each_record(name, len(pings), index, read)


def _pings(data: Content, name: str) -> list[LogItem | SonarjaxError]:
    """The complete items that hold a ping, and in place of a damaged item its error.

    One that is still being written at the end of the log is left out.
    """
    file = Header(data, name)
    magic, size, _, _, encryption, _, _ = file.unpack(FILE_HEADER, 0, "file header")
    if magic != FILE_MAGIC:
        raise file.error("file header", f"expected 0x{FILE_MAGIC:08x} (Oculus log), got 0x{magic:08x}")
    if encryption:
        raise file.error("encryption", f"expected 0 (none), got {encryption}")
    pings: list[LogItem | SonarjaxError] = []
    position = max(size, struct.calcsize("<" + FILE_HEADER))
    while position + LEAST <= len(data):
        item = Header(data, name, position, f"item at byte {position}")
        magic, size, kind, _, _, compression, original, stored = item.unpack(ITEM_HEADER, 0, "item header")
        found, end = LogItem(position + size, stored, original, compression == 1), position + size + stored
        intact = magic == ITEM_MAGIC and size >= LEAST
        if intact and end <= len(data) and not _lacks_bytes(data, position, end):
            if kind == SONAR_ITEM and _is_ping(data, found):
                pings.append(found)
        else:
            end = _next_item(data, position + 1)  # only the damaged item is lost, not what follows
            if end < len(data) or not intact:  # else it is unfinished
                got = f"0x{magic:08x}, {size} and {stored} bytes"
                expected = f"expected id 0x{ITEM_MAGIC:08x}, {LEAST} bytes or more and a payload up to the next item"
                pings.append(item.error("item header", f"{expected}, got {got}"))
        position = end
    if not any(isinstance(ping, LogItem) for ping in pings):
        raise file.error("items", f"expected a complete ping (kind {SONAR_ITEM}), found none")
    return pings


def _next_item(data: Content, start: int) -> int:
    """Position [bytes] of the next complete item at or after `start`; the end of the log if there is none."""
    position = start
    while (position := data.find(ITEM_MARK, position)) >= 0:
        head = data[position : position + LEAST]
        if len(head) == LEAST:
            _, size, *_, stored = struct.unpack("<" + ITEM_HEADER, head)
            if size >= LEAST and position + size + stored <= len(data):
                return position
        position += 1
    return len(data)


def _lacks_bytes(data: Content, position: int, end: int) -> bool:
    """Whether bytes of the item at `position` are missing: none begins at its `end`, but one begins before."""
    follows = ITEM_MARK.startswith(data[end : end + len(ITEM_MARK)])  # nothing at all at the end of the log
    return not follows and _next_item(data, position + 1) < end


def _is_ping(data: Content, item: LogItem) -> bool:
    """True if the packet is a ping result, not the sonar's status or another of its messages."""
    if item.compressed:
        return True  # the viewer compresses only pings, and unpacking here would take as long as reading
    if item.payload_size < FIRE_AT:
        return False
    return bool(struct.unpack("<HHHH", data[item.payload_at : item.payload_at + 8])[3] == SIMPLE_PING)


def _packet(header: Header, item: LogItem) -> Content:
    stored = header.data[item.payload_at : item.payload_at + item.payload_size]
    if not item.compressed:
        return stored
    if item.original_size > PACKET_LIMIT:
        raise header.error("originalSize", f"expected at most {PACKET_LIMIT} bytes, got {item.original_size}")
    unpacker = zlib.decompressobj()
    try:
        packet = unpacker.decompress(stored[4:], item.original_size + 1)
    except zlib.error as error:
        raise header.error("payload", f"expected a zlib stream: {error}") from error
    if len(packet) != item.original_size:
        raise header.error("originalSize", f"expected {item.original_size} bytes, got {len(packet)} or more")
    return packet
