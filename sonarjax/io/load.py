"""One entrance for every frame: `read_frames("file.aris:3")`, by the file's ending."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator

from sonarjax.io.aris import parse_aris
from sonarjax.io.didson import parse_didson
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes
from sonarjax.io.frame import Frame
from sonarjax.io.images import parse_npy_frame, parse_npz_frame, parse_png_frame
from sonarjax.io.oculus import parse_oculus

Parser = Callable[[bytes, str, int | None], Iterator[Frame]]

PARSERS: dict[str, Parser] = {
    ".npz": parse_npz_frame,
    ".npy": parse_npy_frame,
    ".png": parse_png_frame,
    ".aris": parse_aris,
    ".ddf": parse_didson,
    ".raw": parse_oculus,
}
"""File ending -> `parse(content, name, index)`, a generator of frames."""


RECORDINGS = (".aris", ".ddf", ".raw")
"""Endings of files that may hold several frames."""
PICTURE_LIMIT = 4 * 2**30
"""Largest .npz, .npy or .png that is read, 4 GiB [bytes]: room for eight arrays of `PIXEL_LIMIT` doubles."""
SIZE_LIMITS = {".npz": PICTURE_LIMIT, ".npy": PICTURE_LIMIT, ".png": PICTURE_LIMIT}
"""File ending -> limit [bytes]; recordings are bounded by memory only."""


def split_spec(spec: str | os.PathLike[str]) -> tuple[str, int | None]:
    """Path and frame number of `path` or `path:N`; a file that really has such a name wins."""
    name = os.fspath(spec)
    match = re.fullmatch(r"(.+):([0-9]{1,18})", name, re.DOTALL)
    if match is None or os.path.exists(name):
        return name, None
    return match[1], int(match[2])


def naming(name: str, error: Exception) -> str:
    """The error's message, opened by the frame's `name` where it does not name the file itself.

    An exception that is not ours is named too: its message alone seldom says what happened.
    """
    message = " ".join(str(error).split())
    if not isinstance(error, SonarjaxError):
        return f"{name}: {type(error).__name__}: {message}".removesuffix(": ")
    return message if message.startswith(split_spec(name)[0]) else f"{name}: {message}"


def iter_frames(spec: str | os.PathLike[str]) -> Iterator[Frame]:
    """Yield the frames (range, beam) of `path` one by one, or the one of `path:N` (N from 0).

    Errors as in `read_frames`, raised when the frame concerned is reached.
    """
    path, index = split_spec(spec)
    ending = os.path.splitext(path)[1].lower()
    if ending not in PARSERS and os.path.isfile(path):
        raise SonarjaxError(f"{path}: unknown ending {ending!r}: expected one of {', '.join(PARSERS)}")
    data = read_bytes(
        path, limit=SIZE_LIMITS.get(ending)
    )  # says what is wrong with a folder or a missing file, whatever its ending
    yield from PARSERS[ending](data, path, index)


def read_frames(spec: str | os.PathLike[str]) -> list[Frame]:
    """All frames (range, beam) of `path`, or the one of `path:N` (N from 0); endings .npz .npy .png .aris .ddf .raw.

    Raises SonarjaxError, one line that names the file, the field and what was expected, when the file is missing,
    empty, truncated, a folder or of an unknown ending, when the frame does not exist, and when the image is not
    (range, beam), empty, not a number, NaN, infinite or outside [0, 1], or its mask does not fit. An unfinished last
    frame of a recording is left out. Frames of a sonar file are float32, four times the size of the file's bytes:
    `iter_frames` holds one at a time.
    """
    return list(iter_frames(spec))
