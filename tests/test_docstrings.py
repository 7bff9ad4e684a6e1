"""Every public name says what it is, with the shapes and units of what it takes, and draws only from a key.

Shapes: the axis list of an annotation such as `Float[Array, "range beam"]` stands in a function's docstring as
`(range, beam)`; a field wears its annotation beside its docstring, so there it need not be said twice.
Units: where an argument or a field is named after a physical quantity, its docstring names the unit, as in `[m]`.
Sections: a one-line summary first; `Args:` with every parameter; `Returns:` or `Yields:` where something comes back.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
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
    """(dotted name, object) of all that the package, its folders and its own files make public, once each."""
    names: dict[str, Any] = {}
    inside = [m.name for m in pkgutil.iter_modules(sonarjax.__path__) if m.name != "__main__"]
    for module in [sonarjax, *(importlib.import_module(f"sonarjax.{name}") for name in inside)]:
        own = [n for n, v in vars(module).items() if _defined_in(v, module) and not n.startswith("_")]
        names |= {f"{module.__name__}.{name}": getattr(module, name) for name in getattr(module, "__all__", own)}
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
        if method.startswith("_"):
            continue
        if isinstance(plain, property | functools.cached_property):
            yield from _of_property(f"{name}.{method}", getattr(plain, "fget", None) or plain.func)
        elif inspect.isfunction(inspect.unwrap(plain)):
            yield from _of_function(f"{name}.{method}", plain)


def _of_property(name: str, getter: Any) -> Iterator[str]:
    """A property reads as a field: one text with the shape of what it gives, no sections."""
    yield from _docstring(name, getter)
    yield from _shape(name, _text(inspect.signature(getter).return_annotation), getter.__doc__ or "")


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
    yield from _sections(name, signature, inspect.getdoc(plain) or "")
    yield from _key(name, plain, signature)


def _sections(name: str, signature: inspect.Signature, text: str) -> Iterator[str]:
    summary = text.split("\n\n", maxsplit=1)[0]
    if "\n" in summary or not summary.endswith("."):
        yield f"{name}: the docstring does not start with a summary of one line that ends with a full stop"
    _, _, args = text.partition("Args:\n")
    listed = {n for names in re.findall(r"^    ([\w, *]+):", args, re.MULTILINE) for n in re.findall(r"\w+", names)}
    wanted = [n for n in signature.parameters if n not in ("self", "cls") and not n.startswith("_")]
    for parameter in [n for n in wanted if n not in listed]:
        yield f"{name}: `Args:` does not list {parameter}"
    nothing = _text(signature.return_annotation) in ("", "None", "NoReturn")
    if not nothing and not re.search(r"^(Returns|Yields):\n", text, re.MULTILINE):
        yield f"{name}: no `Returns:` or `Yields:`"


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
    """Look.

    Args:
        image: An image.
    """


def _wrong_shape(image: Float[Array, "range beam"]) -> None:
    """Look.

    Args:
        image: An image (beam, range).
    """


def _without_shape_of_result(image: Float[Array, "range beam"]) -> Int[Array, " label"]:
    """Look.

    Args:
        image: An image (range, beam).

    Returns:
        Labels.
    """


def _without_unit(yaw: float) -> None:
    """Turn.

    Args:
        yaw: Angle.
    """


def _wrong_unit(yaw: float) -> None:
    """Turn.

    Args:
        yaw: Angle [m].
    """


def _without_args(image: Any, mask: Any) -> None:
    """Look at an image.

    Args:
        image: An image.
    """


def _without_result() -> int:
    """Count."""


def _without_summary() -> None:
    """Count what is there,
    and more.
    """


def _positional_key(key: jax.Array) -> None:
    """Noise.

    Args:
        key: Random key.
    """


def _without_key() -> None:
    """Noise."""
    np.random.normal()  # noqa: NPY002


def _with_seed(*, seed: int) -> None:
    """Noise.

    Args:
        seed: Any number.
    """


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
    _undocumented: 4, _without_shape: 1, _wrong_shape: 1, _without_shape_of_result: 1, _without_unit: 1,
    _wrong_unit: 1, _without_args: 1, _without_result: 1, _without_summary: 1, _positional_key: 1, _without_key: 1,
    _with_seed: 1, _Fields: 2, _Generated: 1,
}  # fmt: skip


def _right(
    image: Float[Array, "*batch range beam"],
    yaws: Float[Array, " yaw"],
    x: float,
    pose: sonarjax.scene.Pose,
    *,
    key: jax.Array,
) -> Float[Array, ""]:
    """Score an image at one place.

    Args:
        image: An image (range, beam).
        yaws: Angles (yaw,) [rad].
        x: Place [m].
        pose: Of the object.
        key: Draws the noise.

    Returns:
        The score.
    """
    return jax.random.normal(key)


@pytest.mark.parametrize("thing", WRONG)
def test_checker_sees(thing: Any) -> None:
    assert len(complaints("it", thing)) == WRONG[thing]


def test_checker_allows() -> None:
    assert complaints("it", _right) == []
