"""The sensor model says where each of its functions comes from: a work with its year, an equation, or "No source"."""

from __future__ import annotations

import inspect
import re

import pytest

from sonarjax import sensor

FUNCTIONS = [name for name in sensor.__all__ if not inspect.isclass(getattr(sensor, name))]
SOURCE = re.compile(r"\b(1[89]|20)\d\d\b|\beq\. \d|\bNo source\b")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_names_its_source(name: str) -> None:
    text = inspect.getdoc(inspect.unwrap(getattr(sensor, name))) or ""
    assert SOURCE.search(" ".join(text.split())), text
