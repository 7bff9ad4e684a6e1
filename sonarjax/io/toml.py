"""TOML files to dicts, with one clear line where they cannot be read. What the keys mean is for the caller."""

from __future__ import annotations

import os
import tomllib
from typing import Any

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes


def parse_toml(data: bytes, name: str) -> dict[str, Any]:
    """The dict of a TOML document. Raises SonarjaxError, with line and column, when it is not UTF-8 or not TOML."""
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        text = " ".join(str(error).split())[:160]
        raise SonarjaxError(f"{name}: expected a TOML file: {text}") from error


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file. Raises SonarjaxError when it is missing, a folder, empty of bytes that decode, or not TOML."""
    name = os.fspath(path)
    return parse_toml(read_bytes(name, allow_empty=True), name)
