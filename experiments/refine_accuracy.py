"""How well does `refine_yaw` do on labels of §4.1's second version, beside the Cramér–Rao bound of the same frames?

python -m experiments.refine_accuracy [--preset smoke] [--help]

Labels come from a converged render; where there is noise, each label is replaced with that probability by a uniform
draw of the three classes. Place is known to 2 cm.

The bound takes each label as one draw of the classes' shares of its pixel, mixed with the noise: a frame's information
on (yaw, x, y) is Σ over pixels and classes of ∇p ∇pᵀ / p. Clean labels are the largest share instead of a draw, so for
them a draw at 0.1 % noise is taken, which says more about the size to be expected than about a limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, summary_deg, yaw_error_deg
from experiments.common.runs import Job
from sonarjax.refine import RefineConfig, refine_yaw
from sonarjax.render import RenderQuality, Window, place_window, plan_window, render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.objects import target
from sonarjax.segment import to_grey
from sonarjax.sonar import Sonar

CASES = ((10.0, 0.0), (10.0, 0.08), (20.0, 0.0))  # largest start error [deg], probability that a label is replaced
FIRST_SEED = 1  # 0 is the seed of the frames that refinement's blurs and sharpness were chosen on
HEADS = {
    "start_deg": "start within ± [°]",
    "noise": "labels replaced",
    "frames": "frames",
    "within_1": "within 1°",
    "median": "median [°]",
    "p95": "95 % [°]",
    "rms": "RMS [°]",
    "cramer_rao": "Cramér–Rao [°]",
    "ratio": "RMS / Cramér–Rao",
}


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    frames: int = 100
    """Frames at each tilt."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""
    position_m: float = 0.02
    """Largest error of the start in x and in y [m]."""
    sub_beams: int = 6
    """Quality of the renders that the labels and the bound are made of."""
    polish: int = 0
    """Further renders of `refine_yaw` at the last blur; 0 as `recognize` has it."""


def shares(mesh: Mesh, sonar: Sonar, pose: jax.Array, window: Window, sub_beams: int) -> jax.Array:
    """Shares (class, range, beam) of background, highlight and shadow at `pose` = (yaw, x, y)."""
    frame = render_window(mesh, Pose(pose[1], pose[2], pose[0]), sonar, window, RenderQuality(sub_beams))
    h, s = frame.highlight, frame.shadow
    return jnp.stack([(1 - h) * (1 - s), h, s * (1 - h)])


@partial(jax.jit, static_argnames="sub_beams")
def labels_at(mesh: Mesh, sonar: Sonar, poses: jax.Array, sub_beams: int) -> jax.Array:
    """The class (frame, range, beam) with the largest share at `poses` (frame, 3)."""

    def one(pose: jax.Array) -> jax.Array:
        return jnp.argmax(shares(mesh, sonar, pose, Window(0, 0, sonar.shape), sub_beams), 0)

    return jax.lax.map(one, poses)


@partial(jax.jit, static_argnames="sub_beams")
def bounds(mesh: Mesh, sonar: Sonar, poses: jax.Array, windows: Window, noise: Any, sub_beams: int) -> jax.Array:
    """Least standard deviation of yaw (frame,) [rad] of any unbiased estimate, for poses (frame, 3) and windows."""

    def one(args: tuple[jax.Array, Window]) -> jax.Array:
        pose, window = args
        draw = partial(shares, mesh, sonar, window=window, sub_beams=sub_beams)
        mixed = (1 - noise) * draw(pose) + noise / 3
        slope = (1 - noise) * jax.jacfwd(draw)(pose)
        information = jnp.einsum("crbi,crbj,crb->ij", slope, slope, 1 / jnp.maximum(mixed, 1e-6))
        return jnp.sqrt(jnp.linalg.inv(information)[0, 0])

    return jax.lax.map(one, (poses, windows))


def measure(settings: Settings, seed: int, case: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Yaw errors (frame,) and bounds (frame,) [deg] of one case: largest start error [deg], noise, tilt [deg]."""
    start_deg, noise, tilt_deg = case
    rng = np.random.default_rng([seed, int(tilt_deg)])
    count, reach = settings.frames, settings.position_m
    mesh, sonar, away = target(), sonar_for(tilt_deg), GROUND_RANGE_M[tilt_deg]
    low, high = [0.0, away - 0.02, -0.15], [2 * math.pi, away + 0.02, 0.15]
    poses = rng.uniform(low, high, (count, 3)).astype(np.float32)
    labels = np.asarray(labels_at(mesh, sonar, poses, settings.sub_beams))
    replaced = rng.random(labels.shape) < noise
    labels = np.where(replaced, rng.integers(0, 3, labels.shape), labels)
    off = rng.uniform(-1, 1, (count, 3)) * [math.radians(start_deg), reach, reach]
    yaw, x, y = (poses + off).astype(np.float32).T
    config = RefineConfig(polish=settings.polish)
    found = refine_yaw(to_grey(labels), mesh, sonar, Pose(x, y, yaw), config=config, engine=engine())
    error = yaw_error_deg(found.yaw, poses[:, 0])
    # The object may touch any of the window's beams: a pose is up to 15 cm aside.
    size = replace(plan_window(mesh, sonar, away, 0.05), object_columns=None)
    windows = place_window(size, mesh, sonar, poses[:, 1], poses[:, 2])
    bound = bounds(mesh, sonar, poses, windows, max(noise, 1e-3), settings.sub_beams)
    return error, np.degrees(np.asarray(bound))


def run(settings: Settings, job: Job) -> Report:
    """One row for each case, over all tilts."""
    parts = {
        f"start {start:g}, noise {noise:g}, tilt {tilt:g}": (start, noise, tilt)
        for start, noise in CASES
        for tilt in settings.tilts_deg
    }
    found = job.map(partial(measure, settings, FIRST_SEED + job.seed), parts, "refine")
    rows = []
    for case in CASES:
        errors, bounds = zip(*(found[name] for name, part in parts.items() if part[:2] == case), strict=True)
        rows.append(_row(case, np.concatenate(errors), np.concatenate(bounds)))
    return {"rows": rows}


def _row(case: tuple[float, float], errors: np.ndarray, bounds: np.ndarray) -> dict[str, Any]:
    summary, least = summary_deg(errors), math.sqrt((bounds**2).mean())
    facts = {"start_deg": case[0], "noise": case[1], "frames": len(errors)}
    return facts | summary | {"cramer_rao": least, "ratio": summary["rms"] / least}


def table(report: Report) -> str:
    """The rows as a table."""
    shown = [row | {"start_deg": f"{row['start_deg']:g}", "noise": f"{row['noise']:.0%}"} for row in report["rows"]]
    return columns(shown, HEADS)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"frames": 4, "tilts_deg": (20.0,), "sub_beams": 2})
