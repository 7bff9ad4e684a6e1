"""The contract that others build on: names, parameters by name and order, fields of results. Nothing is run here."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any

import pytest

import sonarjax as sj

REQUIRED = inspect.Parameter.empty
POSITIONAL = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.POSITIONAL_ONLY)

# What a caller may write without a name, in order; what else may be named. Further options with defaults are free.
SIGNATURES: dict[str, tuple[list[str], set[str]]] = {
    "Sonar.from_toml": (["path"], set()),
    "Sonar.preset": (["name"], set()),
    "Mesh.load": (["path"], set()),
    "render": (["mesh", "pose", "sonar"], {"sub_beams", "elevations"}),
    "template_bank": (["mesh", "sonar", "yaws"], {"x", "y"}),
    "match_bank": (["image", "bank"], {"mask"}),
    "match_positions": (["image", "bank"], {"mask"}),
    "refine_yaw": (["image", "mesh", "sonar", "start"], set()),
    "recognize": (["image", "mesh", "sonar"], set()),
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "template_bank": {"y": 0.0},
    "match_bank": {"mask": None},
    "match_positions": {"mask": None},
}
# Parameters without a default beside the positional ones above.
NEEDED_BY_NAME = {"template_bank": {"x"}}
FIELDS = {
    "Pose": ["x", "y", "yaw", "z", "roll", "pitch"],
    "Sonar": ["azimuth", "range_min", "range_max", "elevation_aperture", "tilt", "height", "roll", "sound_speed"],
    "SonarFrame": ["intensity", "highlight", "shadow", "lit"],
    "TemplateBank": ["templates", "yaws", "offset"],
}
METHODS = {"SonarFrame": ["labels", "semantic"]}


def find(name: str) -> Any:
    """An object of the package by its dotted name."""
    thing: Any = sj
    for part in name.split("."):
        thing = getattr(thing, part)
    return thing


def breaches(function: Callable[..., Any], positional: list[str], named: set[str], needed: set[str]) -> list[str]:
    """Where a function's parameters depart from the contract: one sentence each."""
    parameters = inspect.signature(function).parameters
    first = [p.name for p in parameters.values() if p.kind in POSITIONAL][: len(positional)]
    found = [] if first == positional else [f"starts with {first}, not {positional}"]
    found += [f"{name} is missing" for name in sorted(named - set(parameters))]
    for name, p in parameters.items():
        if p.default is REQUIRED and name not in {*positional, *needed} and p.kind is not inspect.Parameter.VAR_KEYWORD:
            found.append(f"{name} has no default")
    return found


@pytest.mark.parametrize("name", SIGNATURES)
def test_signature(name: str) -> None:
    positional, named = SIGNATURES[name]
    assert breaches(find(name), positional, named, NEEDED_BY_NAME.get(name, set())) == []


@pytest.mark.parametrize("name", DEFAULTS)
def test_defaults(name: str) -> None:
    parameters = inspect.signature(inspect.unwrap(find(name))).parameters
    assert {p: parameters[p].default for p in DEFAULTS[name]} == DEFAULTS[name]


@pytest.mark.parametrize("name", FIELDS)
def test_fields(name: str) -> None:
    fields = [f.name for f in dataclasses.fields(find(name))]
    assert [f for f in FIELDS[name] if f not in fields] == []


@pytest.mark.parametrize("name", METHODS)
def test_methods(name: str) -> None:
    assert [m for m in METHODS[name] if not callable(getattr(find(name), m, None))] == []


def test_pose_is_x_y_yaw_first_and_rests_at_zero() -> None:
    pose = sj.Pose(2.2, 0.5, 0.3)
    assert (pose.x, pose.y, pose.yaw) == (2.2, 0.5, 0.3)
    assert (pose.z, pose.roll, pose.pitch) == (0.0, 0.0, 0.0)


def test_contract_names_are_public() -> None:
    assert {name.split(".")[0] for name in [*SIGNATURES, *FIELDS]} <= set(sj.__all__)


def test_checker_sees() -> None:
    def swapped(pose: int, mesh: int, sonar: int) -> None: ...
    def demanding(mesh: int, pose: int, sonar: int, *, sub_beams: int, elevations: int = 1) -> None: ...
    def short(mesh: int, pose: int, sonar: int, *, sub_beams: int = 1) -> None: ...

    wanted = SIGNATURES["render"]
    assert [len(breaches(f, *wanted, set())) for f in (swapped, demanding, short)] == [3, 1, 1]
