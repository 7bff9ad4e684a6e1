"""How fast refinement, its gradient and recognition are after compilation.

python -m experiments.bench_refine [--smoke]: prints one table; `run` returns its numbers. The frames are renders of the
paper's target (§4.1's geometry) at random yaws and places, finer than refinement's own, with noise over them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.bench_match import time_all
from experiments.bench_render import make_sonar, parse
from sonarjax import recognize
from sonarjax.refine import refine_yaw
from sonarjax.refine.yaw import SUB_BEAMS
from sonarjax.render import place_window, render, semantic_window, window_shape
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.objects import target
from sonarjax.sonar import Sonar

CONVERGED = 4  # sub-beams of the frames
DIDSON_FRAMES_PER_SECOND = 21.0


@dataclass(frozen=True)
class Settings:
    """What is timed; every field is a command line option."""

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
    seed: int = 0
    """Seed of poses and noise."""
    smoke: bool = False
    """A run of seconds: a batch of 4, 6 frames, two rounds."""


def make_frames(mesh: Mesh, sonar: Sonar, count: int, settings: Settings) -> tuple[np.ndarray, Pose]:
    """Semantic frames (frame, range, beam) with noise, and their poses (frame,)."""
    rng = np.random.default_rng(settings.seed)
    x, y, yaw = rng.uniform([2.2, -0.15, 0.0], [2.4, 0.15, 2 * math.pi], (count, 3)).astype(np.float32).T
    images = jax.jit(
        partial(jax.lax.map, lambda p: render(mesh, Pose(p[0], p[1], p[2]), sonar, sub_beams=CONVERGED).semantic())
    )(np.stack([x, y, yaw], 1))
    noisy = np.asarray(images) + settings.noise * rng.normal(size=images.shape)
    return np.clip(noisy, 0, 1).astype(np.float32), Pose(x, y, yaw)


def near(pose: Pose, settings: Settings, axes: tuple[int, ...]) -> Pose:
    """Starts within 10 degrees and 2 cm of `pose`."""
    rng = np.random.default_rng(settings.seed + 1)
    off = rng.uniform(-1, 1, (3, *axes)) * np.array([0.02, 0.02, math.radians(10)]).reshape(3, *(1,) * len(axes))
    return Pose(*(np.float32(v + d) for v, d in zip((pose.x, pose.y, pose.yaw), off, strict=True)))


def refinements(
    mesh: Mesh, sonar: Sonar, frames: np.ndarray, poses: Pose, settings: Settings
) -> dict[str, tuple[int, Callable[[], Any]]]:
    """Name -> (frames, function) of each way to call `refine_yaw`."""
    first = Pose(poses.x[0], poses.y[0], poses.yaw[0])
    found: dict[str, tuple[int, Callable[[], Any]]] = {}

    def add(name: str, count: int, image: np.ndarray, start: Pose) -> None:
        found[name] = count, lambda: jax.tree.map(np.asarray, refine_yaw(image, mesh, sonar, start))

    add("refine_yaw, one frame", 1, frames[0], near(first, settings, ()))
    if settings.hypotheses > 1:
        some = near(first, settings, (settings.hypotheses,))
        add(f"refine_yaw, one frame, {settings.hypotheses} starts", 1, frames[0], some)
    count = settings.batch
    batch = Pose(poses.x[:count], poses.y[:count], poses.yaw[:count])
    add(f"refine_yaw, batch of {count}", count, frames[:count], near(batch, settings, (count,)))
    return found


def loss_functions(mesh: Mesh, sonar: Sonar, frame: np.ndarray, pose: Pose) -> dict[str, Callable[[], np.ndarray]]:
    """The window's sum of squares against a frame, and its value and gradient by yaw, x and y."""
    x, y = float(pose.x), float(pose.y)
    shape = window_shape(mesh, sonar, math.hypot(x, y))
    window = place_window(shape, mesh, sonar, x, y)
    row, column = int(window.row), int(window.column)
    part = jnp.asarray(frame[row : row + shape[0], column : column + shape[1]])

    def loss(p: jax.Array) -> jax.Array:
        picture = semantic_window(mesh, Pose(p[1], p[2], p[0]), sonar, window, SUB_BEAMS, 64)
        return ((picture - part) ** 2).sum()

    at = jnp.asarray([float(pose.yaw) + 0.1, x + 0.01, y - 0.01], jnp.float32)
    forward, both = jax.jit(loss), jax.jit(jax.value_and_grad(loss))
    return {"forward": lambda: np.asarray(forward(at)), "value and gradient": lambda: np.asarray(both(at)[1])}


def recognition(mesh: Mesh, sonar: Sonar, frames: np.ndarray) -> tuple[float, list[float]]:
    """Seconds a frame of `recognize` without refinement once its banks are rendered, and the yaws of the bins [rad]."""

    def once() -> list[float]:
        return [recognize(f, mesh, sonar, segmenter="none", refine=False).yaw_bin for f in frames]

    once()
    start = time.perf_counter()
    yaws = once()
    return (time.perf_counter() - start) / len(frames), yaws


def angle(found: Any, truth: Any) -> np.ndarray:
    """Absolute differences of angles [deg]."""
    return np.degrees(np.abs((np.asarray(found) - np.asarray(truth) + np.pi) % (2 * np.pi) - np.pi))


def run(settings: Settings) -> dict[str, Any]:
    """Seconds of a call and of a frame, yaw errors [deg], the gradient's cost and the recognition's rate."""
    if settings.smoke:
        settings = replace(settings, batch=4, hypotheses=1, frames=6, repeats=2)
    mesh, sonar = target(), make_sonar()
    frames, poses = make_frames(mesh, sonar, max(settings.batch, settings.frames), settings)
    calls = refinements(mesh, sonar, frames, poses, settings)
    seconds, results = time_all({name: function for name, (_, function) in calls.items()}, settings.repeats)
    rows = []
    for name, (count, _) in calls.items():
        truth = poses.yaw[:count] if count > 1 else poses.yaw[0]
        error = angle(results[name].yaw, truth)
        rows.append(
            {
                "name": name,
                "frames": count,
                "seconds": seconds[name] / count,
                "median_error_deg": float(np.median(error)),
            }
        )
    losses = loss_functions(mesh, sonar, frames[0], Pose(poses.x[0], poses.y[0], poses.yaw[0]))
    cost, _ = time_all(losses, 5 * settings.repeats)
    each, yaws = recognition(mesh, sonar, frames[: settings.frames])
    return {
        "device": jax.devices()[0].platform,
        "rows": rows,
        "forward_seconds": cost["forward"],
        "gradient_seconds": cost["value and gradient"],
        "gradient_ratio": cost["value and gradient"] / cost["forward"],
        "recognize_seconds": each,
        "recognize_rate": 1 / each,
        "recognize_median_error_deg": float(np.median(angle(yaws, poses.yaw[: settings.frames]))),
    }


def table(report: dict[str, Any]) -> str:
    """The report as text, one line for each measurement."""
    lines = [f"{'what':<36} {'ms / frame':>11} {'yaw error [deg]':>16}   ({report['device']})"]
    for row in report["rows"]:
        lines.append(f"{row['name']:<36} {1e3 * row['seconds']:>11.2f} {row['median_error_deg']:>16.2f}")
    each = 1e3 * report["recognize_seconds"]
    lines += [
        f"{'recognize, no refinement':<36} {each:>11.2f} {report['recognize_median_error_deg']:>16.2f}"
        f"   {report['recognize_rate']:.1f} frames/s (DIDSON: {DIDSON_FRAMES_PER_SECOND:.0f})",
        f"{'loss of a window, forward':<36} {1e3 * report['forward_seconds']:>11.2f}",
        f"{'loss of a window, value + gradient':<36} {1e3 * report['gradient_seconds']:>11.2f}"
        f" {'':>16}   {report['gradient_ratio']:.2f} x the forward render",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(run(parse(Settings, __doc__))))
