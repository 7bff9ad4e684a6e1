"""TOML files to dicts, with one clear error line if they cannot be read. What the keys mean is up to the caller."""

from __future__ import annotations

import os
import tomllib
from typing import Any

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes
from sonarjax.io.given import shown
from sonarjax.io.nesting import check_nesting

TOML_LIMIT = 16 * 2**20
"""Largest TOML file that is read, 16 MiB [bytes]; 10,000 beam angles take 0.2 MiB."""


def parse_toml(data: bytes, name: str) -> dict[str, Any]:
    """Parse a TOML document into a dict.

    Args:
        data: Content of the file.
        name: Its path, for messages.

    Returns:
        The document, with tables as dicts.

    Raises:
        SonarjaxError: It is not UTF-8, not TOML (the message gives line and column), or nested too deeply.
    """
    try:
        document = tomllib.loads(data.decode("utf-8-sig"))  # some editors begin a file with a byte order mark
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        text = " ".join(str(error).split())[:160]
        raise SonarjaxError(f"{name}: expected a TOML file: {text}") from error
    check_nesting(document, name)
    return document


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file into a dict.

    Args:
        path: File to read; it may be empty.

    Returns:
        The document, with tables as dicts.

    Raises:
        SonarjaxError: `path` is no path; or the file is missing, a folder, a device, unreadable or too large, or
            `parse_toml` refuses it.
    """
    if not isinstance(path, str | os.PathLike):
        raise SonarjaxError(f"path: expected that of a TOML file, got {shown(path)}")
    name = os.fspath(path)
    return parse_toml(read_bytes(name, allow_empty=True, limit=TOML_LIMIT), name)
