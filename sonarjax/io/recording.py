"""Records of a recording, one by one: a frame, or the error of a damaged record, which affects no other record."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.frame import Frame
from sonarjax.io.naming import frame_numbers

Record = Frame | SonarjaxError
"""A frame, or the reason why the record cannot be read as one."""


def each_record(name: str, count: int, index: int | None, read: Callable[[int], Frame]) -> Iterator[Record]:
    """Read the `count` frames of a recording one after another, or only frame `index`.

    Raises:
        SonarjaxError: The recording has no such frame.
    """
    for number in frame_numbers(name, count, index):
        try:
            yield read(number)
        except SonarjaxError as error:
            yield error


def frames_of(records: Iterator[Record]) -> Iterator[Frame]:
    """The frames of `records`. The first record that cannot be read raises its SonarjaxError."""
    for record in records:
        if isinstance(record, SonarjaxError):
            raise record
        yield record
