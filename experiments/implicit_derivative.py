"""Is the derivative of a refined pose right? Compared with solving slightly changed problems again.

python -m experiments.implicit_derivative [--preset smoke] [--help]

Yaw, x and y of a solution are differentiated by what it was found from: the tilt and the height of the sonar, where its
range window starts, a stretch of the object, and the image (towards that of a turned object). They are compared with
lines fitted to the solutions of slightly changed problems. Errors are divided by the RMS of their slopes over all
frames. `labels` are images of labels; `noise` are frames of the nominal sensor, fitted with a plain template.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job
from experiments.common.scores import target
from sonarjax.segment import to_grey
from sonarjax.sensor import SensorModel

STEPS = {"tilt": math.radians(1.0), "height": 0.02, "range": 0.01, "stretch": 0.04, "image": 0.5}
"""Perturbations: tilt [rad], height and start of the range window [m], stretch of the object and share of the image."""
SHARES = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)
"""Of these steps, to which a line is fitted: a solution falls into one rough spot of its objective or another."""
OUTPUTS = ("yaw", "x", "y")
TURNED = math.radians(2.0)
LEAST = 0.1
"""Derivatives whose effect is below this share of the largest effect on the same number are listed, but not counted."""


@dataclass(frozen=True)
class Settings:
    """Which frames, and how they are refined."""

    frames: int = 16
    """Frames of each kind."""
    kinds: tuple[str, ...] = ("labels", "noise")
    """Of `labels` and `noise`."""
    label_blur: float = 0.8
    """Standard deviation of the last blur on labels [range bins]."""
    noise_blur: float = 2.0
    """The same on noisy frames, whose objective is rough at the scale of a pixel."""
    polish: int = 24
    """Renders that polish a solution, at most."""
    tilt_deg: float = 20.0
    """Tilt of the sonar [deg]."""


def config_of(settings: Settings, kind: str) -> sj.RefineConfig:
    """How frames of a kind are refined."""
    blur = settings.label_blur if kind == "labels" else settings.noise_blur
    config = sj.RefineConfig(blurs=(2 * blur, blur), polish=settings.polish)
    return config if kind == "labels" else replace(config, sharpness=0.0, margin=(12, 3))


def draw_frame(kind: str, tilt_deg: float, key: jax.Array) -> tuple[jax.Array, jax.Array, sj.Pose]:
    """A frame (range, beam), the same of the object turned by TURNED, and a pose near the truth."""
    sonar = sonar_for(tilt_deg)
    place, noise, off = jax.random.split(key, 3)
    yaw, x, y = jax.random.uniform(place, (3,), minval=jnp.array([0, -0.1, -0.1]), maxval=jnp.array([6.28, 0.1, 0.1]))
    x += GROUND_RANGE_M[tilt_deg]
    turned, moved, aside = jax.random.uniform(off, (3,), minval=-1.0) * jnp.array([0.05, 0.01, 0.01])
    images = []
    for angle in (yaw, yaw + TURNED):
        pose = sj.Pose(x, y, angle)
        if kind == "labels":
            images.append(jnp.asarray(to_grey(np.asarray(sj.render(target(), pose, sonar).labels()))))
        else:
            images.append(observed(target(), pose, sonar, SensorModel.nominal(), key=noise)[0])
    return images[0], images[1], sj.Pose(x + moved, y + aside, yaw + turned)


@partial(jax.jit, static_argnames=("config", "window"))
def solve(
    q: jax.Array, image: jax.Array, other: jax.Array, start: sj.Pose, tilt_deg: float, config: sj.RefineConfig,
    window: sj.WindowSize,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """(yaw, x, y) and whether it is determined, with everything moved by `q`, in the order of STEPS."""
    mesh, sonar = target(), sonar_for(20.0)
    height, near = sonar.height + q[1], sonar.range_min + q[2]
    sonar = sonar.replace(
        tilt=jnp.radians(tilt_deg) + q[0], height=height, range_min=near, range_max=sonar.range_max + q[2]
    )
    mesh = mesh.with_vertices(mesh.vertices * (1 + q[3]))
    seen = image + q[4] * (other - image)
    found = sj.refine_yaw(seen, mesh, sonar, start, config=config, window=window)
    return jnp.stack([found.yaw, found.x, found.y]), found.determined


@partial(jax.jit, static_argnames=("config", "window"))
def slopes(q: jax.Array, *given: Any, config: sj.RefineConfig, window: sj.WindowSize) -> jax.Array:
    """Derivatives (output, number) of `solve`, in reverse mode."""
    return jax.jacrev(lambda p: solve(p, *given, config, window)[0])(q)


def check_frame(settings: Settings, kind: str, number: int, seed: int) -> dict[str, Any]:
    """Derivatives and differences (output, number) of one frame, in units of the STEPS; whether it is determined."""
    key = jax.random.fold_in(jax.random.key(seed), number)
    image, other, start = draw_frame(kind, settings.tilt_deg, key)
    config = config_of(settings, kind)
    window = sj.plan_refinement(
        target(), sonar_for(settings.tilt_deg), sj.Pose(GROUND_RANGE_M[settings.tilt_deg] - 0.2), config
    )
    steps = np.array(list(STEPS.values()), np.float32)
    given = image, other, start, settings.tilt_deg
    here, determined = solve(jnp.zeros(5), *given, config=config, window=window)
    if not bool(determined):
        return {"determined": False}
    ours = np.asarray(slopes(jnp.zeros(5), *given, config=config, window=window)) * steps
    # From the solution itself, so that all end in the same basin.
    given = image, other, sj.Pose(here[1], here[2], here[0]), settings.tilt_deg
    wanted = np.zeros_like(ours)
    for k, step in enumerate(steps):
        ends = [
            np.asarray(solve(jnp.zeros(5).at[k].set(share * step), *given, config=config, window=window)[0])
            for share in SHARES
        ]
        moved = np.stack(ends) - np.asarray(here)
        moved[:, 0] = (moved[:, 0] + math.pi) % (2 * math.pi) - math.pi  # yaw is in [0, 2 pi)
        wanted[:, k] = np.array(SHARES) @ moved / np.square(SHARES).sum()
    return {"determined": True, "ours": ours.tolist(), "wanted": wanted.tolist()}


def run(settings: Settings, job: Job) -> Report:
    """For each kind: how many solutions are determined, and the median error of each derivative over the RMS."""
    cases = {f"{kind} {k}": (kind, k) for kind in settings.kinds for k in range(settings.frames)}
    found = job.map(lambda case: check_frame(settings, *case, job.seed), cases, "derivatives")
    rows = []
    for kind in settings.kinds:
        of_kind = [found[name] for name, case in cases.items() if case[0] == kind]
        usable = [one for one in of_kind if one["determined"]]
        row: dict[str, Any] = {"kind": kind, "determined": len(usable) / len(of_kind), "frames": len(of_kind)}
        if usable:
            ours, wanted = (np.array([one[key] for one in usable]) for key in ("ours", "wanted"))
            rms = np.sqrt((wanted**2).mean(0))
            row |= {"error": np.median(np.abs(ours - wanted), 0) / rms, "effect": rms}
        rows.append(row)
    return {"rows": rows}


def table(report: Report) -> str:
    """A row for each kind and number: the error of each derivative, in brackets where the effect is small."""
    rows = []
    for row in report["rows"]:
        for k, number in enumerate(STEPS):
            cells = []
            for output in range(len(OUTPUTS)) if "error" in row else ():
                effect = row["effect"][output]
                cell = f"{row['error'][output][k]:.1%} of {effect[k]:.2g}"
                cells.append(cell if effect[k] >= LEAST * max(effect) else f"({cell})")
            rows.append([row["kind"], f"{row['determined']:.0%} of {row['frames']}", number, *cells])
    head = ("frames", "determined", "by", *OUTPUTS)
    note = f"in brackets: numbers that move it less than {LEAST:.0%} of what the strongest does, at the steps used"
    return f"{markdown(head, rows)}\n\n{note}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"frames": 1, "kinds": ("labels",)})
