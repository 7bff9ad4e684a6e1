"""Check what a command will write: it can be a file, and it replaces no input and no other output."""

from __future__ import annotations

import os
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason
from sonarjax.io.given import shown
from sonarjax.io.load import RECORDINGS, Spec, split_spec
from sonarjax.io.ros import is_bag


def check_outputs(outputs: Mapping[str, str | None], inputs: Iterable[str], appended: Container[str] = ()) -> None:
    """Check, before anything is computed, that every output can be a file and replaces no input or other output.

    Its folder must exist, because to write it may come minutes later. Nor may it lie in the folder of a bag that is
    read. Links are followed. A device such as /dev/null may be given twice.

    Args:
        outputs: Command-line option -> path that was given for it; None if it was not given.
        inputs: Paths, or frames as `path:N`.
        appended: Options whose files are appended to where they exist, while the others are replaced.

    Raises:
        SonarjaxError: An output is empty, a folder, or in a folder that does not exist or may not be written in; or it
            would replace an input or another output, or lie in an input's folder.
    """
    given = [(option, path) for option, path in outputs.items() if path is not None]
    sources = [split_spec(spec).path for spec in inputs]
    for number, (option, path) in enumerate(given):
        _check_file(option, path, option in appended)
        for source in sources:
            if same_file(path, source):
                raise SonarjaxError(f"{option}: {path!r} would overwrite the input {source!r}: expected another file")
            if _in_bag(path, source):
                raise SonarjaxError(f"{option}: {path!r} lies in the input {source!r}: expected another folder")
        for other, taken in given[:number]:
            if same_file(path, taken):
                raise SonarjaxError(f"{option}: {path!r} is also {other}: expected another file")


def _check_file(option: str, path: str, appended: bool) -> None:
    """Raise a SonarjaxError if a file could not be written at `path` because of its name or its folder."""
    folder = os.path.dirname(path) or "."
    into = os.path.dirname(os.path.realpath(path))
    if not path:
        raise SonarjaxError(f"{option}: expected the name of a file, got ''")
    if os.path.isdir(path):
        raise SonarjaxError(f"{option}: {path!r}: expected a file, this is a folder")
    for one in (folder,) if _is_device(path) else (folder, into):  # a link may point to a folder that is not there
        if not os.path.isdir(one):
            raise SonarjaxError(f"{option}: {path!r} cannot be written: expected a folder that exists, got {one!r}")
    # To replace a file is to change its folder, links followed.
    place = path if _is_device(path) or (appended and os.path.exists(path)) else into
    if not os.access(place, os.W_OK):
        raise SonarjaxError(f"{option}: {path!r} cannot be written: no permission to write to {place!r}")


def check_ending(option: str, path: str | None, endings: Sequence[str]) -> None:
    """Check that the name of an output ends as files of its format do.

    A device such as /dev/null may have any name, and so may /dev/stdout, whatever it is connected to.

    Args:
        option: The command-line option.
        path: What was given for it; None if it was not given.
        endings: The endings that the name may have, in lower case.

    Raises:
        SonarjaxError: The name ends otherwise.
    """
    if path is None or path.lower().endswith(tuple(endings)) or _is_device(path) or path == "/dev/stdout":
        return
    raise SonarjaxError(f"{option}: {path!r}: expected a name that ends in {' or '.join(endings)}")


def check_folder(folder: Any, name: str) -> None:
    """Check that a folder for output was named: an empty path would mean the current folder, whose files are others'.

    Args:
        folder: What was given for it.
        name: What the message calls it.

    Raises:
        SonarjaxError: It is empty, or no path.
    """
    if not isinstance(folder, str | os.PathLike) or not os.fspath(folder):
        raise SonarjaxError(f"{name}: expected a path, got {shown(folder)}")


def make_folder(path: str) -> None:
    """Make a folder for output, with its parents, unless it is there.

    Args:
        path: The folder.

    Raises:
        SonarjaxError: It cannot be made.
    """
    try:
        os.makedirs(path, exist_ok=True)
    except (OSError, ValueError) as error:
        raise SonarjaxError(f"{path!r}: cannot be used as a folder for output: {reason(error)}") from error


def check_label_files(folder: str, specs: Sequence[str]) -> None:
    """Check that no `labels_<stem>.npz` in a folder would replace an input or belong to two inputs.

    It is not known yet how many frames a recording holds, so any number is assumed; nor what the only topic of a bag
    is, so bags of which no topic is named are taken to have the same.

    Args:
        folder: Folder to which the label files will be written; it may be missing.
        specs: Inputs, as `path` or `path:N`.

    Raises:
        SonarjaxError: A label file would replace an input, or those of two inputs would have the same name.
    """
    given = [split_spec(spec) for spec in specs]
    paths = list(dict.fromkeys(spec.path for spec in given))
    stems = {_stem(path): path for path in paths}
    recordings = {_stem(path) for path in paths if _is_recording(path)}
    inputs = {identity: path for path in paths if (identity := _identity(path)) is not None}
    for name in _label_names(folder):
        identity = _identity(os.path.join(folder, name))
        source = None if identity is None else inputs.get(identity)
        stem = name.removeprefix("labels_").removesuffix(".npz")
        numbered = re.sub("_[0-9]+$", "", stem)
        if source is not None and (stem in stems or numbered in recordings):
            frame = stems.get(stem) or stems[numbered]
            raise SonarjaxError(f"{frame}: its labels would overwrite the input {source!r}: expected another folder")
    _check_stems(given)


def _check_stems(specs: Sequence[Spec]) -> None:
    """Raise a SonarjaxError if two files of one stem give one frame each, or two recordings the same frames."""
    taken: dict[tuple[str | int | None, ...], str] = {}
    for path, number, topic in specs:
        frames = (number, topic) if _is_recording(path) else ()
        other = taken.setdefault((_stem(path), *frames), path)
        if not _same_input(other, path):
            raise SonarjaxError(f"{path}: its labels would overwrite those of {other} (same stem)")


def _same_input(one: str, other: str) -> bool:
    """As `same_file`, also for the folders of bags."""
    identity = _identity(one)
    return one == other or same_file(one, other) or (identity is not None and identity == _identity(other))


def _stem(path: str) -> str:
    return os.path.splitext(os.path.basename(path.rstrip(os.sep)))[0]


def _is_recording(path: str) -> bool:
    return os.path.splitext(path)[1].lower() in RECORDINGS or is_bag(path)


def _in_bag(path: str, source: str) -> bool:
    """True if `path` lies in the folder of a bag, `source`."""
    try:
        is_folder = os.path.isdir(source) and is_bag(source)
        return is_folder and Path(os.path.realpath(path)).is_relative_to(os.path.realpath(source))
    except (OSError, ValueError):  # an impossible path: whoever opens it will report it
        return False


def _is_device(path: str) -> bool:
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def _identity(path: str) -> tuple[int, int] | None:
    """Device and number of a file, links followed; None if there is no such file."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _label_names(folder: str) -> list[str]:
    """Names in `folder` that could be label files; none if it cannot be read, which whoever makes it reports."""
    try:
        return [name for name in os.listdir(folder) if name.startswith("labels_") and name.endswith(".npz")]
    except (OSError, ValueError):
        return []


def same_file(one: str, other: str) -> bool:
    """True if both paths name one regular file, or will once it is written; links are followed."""
    try:
        if os.path.exists(one) and os.path.exists(other):
            return os.path.isfile(one) and os.path.samefile(one, other)
        return os.path.realpath(one) == os.path.realpath(other)
    except (OSError, ValueError):  # an impossible path: whoever opens it will report it
        return False
