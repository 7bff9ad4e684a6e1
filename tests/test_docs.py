"""Every public name says what it is, with the shapes and units of what it takes, and draws only from a key.

Shapes: the axis list of an annotation such as `Float[Array, "range beam"]` stands in a function's docstring as
`(range, beam)`; a field wears its annotation beside its docstring, so there it need not be said twice.
Units: where an argument or a field is named after a physical quantity, its docstring names the unit, as in `[m]`.
README: its blocks hold tables and say which runs they are from, and the experiments that it names are there.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from jaxtyping import Array, Float, Int

import sonarjax
from paper_figs import readme

PROJECT = Path(__file__).resolve().parents[1]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]
README = PAGES[0].read_text(encoding="utf-8")
AXES = re.compile(r"""(?:Float|Int|UInt|Bool|Num|Shaped|Real|Inexact|Complex|Key)\d*\[[^\]"']*["']([^"']*)["']""")
UNITS = {
    "m": re.compile(
        r"^(x|y|z|height|length|width|radius|depth|distance|position\w*|offset_m|range_(min|max|bin|edges)"
        r"|ranges?|pulse_length|ground_range|vertices|points?)$"
    ),
    "rad": re.compile(
        r"^(yaws?|tilt|roll|pitch|angles?|bearing|azimuth(_edges)?|elevation_aperture|beam_width|yaw_std)$"
    ),
    "Hz": re.compile(r"^frequency$"),
    "m/s": re.compile(r"^sound_speed$"),
    "dB/m": re.compile(r"^absorption$"),
    "s": re.compile(r"^(seconds|duration)$"),
    "deg": re.compile(r"\w+_deg$"),
}
NOT_NUMBERS = re.compile(r"\b(str|bool|bytes|Path|Mesh|Pose|Sonar|Callable|slice)\b")


def public_names() -> list[tuple[str, Any]]:
    """(dotted name, object) of everything in `__all__` of the package and of each of its folders, once each."""
    names: dict[str, Any] = {}
    folders = [m.name for m in pkgutil.iter_modules(sonarjax.__path__) if m.ispkg]
    for module in [sonarjax, *(importlib.import_module(f"sonarjax.{f}") for f in folders)]:
        names |= {f"{module.__name__}.{name}": getattr(module, name) for name in getattr(module, "__all__", [])}
    unique = {id(thing): (name, thing) for name, thing in names.items()}
    return sorted(unique.values(), key=lambda pair: pair[0])


def complaints(name: str, thing: Any) -> list[str]:
    """What the documentation of a public object lacks: one sentence each."""
    if isinstance(thing, ModuleType):
        own = [(f"{name}.{n}", v) for n, v in vars(thing).items() if _defined_in(v, thing) and not n.startswith("_")]
        return _docstring(name, thing) + [line for pair in own for line in complaints(*pair)]
    if inspect.isclass(thing):
        return list(_of_class(name, thing))
    if callable(thing):
        return list(_of_function(name, thing))
    return []


def _defined_in(thing: Any, module: ModuleType) -> bool:
    return callable(thing) and getattr(thing, "__module__", None) == module.__name__


def _docstring(name: str, thing: Any) -> list[str]:
    text = inspect.unwrap(thing).__doc__ if callable(thing) else thing.__doc__
    generated = inspect.isclass(thing) and bool(text) and text.startswith(f"{thing.__name__}(")
    return [] if text and not generated else [f"{name} has no docstring"]


def _of_class(name: str, thing: type) -> Iterator[str]:
    yield from _docstring(name, thing)
    if issubclass(thing, BaseException):
        return
    documented = field_docstrings(thing)
    for field, annotation in _fields(thing).items():
        text = documented.get(field)
        if text is None:
            yield f"{name}.{field} has no docstring under it"
        else:
            yield from _unit(f"{name}.{field}", field, annotation, text)
    for method, value in vars(thing).items():
        plain = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        plain = plain.fget if isinstance(plain, property) else plain
        if not method.startswith("_") and inspect.isfunction(inspect.unwrap(plain)):
            yield from _of_function(f"{name}.{method}", plain)


def _fields(thing: type) -> dict[str, str]:
    """Public fields of a dataclass or a named tuple, with their annotations as text."""
    if dataclasses.is_dataclass(thing):
        return {f.name: _text(f.type) for f in dataclasses.fields(thing) if not f.name.startswith("_")}
    if hasattr(thing, "_fields"):
        return {f: _text(thing.__annotations__[f]) for f in thing._fields}
    return {}


def field_docstrings(thing: type) -> dict[str, str]:
    """The string that stands under each annotated field of a class."""
    body = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0].body  # type: ignore[attr-defined]
    found = {}
    for field, below in pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            found[ast.unparse(field.target)] = str(below.value.value)
    return found


def _of_function(name: str, function: Any) -> Iterator[str]:
    yield from _docstring(name, function)
    plain = inspect.unwrap(function)
    text = plain.__doc__ or ""
    signature = inspect.signature(plain)
    for parameter in signature.parameters.values():
        annotation = _text(parameter.annotation)
        yield from _shape(f"{name}({parameter.name})", annotation, text)
        yield from _unit(f"{name}({parameter.name})", parameter.name, annotation, text)
    yield from _shape(f"what {name} returns", _text(signature.return_annotation), text)
    yield from _key(name, plain, signature)


def _text(annotation: Any) -> str:
    if annotation is inspect.Parameter.empty:
        return ""
    return annotation if isinstance(annotation, str) else str(getattr(annotation, "__name__", annotation))


def _shape(name: str, annotation: str, text: str) -> Iterator[str]:
    written = {re.sub(r"\s", "", shape).strip(",") for shape in re.findall(r"[(\[]([^()\[\]]*)[)\]]", text)}
    for axes in AXES.findall(annotation):
        names = [a for a in axes.split() if a != "..." and not a.startswith(("*", "#*"))]
        wanted = ",".join(a.lstrip("#?_").split("=")[-1] for a in names)
        if wanted and wanted not in written:
            yield f"{name} is [{axes}], and no ({', '.join(wanted.split(','))}) stands in the docstring"


def _unit(name: str, argument: str, annotation: str, text: str) -> Iterator[str]:
    if NOT_NUMBERS.search(annotation):
        return
    written = {unit for group in re.findall(r"\[([^\[\]]*)\]", text) for unit in re.split(r"[,;\s]+|\bor\b", group)}
    for unit, pattern in UNITS.items():
        if pattern.match(argument) and unit not in written:
            yield f"{name} is a quantity in [{unit}], and the docstring does not say so"


def _key(name: str, function: Any, signature: inspect.Signature) -> Iterator[str]:
    parameters = signature.parameters
    draws = re.search(r"\b(jax\.random|jrandom|random)\.(?!key\b|PRNGKey\b|default_rng\b)\w+\(", _source(function))
    if draws and "key" not in parameters:
        yield f"{name} draws at random without a `key`"
    if "key" in parameters and parameters["key"].kind is not inspect.Parameter.KEYWORD_ONLY:
        yield f"{name}(key) is not keyword-only"
    if {"seed", "rng"} & set(parameters):
        yield f"{name} takes a seed or a generator where the package takes a `key`"


def _source(function: Any) -> str:
    try:
        return inspect.getsource(function)
    except (OSError, TypeError):  # made by a class decorator: it has no text of its own
        return ""


@pytest.mark.parametrize(("name", "thing"), public_names(), ids=[name for name, _ in public_names()])
def test_public_name_is_documented(name: str, thing: Any) -> None:
    assert complaints(name, thing) == []


def test_package_and_folders_say_what_is_public() -> None:
    folders = [f"sonarjax.{m.name}" for m in pkgutil.iter_modules(sonarjax.__path__) if m.ispkg]
    modules = {name: importlib.import_module(name) for name in ["sonarjax", *folders]}
    assert [name for name, module in modules.items() if not getattr(module, "__all__", None)] == []
    assert [name for name, module in modules.items() if not module.__doc__] == []


def test_every_module_has_a_docstring() -> None:
    files = sorted(Path(p) for folder in sonarjax.__path__ for p in Path(folder).rglob("*.py"))
    assert [f.name for f in files if not ast.get_docstring(ast.parse(f.read_text(encoding="utf-8")))] == []


# The checker, held to functions that are wrong on purpose.


def _undocumented(x: float) -> None: ...


def _without_shape(image: Float[Array, "range beam"]) -> None:
    """An image."""


def _wrong_shape(image: Float[Array, "range beam"]) -> None:
    """An image (beam, range)."""


def _without_result(image: Float[Array, "range beam"]) -> Int[Array, " label"]:
    """An image (range, beam)."""


def _without_unit(yaw: float) -> None:
    """Turn by `yaw`."""


def _wrong_unit(yaw: float) -> None:
    """Turn by `yaw` [m]."""


def _positional_key(key: jax.Array) -> None:
    """Noise."""


def _without_key() -> None:
    """Noise."""
    np.random.normal()  # noqa: NPY002


def _with_seed(*, seed: int) -> None:
    """Noise."""


class _Fields(NamedTuple):
    """A place."""

    x: float
    yaw: float
    """Turn."""


@dataclasses.dataclass
class _Generated:
    count: int
    """Number of something."""


WRONG = {
    _undocumented: 2, _without_shape: 1, _wrong_shape: 1, _without_result: 1, _without_unit: 1, _wrong_unit: 1,
    _positional_key: 1, _without_key: 1, _with_seed: 1, _Fields: 2, _Generated: 1,
}  # fmt: skip


def _right(
    image: Float[Array, "*batch range beam"],
    yaws: Float[Array, " yaw"],
    x: float,
    pose: sonarjax.scene.Pose,
    *,
    key: jax.Array,
) -> Float[Array, ""]:
    """Scores of an image (range, beam) at `x` [m] for each of `yaws` (yaw,) [rad], noise drawn from `key`."""
    return jax.random.normal(key)


@pytest.mark.parametrize("thing", WRONG)
def test_checker_sees(thing: Any) -> None:
    assert len(complaints("it", thing)) == WRONG[thing]


def test_checker_allows() -> None:
    assert complaints("it", _right) == []


# README: the blocks that `paper_figs.readme` fills, and the experiments that are named.

MARKED = re.compile(r"^<!-- (\w[\w ]*):(?:begin|end) -->$", re.MULTILINE)
TABLE = re.compile(r"^\|.+\|\n\|[-:| ]+\|\n\|.+\|$", re.MULTILINE)  # head, rule and a row


def lacks(text: str, name: str) -> list[str]:
    """What the block `name` of a Markdown text lacks."""
    block = re.search(rf"^<!-- {name}:begin -->\n(.*?)^<!-- {name}:end -->$", text, re.MULTILINE | re.DOTALL)
    held = block[1] if block else ""
    origin = re.search(rf"^\*`python -m experiments\.{name}\b[^`\n]*`.+\*$", held, re.MULTILINE)
    wanted = {"both markers": block, "a table": TABLE.search(held), "its command, in italics": origin}
    return [what for what, found in wanted.items() if not found]


@pytest.mark.parametrize("name", sorted(set(MARKED.findall(README))))
def test_block_of_readme_is_filled(name: str) -> None:
    assert lacks(README, name) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_made_of_the_results_that_are_kept(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert readme.with_blocks(text, page) == text


BLOCKS = re.compile(r"^<!-- (\w[\w ]*):begin -->\n.*?^<!-- \1:end -->$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
MEASURED = re.compile(r"(?<![\d.-])\d+\.\d+(?!\.?\d)|\b\d+ ?(?:%|ms\b|s a frame|times as)")
# Of the method, not of a run: version numbers, settings, and what the real data's own README says of its truth.
SETTINGS = {"README.md": {"3.11", "0.25"}, "results.md": {"0.2", "95 %", "90 %"}, "speed.md": {"0.10"}}
SETTINGS["calibrate.md"] = {"0.1", "0.3", "1 %", "2 %"}  # the height's search, and how far devices are off
SETTINGS["install.md"] = {"3.11"}
SETTINGS["export.md"] = {"0.5", "0.17"}  # the grey of background, a version
SETTINGS["glossary.md"] = SETTINGS["renderer.md"] = {"0.5"}
SETTINGS["training.md"] = {"3.1"}  # the paper's section
SETTINGS["export.md"] = {"0.5", "0.17"}  # the background's grey, and a version
SETTINGS["track.md"] = {"68 %"}  # what one standard deviation holds
SETTINGS["outside.md"] = {"0.75", "95 %"}  # least grey of highlight, and a bootstrap's interval


def typed_numbers(text: str) -> set[str]:
    """Numbers of a Markdown text that look measured and stand outside of the tables that are made, and of code."""
    return set(MEASURED.findall(CODE.sub("", BLOCKS.sub("", text))))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_measured_number_is_typed_by_hand(page: Path) -> None:
    assert typed_numbers(page.read_text(encoding="utf-8")) - SETTINGS.get(page.name, set()) == set()


def test_typed_numbers_are_seen() -> None:
    text = "It takes 0.5 s and 43 ms, is right in 98 % and 3 times as fast; `0.7`, version 0.1.0\n"
    text += "\n<!-- a:begin -->\n0.9\n<!-- a:end -->\n"
    assert typed_numbers(text) == {"0.5", "43 ms", "98 %", "3 times as"}


BLOCK = "<!-- a:begin -->\n\n| x |\n| --- |\n| 1 |\n\n*`python -m experiments.a --n 1`, seed 0*\n\n<!-- a:end -->\n"


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("", "", 0), ("| 1 |\n", "", 1), ("*`", "`", 1), ("experiments.a", "experiments.ab", 1), ("a:end", "b:end", 3),
        (BLOCK, "<!-- a:begin -->\n<!-- a:end -->\n", 2),
    ],
)  # fmt: skip
def test_block_check_sees(old: str, new: str, wanted: int) -> None:
    assert len(lacks(BLOCK.replace(old, new, 1), "a")) == wanted


@pytest.mark.parametrize("file", ["README.md", "experiments/README.md"])
def test_experiments_that_are_named_are_there(file: str) -> None:
    named = re.findall(r"python -m\s+experiments\.(\w+)", (PROJECT / file).read_text(encoding="utf-8"))
    assert named
    assert [name for name in named if not (PROJECT / "experiments" / f"{name}.py").is_file()] == []
