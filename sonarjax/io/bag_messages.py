"""The messages of a bag in order of time. Reading goes on past damage, which costs as few of them as possible."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from heapq import merge
from itertools import accumulate
from typing import Any, NamedTuple

MOST_LOST = 100_000
"""No chunk holds more sonar images; if an index says so, it is damaged too."""


class Message(NamedTuple):
    """A message as it is stored."""

    number: int
    """Its number among those that were asked for."""
    connection: Any
    """The connection of `rosbags`, with topic and type."""
    raw: bytes
    """What is to be unpacked."""


class Lost(NamedTuple):
    """A message that cannot be read."""

    number: int
    """Its number among those that were asked for."""
    error: Exception
    """What `rosbags` raised."""
    last: bool
    """True if nothing after it can be read either, although there may be more."""


class _Place(NamedTuple):
    """Where reading goes on: at message `number`, after `skip` others of the same time [ns]."""

    number: int
    time: int | None = None
    skip: int = 0


def bag_messages(reader: Any, connections: Sequence[Any]) -> Iterator[Message | Lost]:
    """Yield the messages of `connections` in order of time, and a `Lost` in the place of each one that is damaged.

    In a ROS 1 bag a damaged record costs that record, or in a compressed chunk all of the chunk. In an MCAP file it
    costs all of its chunk. It costs everything after it if MCAP chunks overlap in time, and in other bags.
    """
    place, delivered = _Place(0), 0
    while True:
        number, skip = place.number, place.skip
        try:
            for connection, _, raw in reader.messages(connections=connections, start=place.time):
                if skip:
                    skip -= 1
                    continue
                yield Message(number, connection, raw)
                number, delivered = number + 1, delivered + 1
            return
        except Exception as error:  # on a damaged file rosbags raises whatever its parts raise
            after = _after(reader, connections, number, delivered)
            for lost in range(number, number + 1 if after is None else after.number):
                yield Lost(lost, error, after is None)
        if after is None or after.time is None:
            return
        place = after


def _after(reader: Any, connections: Sequence[Any], number: int, delivered: int) -> _Place | None:
    """Where reading goes on if message `number` is damaged; None if the bag's index does not tell."""
    if len(reader.readers) != 1:
        return None
    bag = reader.readers[0]
    if hasattr(bag, "indexes"):
        return _after_record(bag, [bag.indexes[one.id] for one in connections], number, delivered)
    storage = getattr(bag, "storage", None)
    files = getattr(storage, "storages", [storage])  # of a bag's folder, or the one file
    if not all(hasattr(file, "chunks") for file in files):
        return None
    topics = {(one.topic, one.msgtype) for one in connections}
    chunks = []
    for file in files:  # one is read after the other, each in order of time
        ours = [one.id for one in file.connections if (one.topic, one.msgtype) in topics]
        counted = [(chunk, sum(chunk.channel_count.get(one, 0) for one in ours)) for chunk in file.chunks]
        chunks += sorted((chunk.message_start_time, chunk.message_end_time, count) for chunk, count in counted if count)
    return _after_chunk(chunks, number)


def _after_record(bag: Any, indexes: Sequence[list[Any]], number: int, delivered: int) -> _Place | None:
    """The place of the next message of a ROS 1 bag; the damaged one is taken out of the bag's index.

    `rosbags` reads what the index lists; of what it has read before, `delivered` messages were whole.
    """
    entries = list(merge(*indexes))
    if delivered >= len(entries):
        return None
    damaged = entries.pop(delivered)
    for index in indexes:
        index[:] = [entry for entry in index if entry is not damaged]
    bag.current_chunk = (-1, io.BytesIO())  # else a chunk that could not be unpacked passes for the current one
    if delivered == len(entries):
        return _Place(number + 1)
    time = entries[delivered].time
    return _Place(number + 1, time, sum(entry.time == time for entry in entries[:delivered]))


def _after_chunk(chunks: Sequence[tuple[int, int, int]], number: int) -> _Place | None:
    """The place of the next chunk's first message, from each chunk's first and last time and number of messages.

    None if a time does not separate the chunks, in the order in which they are read.
    """
    ends = list(accumulate(count for *_, count in chunks))
    damaged = next((k for k, end in enumerate(ends) if number < end), None)
    if damaged is None or any(end > chunks[damaged][0] for _, end, _ in chunks[:damaged]):
        return None
    if ends[damaged] - number > MOST_LOST:
        return None
    after = chunks[damaged + 1 :]
    if not after:
        return _Place(ends[damaged])
    time = after[0][0]
    if any(end >= time for _, end, _ in chunks[: damaged + 1]) or any(begin < time for begin, *_ in after):
        return None
    return _Place(ends[damaged], time)
