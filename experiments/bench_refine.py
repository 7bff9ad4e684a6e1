"""How fast are refinement, its gradient and recognition after compilation?

python -m experiments.bench_refine [--preset smoke] [--help]

The frames are renders of the paper's target (§4.1's geometry) at random yaws and places, finer than refinement's own,
with noise over them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.bench_match import time_all
from experiments.bench_render import make_sonar
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown, yaw_error_deg
from experiments.common.runs import Job
from sonarjax import Recognizer
from sonarjax.refine import RefineConfig, refine_yaw
from sonarjax.render import RenderQuality, WindowSize, place_window, plan_window, render, render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.objects import target
from sonarjax.sonar import Sonar

CONVERGED = RenderQuality(sub_beams=4)  # of the frames
CONFIG = RefineConfig(polish=0)  # without derivatives, as `recognize` refines
DIDSON_FRAMES_PER_SECOND = 21.0
SMOKE = {"batch": 4, "hypotheses": 1, "frames": 2, "repeats": 1}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    batch: int = 32
    """Frames of a batch, refined from one start each."""
    hypotheses: int = 3
    """Starts of one frame, as `recognize` gives them."""
    frames: int = 42
    """Frames recognized without refinement: two seconds of a DIDSON."""
    repeats: int = 9
    """Rounds; each times every contender once."""
    noise: float = 0.05
    """Standard deviation of the noise over the frames' grey values."""


def make_frames(mesh: Mesh, sonar: Sonar, count: int, noise: float, seed: int) -> tuple[np.ndarray, Pose]:
    """Semantic frames (frame, range, beam) with noise, and their poses (frame,)."""
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform([2.2, -0.15, 0.0], [2.4, 0.15, 2 * math.pi], (count, 3)).astype(np.float32).T
    images = np.stack(
        [render(mesh, Pose(*p), sonar, quality=CONVERGED).semantic() for p in zip(x, y, yaw, strict=True)]
    )
    noisy = images + noise * rng.normal(size=images.shape)
    return np.clip(noisy, 0, 1).astype(np.float32), Pose(x, y, yaw)


def near(pose: Pose, seed: int, axes: tuple[int, ...]) -> Pose:
    """Starts within 10 degrees and 2 cm of `pose`."""
    rng = np.random.default_rng(seed + 1)
    off = rng.uniform(-1, 1, (3, *axes)) * np.array([0.02, 0.02, math.radians(10)]).reshape(3, *(1,) * len(axes))
    return Pose(*(np.asarray(v) + d for v, d in zip((pose.x, pose.y, pose.yaw), off, strict=True)))


def refinements(
    mesh: Mesh, sonar: Sonar, frames: np.ndarray, poses: Pose, settings: Settings, seed: int
) -> dict[str, tuple[int, Callable[[], Any]]]:
    """Name -> (frames, function) of each way to call `refine_yaw`."""
    first = Pose(poses.x[0], poses.y[0], poses.yaw[0])
    found: dict[str, tuple[int, Callable[[], Any]]] = {}
    one = partial(refine_yaw, config=CONFIG, engine=engine())

    def add(name: str, count: int, image: np.ndarray, start: Pose) -> None:
        found[name] = count, lambda: jax.tree.map(np.asarray, one(image, mesh, sonar, start))

    add("refine_yaw, one frame", 1, frames[0], near(first, seed, ()))
    if settings.hypotheses > 1:
        some = near(first, seed, (settings.hypotheses,))
        add(f"refine_yaw, one frame, {settings.hypotheses} starts", 1, frames[0], some)
    count = settings.batch
    batch = Pose(poses.x[:count], poses.y[:count], poses.yaw[:count])
    add(f"refine_yaw, batch of {count}", count, frames[:count], near(batch, seed, (count,)))
    return found


def loss_functions(mesh: Mesh, sonar: Sonar, frame: np.ndarray, pose: Pose) -> dict[str, Callable[[], np.ndarray]]:
    """The window's sum of squares against a frame, and its value and gradient by yaw, x and y."""
    x, y = float(pose.x), float(pose.y)
    shape = plan_window(mesh, sonar, math.hypot(x, y)).shape
    window = place_window(WindowSize(shape), mesh, sonar, x, y)
    row, column = int(window.row), int(window.column)
    part = jnp.asarray(frame[row : row + shape[0], column : column + shape[1]])

    def loss(p: jax.Array) -> jax.Array:
        picture = render_window(mesh, Pose(p[1], p[2], p[0]), sonar, window, CONFIG.quality).semantic()
        return ((picture - part) ** 2).sum()

    at = jnp.asarray([float(pose.yaw) + 0.1, x + 0.01, y - 0.01], jnp.float32)
    forward, both = jax.jit(loss), jax.jit(jax.value_and_grad(loss))
    return {"forward": lambda: np.asarray(forward(at)), "value and gradient": lambda: np.asarray(both(at)[1])}


def recognition(mesh: Mesh, sonar: Sonar, frames: np.ndarray) -> tuple[float, list[float]]:
    """Seconds a frame of `recognize` without refinement once its banks are rendered, and the yaws of the bins [rad]."""

    recognizer = Recognizer(mesh, sonar, segmenter="none", refine=None, engine=engine())

    def once() -> list[float]:
        return [recognizer(frame).yaw_bin for frame in frames]

    once()
    start = time.perf_counter()
    yaws = once()
    return (time.perf_counter() - start) / len(frames), yaws


def run(settings: Settings, job: Job) -> Report:
    """Times a frame [ms], yaw errors [deg], the gradient's cost and the recognition's rate."""
    return job.map(lambda _: _measure(settings, job.seed), ["all"], "refine")["all"]


def _measure(settings: Settings, seed: int) -> Report:
    mesh, sonar = target(), make_sonar()
    frames, poses = make_frames(mesh, sonar, max(settings.batch, settings.frames), settings.noise, seed)
    calls = refinements(mesh, sonar, frames, poses, settings, seed)
    seconds, results = time_all({name: function for name, (_, function) in calls.items()}, settings.repeats)
    rows = []
    for name, (count, _) in calls.items():
        error = yaw_error_deg(results[name].yaw, poses.yaw[:count] if count > 1 else poses.yaw[0])
        rows.append(_row(name, seconds[name] / count, error))
    losses = loss_functions(mesh, sonar, frames[0], Pose(poses.x[0], poses.y[0], poses.yaw[0]))
    cost, _ = time_all(losses, 5 * settings.repeats)
    each, yaws = recognition(mesh, sonar, frames[: settings.frames])
    rows.append(_row("recognize, no refinement", each, yaw_error_deg(yaws, poses.yaw[: settings.frames])))
    rows += [_row(f"loss of a window, {name}", value) for name, value in cost.items()]
    return {
        "platform": jax.devices()[0].platform,
        "rows": rows,
        "gradient_ratio": cost["value and gradient"] / cost["forward"],
        "recognize_rate": 1 / each,
    }


def _row(name: str, seconds: float, error: np.ndarray | None = None) -> dict[str, Any]:
    median = None if error is None else float(np.median(error))
    return {"name": name, "milliseconds": 1e3 * seconds, "median_error_deg": median}


def table(report: Report) -> str:
    """One line for each measurement."""
    head = ("what", f"ms a frame ({report['platform']})", "median yaw error [°]")
    return "\n".join(
        [
            markdown(head, [list(row.values()) for row in report["rows"]]),
            f"\nvalue and gradient cost {report['gradient_ratio']:.2f} forward renders; recognized"
            f" {report['recognize_rate']:.1f} frames a second (a DIDSON sends {DIDSON_FRAMES_PER_SECOND:.0f})",
        ]
    )


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
