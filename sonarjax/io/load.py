"""One entrance for every frame: `read_frames("file.aris:3")`, by the file's ending."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from sonarjax.io.aris import aris_records
from sonarjax.io.didson import didson_records
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content, map_bytes, read_bytes
from sonarjax.io.frame import Frame
from sonarjax.io.images import parse_npy_frame, parse_npz_frame, parse_png_frame
from sonarjax.io.oculus import oculus_records
from sonarjax.io.oculus_log import oculus_log_records
from sonarjax.io.recording import Record, frames_of
from sonarjax.io.ros import BAGS, bag_records, is_bag

Opener = Callable[[str, int | None], Iterator[Record]]


def _picture(parse: Callable[[bytes, str, int | None], Iterator[Frame]]) -> Opener:
    """A file of one frame: read whole, up to `PICTURE_LIMIT`."""
    return lambda path, index: parse(read_bytes(path, limit=PICTURE_LIMIT), path, index)


def _mapped(records: Callable[[Content, str, int | None], Iterator[Record]]) -> Opener:
    """A recording: mapped, since it may be larger than the memory."""
    return lambda path, index: records(map_bytes(path), path, index)


PICTURES: dict[str, Opener] = {
    ".npz": _picture(parse_npz_frame),
    ".npy": _picture(parse_npy_frame),
    ".png": _picture(parse_png_frame),
}
"""File ending of one frame -> `open(path, index)`, its records."""
RECORDINGS: dict[str, Opener] = {
    ".aris": _mapped(aris_records),
    ".ddf": _mapped(didson_records),
    ".raw": _mapped(oculus_records),
    ".oculus": _mapped(oculus_log_records),
}
"""File ending of recordings that may hold several frames -> `open(path, index)`, their records."""
ENDINGS = (*PICTURES, *RECORDINGS, *BAGS)
"""Endings of all files that frames are read from."""
PICTURE_LIMIT = 4 * 2**30
"""Largest .npz, .npy or .png that is read, 4 GiB [bytes]: room for eight arrays of `PIXEL_LIMIT` doubles."""


class Spec(NamedTuple):
    """Which frames are meant: `path`, `path:N`, of a bag also `path:TOPIC` or `path:TOPIC:N`."""

    path: str
    """The file, or a bag's folder."""
    number: int | None
    """Number of the frame from 0; None for all."""
    topic: str | None = None
    """Topic of a bag; None where it was not named."""


def split_spec(spec: str | os.PathLike[str]) -> Spec:
    """The parts of a frame's name; a file that really has such a name wins.

    >>> split_spec("log.aris:3")
    Spec(path='log.aris', number=3, topic=None)
    """
    name = os.fspath(spec)
    if os.path.exists(name):
        return Spec(name, None)
    numbered = re.fullmatch(r"(.+):([0-9]{1,18})", name, re.DOTALL)
    path, number = (name, None) if numbered is None else (numbered[1], int(numbered[2]))
    within = re.fullmatch(r"(.+):(/[^:]*)", path, re.DOTALL)
    if within is not None and is_bag(within[1]):
        return Spec(within[1], number, within[2])
    return Spec(path, number)


def naming(name: str, error: Exception) -> str:
    """The error's message, opened by the frame's `name` where it does not name the file itself.

    An exception that is not ours is named too: its message alone seldom says what happened.
    """
    message = " ".join(str(error).split())
    if not isinstance(error, SonarjaxError):
        return f"{name}: {type(error).__name__}: {message}".removesuffix(": ")
    return message if message.startswith(split_spec(name).path) else f"{name}: {message}"


def iter_records(spec: str | os.PathLike[str]) -> Iterator[Record]:
    """Yield the frames (range, beam) that `spec` means, one by one, and in place of a damaged one its error.

    Raises SonarjaxError as `read_frames` does for what concerns the whole file.
    """
    path, number, topic = split_spec(spec)
    if is_bag(path):
        return bag_records(path, topic, number)
    ending = os.path.splitext(path)[1].lower()
    opener = PICTURES.get(ending) or RECORDINGS.get(ending)
    if opener is not None:
        return opener(path, number)
    map_bytes(path)  # says what is wrong with a folder or a missing file, whatever its ending
    raise SonarjaxError(f"{path}: unknown ending {ending!r}: expected one of {', '.join(ENDINGS)}")


def iter_frames(spec: str | os.PathLike[str]) -> Iterator[Frame]:
    """Yield the frames (range, beam) of `path` one by one, or the one of `path:N` (N from 0).

    Errors as in `read_frames`, raised when the frame concerned is reached.
    """
    yield from frames_of(iter_records(spec))


def read_frames(spec: str | os.PathLike[str]) -> list[Frame]:
    """All frames (range, beam) of `path`, or the one of `path:N` (N from 0); of a bag `path:TOPIC` or `path:TOPIC:N`.

    Endings: .npz .npy .png .aris .ddf .raw .oculus .bag .mcap .db3; a ROS 2 bag is also given as its folder.

    Raises SonarjaxError, one line that names the file, the field and what was expected, when the file is missing,
    empty, truncated, a folder or of an unknown ending, when the frame does not exist, and when the image is not
    (range, beam), empty, not a number, NaN, infinite or outside [0, 1], or its mask does not fit. An unfinished last
    frame of a recording is left out. Frames of a sonar file are float32, four times the size of the file's bytes:
    `iter_frames` holds one at a time.
    """
    return list(iter_frames(spec))
