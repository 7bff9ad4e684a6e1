"""How well `refine_yaw` does on labels of §4.1's second version, beside the Cramér–Rao bound of the same frames.

python -m experiments.refine_accuracy [--smoke]: prints one row a case. Labels come from a converged render; where there
is noise, each label is replaced with that probability by a uniform draw of the three classes. Place is known to 2 cm.

The bound takes each label as one draw of the classes' shares of its pixel, mixed with the noise: a frame's information
on (yaw, x, y) is Σ over pixels and classes of ∇p ∇pᵀ / p. Clean labels are the largest share instead of a draw, so for
them a draw at 0.1 % noise is taken, which says more about the size to be expected than about a limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.bench_render import parse
from experiments.common.frames import GROUND_RANGE_M, sonar_for
from sonarjax.refine import refine_yaw
from sonarjax.render import Window, place_window, render_window, window_shape
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.objects import target
from sonarjax.sonar import Sonar

GREY = np.array([0.5, 1.0, 0.0], np.float32)
CASES = ((10.0, 0.0), (10.0, 0.08), (20.0, 0.0))  # largest start error [deg], probability that a label is replaced


@dataclass(frozen=True)
class Settings:
    """What is measured; every field is a command line option."""

    frames: int = 100
    """Frames at each of the three tilts."""
    position_m: float = 0.02
    """Largest error of the start in x and in y [m]."""
    sub_beams: int = 6
    """Quality of the renders that the labels and the bound are made of."""
    seed: int = 1
    """Seed of poses, noise and starts; 0 is the one that refinement's blurs and sharpness were chosen on."""
    smoke: bool = False
    """A run of seconds: 4 frames at each tilt."""


@partial(jax.jit, static_argnames=("shape", "sub_beams"))
def shares(mesh: Mesh, sonar: Sonar, pose: jax.Array, corner: Any, shape: tuple[int, int], sub_beams: int) -> jax.Array:
    """Shares (class, range, beam) of background, highlight and shadow at `pose` = (yaw, x, y)."""
    window = Window(corner[0], corner[1], shape)
    layers = render_window(mesh, Pose(pose[1], pose[2], pose[0]), sonar, window, sub_beams, 64)
    h, s = layers.highlight, layers.shadow
    return jnp.stack([(1 - h) * (1 - s), h, s * (1 - h)])


@partial(jax.jit, static_argnames=("shape", "sub_beams"))
def bounds(
    mesh: Mesh, sonar: Sonar, poses: jax.Array, corners: Any, noise: Any, shape: tuple[int, int], sub_beams: int
) -> jax.Array:
    """Least standard deviation of yaw (frame,) [rad] of any unbiased estimate, for poses (frame, 3)."""

    def one(args: tuple[jax.Array, Any]) -> jax.Array:
        pose, corner = args
        draw = partial(shares, mesh, sonar, corner=corner, shape=shape, sub_beams=sub_beams)
        mixed = (1 - noise) * draw(pose) + noise / 3
        slope = (1 - noise) * jax.jacfwd(draw)(pose)
        information = jnp.einsum("crbi,crbj,crb->ij", slope, slope, 1 / jnp.maximum(mixed, 1e-6))
        return jnp.sqrt(jnp.linalg.inv(information)[0, 0])

    return jax.lax.map(one, (poses, corners))


def measure(tilt_deg: float, start_deg: float, noise: float, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Yaw errors (frame,) and bounds (frame,), both in degrees, at one tilt."""
    rng = np.random.default_rng([settings.seed, int(tilt_deg)])
    count, reach = settings.frames, settings.position_m
    mesh, sonar, away = target(), sonar_for(tilt_deg), GROUND_RANGE_M[tilt_deg]
    low, high = [0.0, away - 0.02, -0.15], [2 * math.pi, away + 0.02, 0.15]
    poses = rng.uniform(low, high, (count, 3)).astype(np.float32)
    whole = partial(shares, mesh, sonar, corner=(0, 0), shape=sonar.shape, sub_beams=settings.sub_beams)
    labels = np.asarray(jax.jit(lambda p: jax.lax.map(lambda q: jnp.argmax(whole(q), 0), p))(poses))
    replaced = rng.random(labels.shape) < noise
    labels = np.where(replaced, rng.integers(0, 3, labels.shape), labels)
    off = rng.uniform(-1, 1, (count, 3)) * [math.radians(start_deg), reach, reach]
    yaw, x, y = (poses + off).astype(np.float32).T
    found = np.asarray(refine_yaw(GREY[labels], mesh, sonar, Pose(x, y, yaw)).yaw)
    error = np.degrees(np.abs((found - poses[:, 0] + np.pi) % (2 * np.pi) - np.pi))
    shape = window_shape(mesh, sonar, away, 0.05)
    windows = [place_window(shape, mesh, sonar, float(p[1]), float(p[2])) for p in poses]
    corners = tuple(jnp.asarray([int(v) for v in values]) for values in zip(*(w[:2] for w in windows), strict=True))
    bound = bounds(mesh, sonar, poses, corners, max(noise, 1e-3), shape, settings.sub_beams)
    return error, np.degrees(np.asarray(bound))


def run(settings: Settings) -> list[dict[str, float]]:
    """One row for each case, over all tilts."""
    if settings.smoke:
        settings = Settings(frames=4, seed=settings.seed, smoke=True)
    rows = []
    for start_deg, noise in CASES:
        parts = [measure(tilt, start_deg, noise, settings) for tilt in GROUND_RANGE_M]
        error, bound = (np.concatenate(v) for v in zip(*parts, strict=True))
        rms, least = math.sqrt((error**2).mean()), math.sqrt((bound**2).mean())
        rows.append(
            {
                "start_deg": start_deg,
                "noise": noise,
                "frames": len(error),
                "within_1_deg": float((error <= 1).mean()),
                "median_deg": float(np.median(error)),
                "p95_deg": float(np.percentile(error, 95)),
                "rms_deg": rms,
                "cramer_rao_deg": least,
            }
        )
    return rows


def table(rows: list[dict[str, float]]) -> str:
    """The rows as text."""
    lines = ["  start   noise  frames  within 1°   median   95 %    RMS   Cramér–Rao  ratio"]
    for r in rows:
        lines.append(
            f"±{r['start_deg']:4.0f}°  {100 * r['noise']:4.0f} %  {r['frames']:6d}  {r['within_1_deg']:9.3f}"
            f"  {r['median_deg']:6.3f}°  {r['p95_deg']:4.2f}°  {r['rms_deg']:5.3f}°  {r['cramer_rao_deg']:9.3f}°"
            f"  {r['rms_deg'] / r['cramer_rao_deg']:5.2f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(run(parse(Settings, __doc__))))
