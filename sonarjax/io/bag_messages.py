"""The messages of a bag in order of time. Reading goes on behind damage, which costs as few of them as possible."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple


class Message(NamedTuple):
    """A message as it is stored."""

    number: int
    """Its number among those that were asked for."""
    connection: Any
    """The connection of `rosbags`, with topic and type."""
    raw: bytes
    """What is to be unpacked."""


class Lost(NamedTuple):
    """Messages that cannot be read."""

    first: int
    """Number of the first of them."""
    last: int | None
    """Number of the last; None if nothing can be read from the first on."""
    error: Exception
    """What `rosbags` raised."""


class _Place(NamedTuple):
    """Where reading goes on: the message `number` is behind `skip` others of the same time [ns]."""

    number: int
    time: int | None = None
    skip: int = 0


def bag_messages(reader: Any, connections: Sequence[Any]) -> Iterator[Message | Lost]:
    """Yield the messages of `connections` in order of time, and instead of damaged ones, that they are lost.

    In a ROS 1 bag a damaged record costs that record, in an MCAP file all of its chunk. In an MCAP file whose chunks
    overlap in time, and in other bags, it costs all messages after it.
    """
    place = _Place(0)
    while True:
        number, skip = place.number, place.skip
        try:
            for connection, _, raw in reader.messages(connections=connections, start=place.time):
                if skip:
                    skip -= 1
                    continue
                yield Message(number, connection, raw)
                number += 1
            return
        except Exception as error:  # on a damaged file rosbags raises whatever its parts raise
            behind = _behind(reader, connections, number)
            yield Lost(number, None if behind is None else behind.number - 1, error)
        if behind is None or behind.time is None:
            return
        place = behind


def _behind(reader: Any, connections: Sequence[Any], number: int) -> _Place | None:
    """Where reading goes on if message `number` is damaged; None if the bag's index does not tell."""
    if len(reader.readers) != 1:
        return None
    bag = reader.readers[0]
    if hasattr(bag, "indexes"):
        return _behind_record(sorted(entry.time for one in connections for entry in bag.indexes[one.id]), number)
    storage = getattr(bag, "storage", None)
    files = getattr(storage, "storages", [storage])  # of a bag's folder, or the one file
    if not all(hasattr(file, "chunks") for file in files):
        return None
    topics = {(one.topic, one.msgtype) for one in connections}
    chunks = []
    for file in files:
        ours = [one.id for one in file.connections if (one.topic, one.msgtype) in topics]
        counted = [(chunk, sum(chunk.channel_count.get(one, 0) for one in ours)) for chunk in file.chunks]
        chunks += [(chunk.message_start_time, chunk.message_end_time, count) for chunk, count in counted if count]
    return _behind_chunk(chunks, number)


def _behind_record(times: Sequence[int], number: int) -> _Place:
    """The place of the next message, from the times of all in order."""
    following = number + 1
    if following >= len(times):
        return _Place(following)
    return _Place(following, times[following], sum(time == times[following] for time in times[:following]))


def _behind_chunk(chunks: Sequence[tuple[int, int, int]], number: int) -> _Place | None:
    """The place of the next chunk's first message, from each chunk's first and last time and number of messages."""
    chunks = sorted(chunks)
    ends = list(accumulate(count for *_, count in chunks))
    damaged = next((k for k, end in enumerate(ends) if number < end), None)
    if damaged is None or any(later[0] <= one[1] for one, later in pairwise(chunks)):
        return None
    return _Place(ends[damaged], chunks[damaged + 1][0]) if damaged + 1 < len(chunks) else _Place(ends[damaged])
