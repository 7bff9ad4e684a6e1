"""Limit how deeply a parsed document may be nested, so that code that walks it later may safely recurse."""

from __future__ import annotations

from typing import Any

from sonarjax.io.errors import SonarjaxError

DEEPEST = 64
"""Most levels of tables and lists in a file that is read; `sonar.toml` has two."""


def check_nesting(document: Any, name: str) -> None:
    """Raise a SonarjaxError if tables and lists of a parsed TOML or JSON `document` are nested too deeply.

    The check goes level by level: a recursion could itself run out of stack.
    """
    level, depth = [document], 0
    while level := [inner for outer in level for inner in _inside(outer)]:
        depth += 1
        if depth > DEEPEST:
            raise SonarjaxError(f"{name}: expected at most {DEEPEST} levels of nested tables and lists, got more")


def _inside(value: Any) -> list[Any]:
    """Tables and lists directly inside a value; nothing if it is neither."""
    if isinstance(value, dict):
        value = list(value.values())
    return [item for item in value if isinstance(item, dict | list)] if isinstance(value, list) else []
