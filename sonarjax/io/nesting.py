"""How deep a parsed document may be nested: what walks through it later may recurse without fear."""

from __future__ import annotations

from typing import Any

from sonarjax.io.errors import SonarjaxError

DEEPEST = 64
"""Levels of tables and lists in a file that we read; `sonar.toml` has two."""


def check_nesting(document: Any, name: str) -> None:
    """Raises SonarjaxError when tables and lists of a parsed TOML or JSON `document` are nested too deeply.

    It goes level by level, because a recursion is what this is meant to spare.
    """
    level, depth = [document], 0
    while level := [inner for outer in level for inner in _inside(outer)]:
        depth += 1
        if depth > DEEPEST:
            raise SonarjaxError(f"{name}: expected at most {DEEPEST} levels of nested tables and lists, got more")


def _inside(value: Any) -> list[Any]:
    """Tables and lists directly inside a value; nothing where it is neither."""
    if isinstance(value, dict):
        value = list(value.values())
    return [item for item in value if isinstance(item, dict | list)] if isinstance(value, list) else []
