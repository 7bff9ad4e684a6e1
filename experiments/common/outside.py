"""Frames to be judged: folders of another simulator's, those of the independent judge, and our own for comparison."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sonarjax as sj
from experiments.common.frames import TILTS_DEG, sonar_for
from experiments.common.launch import Skipped
from experiments.common.sets import frames_of, target
from sonarjax.io import read_frames

TRUTH = "truth.csv"


@dataclass(frozen=True)
class OutsideFrame:
    """A frame and its truth, with what an operator knows of the sonar."""

    image: np.ndarray
    """Grey frame (range, beam) in [0, 1]."""
    sonar: sj.Sonar
    """The nominal geometry, which may be a little wrong; frames of one sonar share one object."""
    is_target: bool
    """True for the target, False for another object."""
    yaw: float
    """True yaw [rad]."""
    true_sonar: sj.Sonar | None = None
    """The true geometry, where it is known."""


@dataclass(frozen=True)
class OutsideSet:
    """Frames of one kind, and what is sought in them."""

    name: str
    """What the set is called."""
    target: sj.Mesh
    """What is sought."""
    frames: list[OutsideFrame]
    """The frames."""


def read_set(folder: Path) -> OutsideSet:
    """A folder with target.stl, truth.csv and set_K/sonar.toml.

    Raises SonarjaxError when a file is missing or cannot be used.
    """
    path = folder / TRUTH
    if not path.is_file():
        raise sj.SonarjaxError(f"{path}: no such file, expected the true poses of the frames in this folder")
    with path.open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    groups = sorted({Path(line["frame"]).parent.as_posix() for line in lines})
    sonars = {group: sj.Sonar.from_toml(folder / group / "sonar.toml") for group in groups}

    def frame(line: dict[str, str]) -> OutsideFrame:
        group = Path(line["frame"]).parent.as_posix()
        image = np.asarray(read_frames(folder / line["frame"])[0].image, np.float32)
        nominal, yaw = sonars[group], math.radians(float(line["yaw_deg"]))
        true = nominal.replace(tilt=math.radians(float(line["tilt_deg"])), height=float(line["height_m"]))
        return OutsideFrame(image, nominal, line["object"] == "target", yaw, true)

    return OutsideSet(folder.name, sj.Mesh.load(folder / "target.stl"), [frame(line) for line in lines])


def own_set(name: str, seed: int, step_deg: int) -> OutsideSet:
    """Frames of our own simulator, one of `sets.SETS`: not from outside, but judged alike, for comparison."""
    frames = [
        OutsideFrame(frame.image, sonar_for(frame.tilt_deg), frame.is_target, frame.yaw)
        for frame in frames_of(name, seed, step_deg, TILTS_DEG)
    ]
    return OutsideSet(f"our own, {name}", target(), frames)


def judge_set(seed: int, kind: str, step_deg: float) -> OutsideSet:
    """Frames of the independent judge. Raises Skipped where Embree is not installed."""
    try:
        from experiments.judge.frames import judge_frames
    except ImportError as error:
        raise Skipped(f"the judge needs Embree: pip install 'sonarjax[bench]' ({error})") from error
    frames = [
        OutsideFrame(frame.image, frame.sonar, frame.is_target, frame.yaw)
        for frame in judge_frames(seed, kind, step_deg)
    ]
    return OutsideSet(f"judge, {kind}", sj.objects.target(), frames)
