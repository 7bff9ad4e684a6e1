"""One way to read any frame: `read_frames("file.aris:3")` chooses the reader by the file's ending."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from sonarjax.io.aris import aris_records
from sonarjax.io.didson import didson_records
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import Content, open_content, read_bytes
from sonarjax.io.frame import Frame
from sonarjax.io.given import shown
from sonarjax.io.images import parse_npy_frame, parse_npz_frame, parse_png_frame
from sonarjax.io.oculus import oculus_records
from sonarjax.io.oculus_log import oculus_log_records
from sonarjax.io.recording import Record, frames_of
from sonarjax.io.ros import BAGS, bag_records, is_bag

Opener = Callable[[str, int | None], Iterator[Record]]


def _picture(parse: Callable[[bytes, str, int | None], Iterator[Frame]]) -> Opener:
    """A file of one frame, read completely, up to `PICTURE_LIMIT`."""
    return lambda path, index: parse(read_bytes(path, limit=PICTURE_LIMIT), path, index)


def _recording(records: Callable[[Content, str, int | None], Iterator[Record]]) -> Opener:
    """A recording, read frame by frame because it may be larger than the memory."""

    def opener(path: str, index: int | None) -> Iterator[Record]:
        with open_content(path) as content:
            yield from records(content, path, index)

    return opener


PICTURES: dict[str, Opener] = {
    ".npz": _picture(parse_npz_frame),
    ".npy": _picture(parse_npy_frame),
    ".png": _picture(parse_png_frame),
}
"""File ending of a single frame -> `open(path, index)`, which gives its records."""
RECORDINGS: dict[str, Opener] = {
    ".aris": _recording(aris_records),
    ".ddf": _recording(didson_records),
    ".raw": _recording(oculus_records),
    ".oculus": _recording(oculus_log_records),
}
"""File ending of a recording that may hold several frames -> `open(path, index)`, which gives its records."""
ENDINGS = (*PICTURES, *RECORDINGS, *BAGS)
"""Endings of all files from which frames are read."""
PICTURE_LIMIT = 4 * 2**30
"""Largest .npz, .npy or .png that is read, 4 GiB [bytes]: room for eight arrays of `PIXEL_LIMIT` doubles."""


class Spec(NamedTuple):
    """Which frames are meant: `path`, `path:N`, or for a bag also `path:TOPIC` or `path:TOPIC:N`."""

    path: str
    """The file, or the folder of a bag."""
    number: int | None
    """Number of the frame, from 0; None for all."""
    topic: str | None = None
    """Topic of a bag; None if it was not named."""


def split_spec(spec: str | os.PathLike[str]) -> Spec:
    """Split the name of a frame into its parts.

    If a file has exactly this name, the name means that file.

    >>> split_spec("log.aris:3")
    Spec(path='log.aris', number=3, topic=None)

    Args:
        spec: `path`, `path:N`, or for a bag also `path:TOPIC` or `path:TOPIC:N`.

    Returns:
        Path, number of the frame and topic; a part that `spec` does not give is None.

    Raises:
        SonarjaxError: `spec` is no path.
    """
    name = os.fspath(spec) if isinstance(spec, str | os.PathLike) else None
    if not isinstance(name, str):
        raise SonarjaxError(f"frame: expected the name of a file, got {shown(spec)}")
    if os.path.exists(name):
        return Spec(name, None)
    numbered = re.fullmatch(r"(.+):(-?[0-9]{1,18})", name, re.DOTALL)  # below 0 the reader says which there are
    path, number = (name, None) if numbered is None else (numbered[1], int(numbered[2]))
    within = re.fullmatch(r"(.+):([^:]+)", path, re.DOTALL)
    if within is not None and is_bag(within[1]):
        return Spec(within[1], number, within[2])
    return Spec(path, number)


def naming(name: str, error: Exception) -> str:
    """Return an error's message, preceded by the frame's name unless it already names the file.

    The type of an exception other than SonarjaxError is added, because its message alone seldom says what happened.

    Args:
        name: Name of the frame, as for `read_frames`.
        error: The error.

    Returns:
        The message, in one line.
    """
    message = " ".join(str(error).split())
    if not isinstance(error, SonarjaxError):
        return f"{name}: {type(error).__name__}: {message}".removesuffix(": ")
    return message if message.startswith(split_spec(name).path) else f"{name}: {message}"


def iter_records(spec: str | os.PathLike[str]) -> Iterator[Record]:
    """Yield frames one by one, with an error in place of each damaged frame of a recording.

    Args:
        spec: Name of the frames, as for `read_frames`.

    Yields:
        A frame (range, beam), or the SonarjaxError that says why it cannot be read.

    Raises:
        SonarjaxError: As `read_frames`, for problems with the file as a whole.
    """
    path, number, topic = split_spec(spec)
    if is_bag(path):
        return bag_records(path, topic, number)
    ending = os.path.splitext(path)[1].lower()
    opener = PICTURES.get(ending) or RECORDINGS.get(ending)
    if opener is not None:
        return opener(path, number)
    with open_content(path):  # reports a folder or a missing file, whatever its ending
        raise SonarjaxError(f"{path}: unknown ending {ending!r}: expected one of {', '.join(ENDINGS)}")


def iter_frames(spec: str | os.PathLike[str]) -> Iterator[Frame]:
    """Yield frames one by one, so that only one is held in memory.

    A damaged frame of a recording raises its error and ends the reading: `iter_records` goes on to the frames after it.

    Args:
        spec: Name of the frames, as for `read_frames`.

    Yields:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: As `read_frames`, when the frame concerned is reached.
    """
    yield from frames_of(iter_records(spec))


def read_frames(spec: str | os.PathLike[str]) -> list[Frame]:
    """Read all frames of a file, or one of them.

    An unfinished last frame of a recording is left out. A damaged frame raises its error: `iter_records` also gives the
    others. Frames of a sonar file are float32, four times the size of the file's bytes: `iter_frames` holds one at a
    time.

    Args:
        spec: `path` for all frames, or `path:N` for frame N, from 0. For a bag also `path:TOPIC` or `path:TOPIC:N`.
            Endings: .npz .npy .png .aris .ddf .raw .oculus .bag .mcap .db3; for a ROS 2 bag also its folder.

    Returns:
        Frames (range, beam), in the order of the file.

    Raises:
        SonarjaxError: The file is missing, empty, truncated, a folder or of an unknown ending; the frame does not
            exist; the image has not the shape (range, beam), is empty or not numeric, or has values that are NaN,
            infinite or outside [0, 1]; or its mask does not fit. The message names the file, the field and what was
            expected.
    """
    return list(iter_frames(spec))
