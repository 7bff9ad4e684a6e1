"""The judge's frames: sets of one sonar each, every object at every yaw, reproducible from a seed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.judge.labels import labels
from experiments.judge.raycast import cast, place
from experiments.judge.sensor import Device, store
from experiments.judge.view import View
from sonarjax.scene import Mesh, objects
from sonarjax.sonar import Sonar

KINDS = ("offset", "severe", "mirror", "devices")
"""Kinds of frames, see `judge_frames`."""
GROUND_RANGE_M = {15.0: 2.45, 20.0: 2.30, 25.0: 2.10}
"""Where the object stands at each tilt [°] of §4.1, well inside the lit floor [m]."""
RANGE_SLACK_M, BEARING_SLACK_DEG, YAW_SLACK_DEG = 0.1, 4.0, 5.0
"""Half widths of what is drawn for each frame: ground range [m], bearing [°], yaw off the grid [°]."""
TILT_SLACK_DEG, HEIGHT_SLACK_M = 1.0, 0.01
"""Half widths of what the operator does not know: tilt [°] and height [m]."""
HEIGHT_M = 0.9
"""Nominal height of the sonar (Table 1) [m]."""
STREAMS, SET_STREAM = 1_000_000, 900_000
"""Random streams kept for each kind; those from `SET_STREAM` on belong to whole sets."""


@dataclass(frozen=True)
class JudgeFrame:
    """One frame and its truth."""

    image: np.ndarray
    """Grey frame (range, beam), float32 in [0, 1]; 8 bits deep."""
    labels: np.ndarray
    """True classes (range, beam), uint8: 0 background, 1 highlight, 2 shadow."""
    is_target: bool
    """True for the target, False for the other object."""
    yaw: float
    """True yaw [rad], in [0, 2π)."""
    x: float
    """True forward position [m]."""
    y: float
    """True position to port [m]."""
    tilt_deg: float
    """True tilt [°]."""
    height: float
    """True height of the sonar [m]."""
    sonar: Sonar
    """The *nominal* sonar, as the recognizer is told; one object for all frames of a set."""
    group: int
    """Which set the frame belongs to."""


def judge_frames(seed: int, kind: str, step_deg: float = 10.0) -> list[JudgeFrame]:
    """All frames of one kind: 4 sets × 360°/`step_deg` yaws × 2 objects; the same for the same seed.

    `offset`: tilts 15, 20, 25° and one drawn of them, yaw off the grid by up to 5°, true tilt and height a little off;
    two sets of a DIDSON with a drawn display law, two of drawn devices. `severe`: the same at severity 1.5, yaw on the
    grid. `mirror`: as `offset`, and the other object is the target's mirror image. `devices`: other beams and windows,
    and another device in each frame.
    """
    return list(iterate(seed, kind, step_deg))


def iterate(seed: int, kind: str, step_deg: float = 10.0) -> Iterator[JudgeFrame]:
    """`judge_frames` one at a time, target and other object in turn."""
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r}, expected one of: {', '.join(KINDS)}")
    if not 0 < step_deg <= 360:
        raise ValueError(f"step_deg must be in (0, 360], got {step_deg}")
    pair = _objects(kind)
    stream = KINDS.index(kind) * STREAMS
    for group in range(4):
        setup = _setup(kind, group, _rng(seed, stream + SET_STREAM + group))
        for number, yaw_deg in enumerate(np.repeat(np.arange(0, 360, step_deg), 2)):
            is_target = number % 2 == 0
            rng = _rng(seed, stream + group * (SET_STREAM // 4) + number)
            yield frame_of(setup, pair[0 if is_target else 1], is_target, float(yaw_deg), rng)


Triangles = tuple[np.ndarray, np.ndarray]
"""Vertices (vertex, 3) [m] and triangles (face, 3) of a surface."""


@dataclass(frozen=True)
class Setup:
    """What the frames of one set share."""

    group: int
    """Number of the set."""
    tilt_deg: float
    """Nominal tilt [°]."""
    sonar: Sonar
    """The nominal sonar."""
    device: Device | None
    """The device, or None where every frame draws its own."""
    on_grid: bool
    """True: yaws lie on the grid."""


def _setup(kind: str, group: int, rng: np.random.Generator) -> Setup:
    tilt_deg = (15.0, 20.0, 25.0, float(rng.choice(list(GROUND_RANGE_M))))[group]
    return Setup(group, tilt_deg, _sonar(kind, group, tilt_deg), _device(kind, group, rng), kind == "severe")


def frame_of(setup: Setup, shape: Triangles, is_target: bool, yaw_deg: float, rng: np.random.Generator) -> JudgeFrame:
    """One object near one yaw of the grid, the rest drawn."""
    device = setup.device or Device.draw(rng)
    slack = rng.uniform(-1, 1, 5)
    away = GROUND_RANGE_M[setup.tilt_deg] + RANGE_SLACK_M * slack[0]
    bearing = math.radians(BEARING_SLACK_DEG * slack[1])
    yaw = math.radians(yaw_deg + (0.0 if setup.on_grid else YAW_SLACK_DEG * slack[2])) % (2 * math.pi)
    tilt_deg = setup.tilt_deg + TILT_SLACK_DEG * slack[3]
    height = HEIGHT_M + HEIGHT_SLACK_M * slack[4]
    x, y = away * math.cos(bearing), away * math.sin(bearing)
    view = View.of(setup.sonar, math.radians(tilt_deg), height, device.sound_speed_ratio, device.conical)
    hits = cast(place(*shape, x, y, yaw), view)
    image = store(hits, device, rng).astype(np.float32) / 255
    return JudgeFrame(image, labels(hits, device), is_target, yaw, x, y, tilt_deg, height, setup.sonar, setup.group)


def surface(mesh: Mesh) -> Triangles:
    """Vertices (vertex, 3) [m] and triangles (face, 3) of a mesh, without its padding."""
    faces = np.asarray(mesh.faces)
    return np.asarray(mesh.vertices, np.float64), faces[faces[:, 0] != faces[:, 1]]


def mirrored(triangles: Triangles) -> Triangles:
    """The mirror image in the plane y = 0, faces still seen from outside."""
    vertices, faces = triangles
    return vertices * [1.0, -1.0, 1.0], faces[:, ::-1]


def _objects(kind: str) -> tuple[Triangles, Triangles]:
    """Target, and what is not the target."""
    target = surface(objects.target())
    return target, mirrored(target) if kind == "mirror" else surface(objects.non_target())


def _sonar(kind: str, group: int, tilt_deg: float) -> Sonar:
    """The nominal sonar of a set."""
    preset, near, far, bins = ("didson-hf", 1.5, 4.0, 512)
    if kind == "devices":
        preset, near, far, bins = OTHER_SONARS[group]
    hung = {"tilt": math.radians(tilt_deg), "height": HEIGHT_M}
    return Sonar.preset(preset, range_min=near, range_max=far, n_ranges=bins, **hung)


OTHER_SONARS = (
    ("aris-3000", 1.4, 3.8, 600),
    ("aris-1800", 1.6, 4.2, 450),
    ("didson-hf", 1.25, 3.75, 384),
    ("aris-3000", 1.5, 4.5, 512),
)
"""Sonars of the kind `devices`, one for each set: preset (ARIS beams are uneven), window [m], range bins."""


def _device(kind: str, group: int, rng: np.random.Generator) -> Device | None:
    """The device of a set; None where every frame draws its own."""
    if kind == "devices":
        return None
    severity = 1.5 if kind == "severe" else 1.0
    if group < 2:
        return Device.nominal(severity).with_drawn_law(rng)
    return Device.draw(rng, severity)


def _rng(seed: int, number: int) -> np.random.Generator:
    """The generator of one frame or set: streams of different numbers are independent."""
    return np.random.Generator(np.random.Philox(key=[seed, number]))
