"""The contract that others build on: what is public, what a result holds, which arguments need no name."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import sonarjax as sj

POSITIONAL = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.POSITIONAL_ONLY)

# What a caller may write without a name, in order, and what may be named. Options with defaults are free.
SIGNATURES: dict[str, tuple[list[str], set[str]]] = {
    "Sonar.from_toml": (["path"], set()),
    "Sonar.preset": (["name"], set()),
    "Mesh.load": (["path"], set()),
    "render": (["mesh", "pose", "sonar"], {"quality"}),
    "observe": (["frame", "model"], {"key"}),
    "template_bank": (["mesh", "sonar", "yaws"], {"x", "y", "engine"}),
    "match_bank": (["image", "bank", "mask"], set()),
    "match_positions": (["image", "bank", "mask"], set()),
    "plan_refinement": (["mesh", "sonar", "start", "config"], set()),
    "refine_pose": (
        ["image", "mesh", "sonar", "start"],
        {"free", "mask", "config", "window", "sonar_poses", "engine"},
    ),
    "refine_yaw": (["image", "mesh", "sonar", "start"], {"mask", "config", "window", "engine"}),
    "Recognizer": (["targets", "sonar"], {"segmenter", "search", "refine", "engine"}),
    "Recognizer.__call__": (["self", "image", "mask"], {"semantic", "threshold", "starts"}),
    "recognize": (["image", "mesh", "sonar"], {"segmenter", "semantic", "search", "refine", "threshold", "mask"}),
    "load_segmenter": (["name"], set()),
    "track": (["frames", "recognizer", "motion"], {"sonar_poses", "masks", "times", "smooth", "config", "expect"}),
    "Tracker": (["recognizer", "motion"], {"config", "threshold", "expect"}),
    "Tracker.__call__": (["self", "image", "mask"], {"sonar_pose", "elapsed"}),
}
FIELDS = {
    "Pose": ["x", "y", "yaw", "z", "roll", "pitch"],
    "Sonar": ["azimuth", "range_min", "range_max", "elevation_aperture", "tilt", "height", "roll", "sound_speed"],
    "SonarFrame": ["intensity", "highlight", "shadow", "lit", "overflow", "sonar"],
    "TemplateBank": ["templates", "yaws", "offset", "x", "y", "tilt"],
    "YawEstimate": ["yaw", "x", "y", "yaw_std", "score", "start_score", "converged", "determined"],
    "PoseEstimate": [
        "pose",
        "covariance",
        "score",
        "start_score",
        "converged",
        "determined",
        "observable",
        "singular_values",
        "free",
    ],
    "Recognition": [
        "identified",
        "target",
        "score",
        "runner_up",
        "margin",
        "yaw",
        "yaw_std",
        "converged",
        "hypotheses",
    ],
    "Segmenter": ["name", "threshold", "tile", "weights"],
    "RenderQuality": ["sub_beams", "elevations"],
    "Standing": ["yaw_drift", "place_drift"],
    "Track": ["yaw", "yaw_std", "x", "y", "rate", "probability", "frames", "beliefs", "smoothed"],
    "Turning": ["rate_std", "rate_drift", "yaw_drift", "place_drift"],
    "WindowSize": ["shape", "object_columns"],
}


def find(name: str) -> Any:
    """An object of the package by its dotted name."""
    thing: Any = sj
    for part in name.split("."):
        thing = getattr(thing, part)
    return thing


@pytest.mark.parametrize("name", SIGNATURES)
def test_signature(name: str) -> None:
    positional, named = SIGNATURES[name]
    parameters = inspect.signature(find(name)).parameters
    assert [p.name for p in parameters.values() if p.kind in POSITIONAL][: len(positional)] == positional
    assert named <= set(parameters)
    assert all(p.kind is not inspect.Parameter.VAR_KEYWORD for p in parameters.values()) or name == "Sonar.preset"


@pytest.mark.parametrize("name", FIELDS)
def test_fields(name: str) -> None:
    fields = [f.name for f in dataclasses.fields(find(name))]
    assert [f for f in FIELDS[name] if f not in fields] == []


def test_contract_names_are_public() -> None:
    assert {name.split(".")[0] for name in [*SIGNATURES, *FIELDS]} <= set(sj.__all__)
    assert [name for name in sj.__all__ if not hasattr(sj, name)] == []


@pytest.mark.parametrize(
    "name",
    ["LeanSearchConfig", "RenderQuality", "RefineConfig", "SearchConfig", "Standing", "TrackConfig", "Turning",
     "WindowSize"],
)  # fmt: skip
def test_configs_are_frozen_and_hashable(name: str) -> None:
    config = find(name)((8, 8)) if name == "WindowSize" else find(name)()
    assert hash(config) == hash(dataclasses.replace(config))
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.anything = 1


ON_FIRST_USE = """
import sys
import sonarjax
assert not {"sonarjax.plot", "sonarjax.cpu", "matplotlib"} & set(sys.modules), "imported with the package"
assert sonarjax.plot is sys.modules["sonarjax.plot"] and sonarjax.cpu is sys.modules["sonarjax.cpu"]
from sonarjax import cluster, plot
assert not hasattr(sonarjax, "plots")
print("as it should be")
"""


def test_plot_and_cpu_are_imported_on_first_use() -> None:
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", ON_FIRST_USE]
    project = Path(__file__).resolve().parent.parent
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "as it should be\n", done.stderr


def test_default_motion_is_the_one_that_the_page_names() -> None:
    for function in (sj.track, sj.Tracker):
        assert inspect.signature(function).parameters["motion"].default == sj.Standing()
    page = (Path(__file__).resolve().parent.parent / "docs" / "track.md").read_text(encoding="utf-8")
    assert "`sj.track` and `sj.Tracker` take `Standing()`, while the command takes\n`Turning()`" in page
