"""Sequences of frames of one object by one device, and what a recognizer said of each: kept as JSON's types."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, observed, sonar_for
from experiments.common.validation import HEIGHT_STD, TILT_STD
from sonarjax.data.materials import draw_reflectivity
from sonarjax.recognize import Hypothesis, Recognition
from sonarjax.sensor import SensorModel

TILT_DEG = 20.0
ASIDE_M, AHEAD_M = 0.12, 0.1
"""Largest distance of an object from the middle of the view, to the side and ahead [m]."""


class Device(NamedTuple):
    """What stays the same over a sequence."""

    sonar: sj.Sonar
    """The true sonar: its tilt and height are a little off what the recognizer is told."""
    model: SensorModel
    """The device."""
    mesh: sj.Mesh
    """What is shown, as bright as it is."""
    start: sj.Pose
    """Where it stands first [m, rad]."""


def draw_device(mesh: sj.Mesh, severities: tuple[float, float], *, wide: float = 0.0, key: jax.Array) -> Device:
    """A device with its true geometry, and an object near the middle of its view at any yaw.

    A share `wide` of the devices is of the widest family and sees faces of uneven brightness.
    """
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 1), (5,)), float)
    normal = np.asarray(jax.random.normal(jax.random.fold_in(key, 2), (2,)), float)
    nominal = sonar_for(TILT_DEG)
    sonar = nominal.replace(
        tilt=jnp.float32(math.radians(TILT_DEG) + TILT_STD * normal[0]),
        height=jnp.float32(float(nominal.height) + HEIGHT_STD * normal[1]),
    )
    ahead, aside = (2 * draws[0] - 1) * AHEAD_M, (2 * draws[1] - 1) * ASIDE_M
    start = sj.Pose(GROUND_RANGE_M[TILT_DEG] + ahead, aside, 2 * math.pi * draws[2])
    severity = severities[0] + (severities[1] - severities[0]) * draws[3]
    odd = bool(draws[4] < wide)
    model = (SensorModel.draw_wide if odd else SensorModel.draw)(key=jax.random.fold_in(key, 3), severity=severity)
    ground = replace(mesh, vertices=start.to_ground(mesh.vertices))
    painted = draw_reflectivity(ground, sonar.height, mesh.n_faces, key=jax.random.fold_in(key, 4))
    mesh = replace(mesh, reflectivity=painted if odd else jnp.ones(mesh.n_faces))
    return Device(sonar, model, mesh, start)


def recognized(device: Device, recognizer: sj.Recognizer, poses: Iterable[sj.Pose], *, key: jax.Array) -> list[Any]:
    """What `recognizer` says of a frame at each of the `poses` [m, rad] in the sonar's frame: see `kept`."""
    rows = []
    for number, pose in enumerate(poses):
        part = jax.random.fold_in(key, 100 + number)
        image, _ = observed(device.mesh, pose, device.sonar, device.model, key=part)
        found = recognizer(np.asarray(image))
        rows.append(kept(found) | {"true": [float(pose.yaw), float(pose.x), float(pose.y)]})
    return rows


def kept(found: Recognition) -> dict[str, Any]:
    """What tracking needs of a recognition, as JSON's types."""
    hypotheses = [[h.yaw, h.score, h.yaw_std, h.converged, h.x, h.y] for h in found.hypotheses]
    names = ("identified", "score", "score_bank", "threshold", "yaw", "x", "y")
    return {name: getattr(found, name) for name in names} | {"hypotheses": hypotheses}


def taken_up(row: dict[str, Any]) -> Recognition:
    """A recognition of what was kept of it; the rest of it is empty."""
    hypotheses = tuple(
        Hypothesis(yaw, score, math.inf if std is None else std, settled, x, y)
        for yaw, score, std, settled, x, y in row["hypotheses"]
    )
    best = hypotheses[0]
    return Recognition(
        identified=row["identified"], target="target", score=row["score"], score_bank=row["score_bank"],
        score_refined=best.score, threshold=row.get("threshold", 0.5), runner_up=None, margin=None, yaw_bin=math.nan,
        yaw_std=best.yaw_std, x=row["x"], y=row["y"], converged=best.converged, scores_by_yaw=np.empty(0),
        yaw=row["yaw"], hypotheses=hypotheses, segmenter="kept", semantic=np.empty((0, 0)),
    )  # fmt: skip


class Replayed(sj.Recognizer):
    """Stands for the recognizer of frames that were recognized before, in a `Tracker` that takes what it said."""

    def __init__(self) -> None:
        """It has one target and prepares nothing."""
        self.targets: Any = {"target": None}
        self.search, self.refine = sj.SearchConfig(), None


def truths(rows: Sequence[dict[str, Any]]) -> np.ndarray:
    """True yaw [rad], x and y [m] of each frame (frame, 3)."""
    return np.array([row["true"] for row in rows], float)
