"""Checks of what a caller gives: one clear line if it is of another kind than expected.

They look at types only, so traced values pass them and cost nothing.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from sonarjax.io.errors import SonarjaxError

MADE_BY = {
    "Mesh": "from Mesh.load(path) or Mesh.from_arrays(vertices, faces)",
    "Pose": "such as Pose(x=2.0, y=0.0, yaw=0.5)",
    "Sonar": "from Sonar.from_toml(path) or Sonar.preset(name)",
    "FloorPatch": "such as FloorPatch(x=2.0, y=0.0, length=4.0, width=3.0)",
    "GeometryStd": "such as GeometryStd(tilt=0.02, height=0.01)",
    "GeneratorWeights": "such as load_segmenter().weights",
}
"""How to make what is expected, by the name of its class: this file imports none of them."""
HELD_BY = {
    "str": "sonarjax.io.read_frames(path) reads files",
    "Frame": "its field `image` holds them",
    "SonarFrame": "its `semantic()` is a map, sonarjax.observe(frame, model, key=key) an image",
}
"""Where an image is if something else was given for it, by the name of that class."""
NOT_NUMBERS = "OUScMm"
"""Kinds of NumPy types that are no real numbers: objects, text, bytes, complex numbers, times."""
SHOWN = 60
"""Most characters of a value that a message shows."""


def check_kind(value: Any, kind: type, name: str) -> None:
    """Raise a SonarjaxError unless `value` is a `kind`; `name` is what the message calls it."""
    if not isinstance(value, kind):
        made = MADE_BY.get(kind.__name__)
        expected = _with_article(kind.__name__) + (f" ({made})" if made else "")
        raise SonarjaxError(f"{name}: expected {expected}, got {shown(value)}")


def listed(values: Any, kind: type, name: str) -> list[Any]:
    """One `kind` or several as a list. Raises a SonarjaxError where something else is given."""
    if isinstance(values, kind | str | bytes) or not isinstance(values, Iterable):
        check_kind(values, kind, name)
        return [values]
    found = list(values)
    for k, one in enumerate(found):
        check_kind(one, kind, f"{name}[{k}]")
    return found


def number_array(value: Any, name: str, places: Mapping[str, str] = {}) -> np.ndarray:
    """The value, which is not traced, as an array of its own type.

    `places` says where the numbers are, by the name of the class that was given instead. Raises SonarjaxError unless
    the value holds numbers or booleans: text is not converted.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of different length
        raise SonarjaxError(f"{name}: expected an array of numbers, got {shown(value)}") from error
    if array.dtype.kind in NOT_NUMBERS:
        where = places.get("str" if isinstance(value, os.PathLike) else type(value).__name__)
        raise SonarjaxError(f"{name}: expected numbers, got {shown(value)}" + (f" ({where})" if where else ""))
    return array


def image_array(value: Any, name: str) -> np.ndarray:
    """As `number_array`; the message says where the image is, if it was read or rendered already."""
    return number_array(value, name, HELD_BY)


def is_number(value: Any) -> bool:
    """True for one real number of Python, NumPy or JAX that is not traced; False for text, booleans and NaN."""
    try:
        array = np.asarray(value)
    except ValueError:
        return False
    return array.ndim == 0 and array.dtype.kind in "iuf" and not np.isnan(array)


def is_whole(value: Any) -> bool:
    """True for a whole number of Python or NumPy; False for booleans, and for floats even if they are whole."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_text(value: Any) -> bool:
    """True for text that UTF-8 can hold; a file name that is no UTF-8 is read as one that it cannot."""
    return isinstance(value, str) and value.encode("utf-8", "replace").decode() == value


def check_whole(value: Any, least: int, name: str) -> None:
    """Raise a SonarjaxError unless this is a whole number of Python or NumPy of `least` or more."""
    if not is_whole(value) or value < least:
        raise SonarjaxError(f"{name}: expected a whole number of {least} or more, got {shown(value)}")


def positive_numbers(value: Any, expected: str, name: str, count: int | None = None) -> tuple[float, ...]:
    """Several positive, finite numbers as a tuple, which has a hash; the message says what was `expected`.

    Raises a SonarjaxError for other values, none, or another number of them than `count`.
    """
    found = several(value)
    if not found or len(found) != (count or len(found)) or not all(is_number(v) and 0 < v < math.inf for v in found):
        raise SonarjaxError(f"{name}: expected {expected}, got {shown(value) if found is None else found}")
    return tuple(float(v) for v in found)


def several(value: Any) -> tuple[Any, ...] | None:
    """The items of a list, a tuple or an array; None for text and for what has no items."""
    try:
        return None if isinstance(value, str | bytes) else tuple(value)
    except TypeError:
        return None


def shown(value: Any) -> str:
    """What a message says was given: short values as Python writes them, of others the kind."""
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if value is None or isinstance(value, str | bytes | int | float | np.generic):
        text = repr(value.item() if isinstance(value, np.generic) else value)
        return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
    kind = type(value).__name__
    return _with_article(kind)


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0].lower() in 'aeiou' else 'a'} {noun}"
