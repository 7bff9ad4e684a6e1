"""Write files, all or nothing: to a temporary file in the same folder, then renamed, so that no reader sees half a
file.

If the disk is full, the folder read-only or the target a folder, the old file stays as it was, nothing is left behind,
and the error is a SonarjaxError of one line.
"""

from __future__ import annotations

import contextlib
import io
import os
import secrets
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason

PathLike = str | os.PathLike[str]
Writer = Callable[[IO[bytes]], object]


def write_atomic(path: PathLike, writer: Writer) -> None:
    """Let `writer(file)` write a binary file, then move it to `path` in one step.

    A device such as /dev/null is written to directly. An OSError of `writer` becomes a SonarjaxError; its other
    exceptions pass through. After any of them, or Ctrl-C, no partial file is left behind. A process that is ended by a
    signal such as SIGTERM or SIGKILL may leave its temporary file, `.sonarjax-*.tmp`; `path` is whole then too.

    Args:
        path: File to write. If it is a link, the file that it points to is written, and the link is kept.
        writer: Function that is called with the open binary file and writes the content.

    Raises:
        SonarjaxError: The file cannot be written, the path is a folder, or it contains NUL. What was at `path` is then
            unchanged.
        BrokenPipeError: `path` is a pipe that nobody reads any more.
    """
    name = os.fspath(path)
    if "\0" in name:
        raise SonarjaxError(f"{name!r}: expected a file name without NUL")
    try:
        target = Path(os.path.realpath(name))  # write the file that a link points to, and keep the link
        if target.is_dir():
            raise SonarjaxError(f"{name}: expected a file to write, this is a folder")
        # By the given name: the path of /dev/stdout, a link, does not exist where stdout is a pipe.
        if os.path.exists(name) and not stat.S_ISREG(os.stat(name).st_mode):
            _write_to_device(name, writer)
        else:
            _write_aside(target, writer)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise SonarjaxError(f"{name}: cannot be written: {reason(error)}") from error


def _write_to_device(name: str, writer: Writer) -> None:
    """Write all at once: a device is written from front to back, while a ZIP archive is filled out of order."""
    content = io.BytesIO()
    writer(content)
    with open(name, "wb") as file:
        file.write(content.getbuffer())


def _write_aside(target: Path, writer: Writer) -> None:
    aside = target.with_name(f".sonarjax-{secrets.token_hex(6)}.tmp")
    try:
        # Not `tempfile`, whose files are private to the user: ours follow the umask, or the file that they replace.
        with open(os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
            writer(file)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            aside.chmod(stat.S_IMODE(target.stat().st_mode))
        os.replace(aside, target)
    except BaseException:  # an interrupt must not leave the file behind either
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)
        raise


def write_text(path: PathLike, text: str) -> None:
    """Write a text as UTF-8, all or nothing.

    Args:
        path: File to write.
        text: Its content.

    Raises:
        SonarjaxError: The file cannot be written.
    """
    write_atomic(path, lambda file: file.write(text.encode("utf-8")))


def write_npz(path: PathLike, /, **arrays: np.ndarray) -> None:
    """Write named arrays as a compressed NPZ, all or nothing.

    The same arrays give the same bytes.

    Args:
        path: File to write.
        **arrays: Arrays of numbers (any shape), each under its name in the file.

    Raises:
        SonarjaxError: The file cannot be written, or an array would need pickle.
    """
    plain = {key: np.asanyarray(value) for key, value in arrays.items()}
    for key, value in plain.items():
        if value.dtype.hasobject:
            raise SonarjaxError(f"{os.fspath(path)}: {key}: expected an array of numbers, got Python objects")
    write_atomic(path, lambda file: zip_arrays(file, plain))


def zip_arrays(file: IO[bytes] | io.BytesIO, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays of numbers (any shape) into an open file as a compressed NPZ."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in arrays.items():
            info = zipfile.ZipInfo(f"{key}.npy")  # its fixed date keeps the bytes reproducible
            info.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(info, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, value, allow_pickle=False)


def write_png(
    path: PathLike,
    image: UInt8[np.ndarray, "row column"]
    | Float[np.ndarray, "row column"]
    | UInt8[np.ndarray, "row column 3"]
    | Float[np.ndarray, "row column 3"],
) -> None:
    """Write a grey or colour picture as PNG, all or nothing.

    Args:
        path: File to write.
        image: Grey picture (row, column) or colour picture (row, column, 3). uint8 is stored as it is; floats must be
            in [0, 1] and are stored times 255.

    Raises:
        SonarjaxError: The picture has another type, shape or range, or is empty; or the file cannot be written.
    """
    name, values = os.fspath(path), np.asarray(image)
    if values.size == 0 or not (values.ndim == 2 or (values.ndim == 3 and values.shape[2] == 3)):
        raise SonarjaxError(f"{name}: picture: expected (row, column) or (row, column, 3), got {values.shape}")
    if values.dtype.kind == "f":
        # Up to a millionth outside may come from float32 rounding. NaN fails both comparisons.
        if not (values.min() >= -1e-6 and values.max() <= 1.0 + 1e-6):
            raise SonarjaxError(f"{name}: picture: expected finite floats in [0, 1]")
        values = np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
    if values.dtype != np.uint8:
        raise SonarjaxError(f"{name}: picture: expected uint8 or float, got {values.dtype}")
    picture = Image.fromarray(np.ascontiguousarray(values))
    write_atomic(path, lambda file: picture.save(file, format="PNG"))
