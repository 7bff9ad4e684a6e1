"""What does the loss look like that refinement descends, and is its derivative right?

python -m experiments.yaw_landscape [--preset smoke] [--help]

1 − NCC of the blurred images, as `refine_yaw` computes it, on labels and on the network's map. Over yaw and x around
the truth of one frame, for each blur, with the way that refinement takes; and along lines of yaw the derivative that it
follows, beside central differences of the same loss of a converged render.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TestFrame, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.yaw_basin import CONFIG, CONVERGED, SHARPNESS_OF, MapName, image_of, moved, target_frames
from sonarjax.refine import plan_refinement
from sonarjax.refine.objective import ROW_STRIDE, Blur, make_blur, normalised
from sonarjax.refine.pose import SLACK_M
from sonarjax.refine.template import VIEWS, Subject, draw, nominal_law
from sonarjax.render import place_window

LINE_STEP_DEG = 0.25  # so that central differences span half a degree, about the longest step of gradient_check
SHOWN_TILT_DEG = 20.0
STARTS = np.array([(yaw, x) for yaw in (-30.0, -12.0, 12.0, 30.0) for x in (-0.08, 0.08)])  # off the truth [deg, m]
CHUNK = 64
CLEAR = 0.2  # of the RMS: smaller derivatives have no sign to speak of
HEADS = {
    "derivatives": {
        "map": "map", "blur": "blur [bins]", "error": "RMS error / RMS derivative", "sign": "sign right",
        "own_error": "error to differences of its own render",
    },
    "paths": {
        "map": "map", "start_deg": "start: yaw off by [°]", "start_m": "x off by [m]", "end_deg": "end: yaw off by [°]",
        "end_m": "x off by [m]",
    },
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    maps: tuple[MapName, ...] = ("labels", "pix2pix")
    """What is refined on."""
    frames: int = 8
    """Frames whose derivative is checked; the landscape is of the first one at 20° of tilt."""
    line_deg: float = 10.0
    """Reach of the lines of yaw on either side of the truth [deg]."""
    reach_deg: float = 40.0
    """Reach of the landscape in yaw [deg]."""
    reach_m: float = 0.12
    """Reach of the landscape in x [m]."""
    grid: int = 41
    """Points of the landscape in yaw and in x."""


def run(settings: Settings, job: Job) -> Report:
    """Rows of the derivatives and of the paths' ends; `derivatives.npz` and a `landscape_*.npz` a map."""
    frames = sorted(target_frames(job.seed, 180), key=lambda frame: frame.tilt_deg != SHOWN_TILT_DEG)
    shown = frames[0]
    lines = job.map(lambda name: _line(name, frames[: settings.frames], settings), settings.maps, "derivatives")
    rows, arrays = [], {}
    for name, parts in lines.items():
        values = {key: np.array(v, float) for key, v in parts.items()}
        arrays |= {f"{name}_{key}": v for key, v in values.items()}
        rows += [
            {"map": name} | row for row in summary_of(*(values[key] for key in ("derivative", "differences", "own")))
        ]
    job.arrays("derivatives", yaw_deg=line_deg(settings)[1:-1], blur=CONFIG.blurs, **arrays)
    paths = []
    for name, parts in job.map(lambda name: _landscape(name, shown, settings), settings.maps, "landscape").items():
        values = {key: np.array(v, float) for key, v in parts.items()}
        job.arrays(f"landscape_{name}", blur=CONFIG.blurs, image=image_of(name, shown), **values)
        for start, end in zip(parts["path"][0], parts["end"], strict=True):
            ends = zip(("start_deg", "start_m", "end_deg", "end_m"), (*start, *end), strict=True)
            paths.append({"map": name, **dict(ends)})
    return {"derivatives": rows, "paths": paths}


# ---------------------------------------------------------------- the loss and its derivative


def loss(image: jax.Array, blur: Blur, drawn: jax.Array) -> jax.Array:
    """What the solver minimises for a template (range, beam): 1 − NCC of the blurred images."""
    weight = jnp.ones(image.shape)[::ROW_STRIDE]
    seen, fitted = (normalised(blur(v), weight) for v in (image, drawn))
    return 1 - (seen * fitted).sum()


def losses_at(
    image: Any, frame: TestFrame, sharpness: float, steps: np.ndarray, quality: sj.RenderQuality
) -> list[np.ndarray]:
    """Loss (step, blur) `steps` (step, 3) = yaw [rad], x, y [m] off the truth, and its derivative by yaw [1/rad]."""
    mesh, sonar, at = target(), sonar_for(frame.tilt_deg), moved(frame)
    size = plan_refinement(mesh, sonar, at, CONFIG)  # the window is refine_yaw's own
    window = place_window(size, mesh, sonar, at.x, at.y, SLACK_M)
    part = jax.lax.dynamic_slice(jnp.asarray(image, jnp.float32), (window.row, window.column), size.shape)
    subject = Subject(
        mesh, sonar, at, window, jnp.float32(sharpness), jnp.int32(VIEWS["semantic"]), nominal_law(), quality
    )
    # In parts of one size, the last filled up: lines and landscapes share compiled code.
    filled = np.resize(steps, (-(-len(steps) // CHUNK) * CHUNK, 3)).astype(np.float32)
    found = [_losses(part, subject, few) for few in filled.reshape(-1, CHUNK, 3)]
    return [np.concatenate(values)[: len(steps)].astype(float) for values in zip(*found, strict=True)]


@jax.jit
def _losses(part: Any, subject: Subject, steps: Any) -> Any:
    blurs = [make_blur(part.shape, sigma) for sigma in CONFIG.blurs]
    by_yaw = jnp.array([1.0, 0.0, 0.0, 0.0])

    def one(step: jax.Array) -> tuple[jax.Array, ...]:
        # The fourth number is the energy of a bounce, which only the echo has.
        drawn, slope = jax.jvp(partial(draw, subject), (jnp.append(step, 0.0),), (by_yaw,))
        pairs = [jax.jvp(partial(loss, part, blur), (drawn,), (slope,)) for blur in blurs]
        return tuple(jnp.stack(v) for v in zip(*pairs, strict=True))

    return jax.lax.map(one, steps)


def line_deg(settings: Settings) -> np.ndarray:
    """The points of a line [deg], with one more at each end for the differences."""
    half = round(settings.line_deg / LINE_STEP_DEG) + 1
    return np.arange(-half, half + 1) * LINE_STEP_DEG


def _line(name: MapName, frames: Sequence[TestFrame], settings: Settings) -> dict[str, np.ndarray]:
    """Loss and derivatives [1/rad] (frame, point, blur) along a line of yaw, at refinement's quality and converged."""
    steps = np.radians(line_deg(settings))[:, None] * [1.0, 0.0, 0.0]
    parts = []
    for frame in frames:
        values_at = partial(losses_at, image_of(name, frame), frame, SHARPNESS_OF[name], steps)
        (own, derivative), (finer, _) = values_at(CONFIG.quality), values_at(CONVERGED)
        parts.append((own[1:-1], finer[1:-1], derivative[1:-1], central(finer), central(own)))
    keys = ("loss", "converged_loss", "derivative", "differences", "own")
    return {key: np.stack(values) for key, values in zip(keys, zip(*parts, strict=True), strict=True)}


def central(values: np.ndarray) -> np.ndarray:
    """Central differences [1/rad] of values (point, blur) along a line, but for its ends."""
    return (values[2:] - values[:-2]) / math.radians(2 * LINE_STEP_DEG)


def summary_of(ours: np.ndarray, finer: np.ndarray, own: np.ndarray) -> list[dict[str, float]]:
    """A row for each blur, of derivatives and differences (frame, point, blur): errors as shares of the RMS."""
    rows = []
    for k, blur in enumerate(CONFIG.blurs):
        rms = math.sqrt((finer[..., k] ** 2).mean())
        clear = np.abs(finer[..., k]) > CLEAR * rms
        error, own_error = (math.sqrt(((ours[..., k] - other[..., k]) ** 2).mean()) / rms for other in (finer, own))
        sign = float((ours[..., k] * finer[..., k] > 0)[clear].mean())
        rows.append({"blur": blur, "error": error, "sign": sign, "own_error": own_error})
    return rows


# ---------------------------------------------------------------- the landscape and ways through it


def _landscape(name: MapName, frame: TestFrame, settings: Settings) -> dict[str, Any]:
    """Loss (yaw, x, blur); paths (step, start, 2) of yaw [deg] and x [m] off the truth; where refine_yaw ends."""
    image, count = image_of(name, frame), settings.grid
    yaws, xs = (np.linspace(-reach, reach, count) for reach in (settings.reach_deg, settings.reach_m))
    steps = np.stack(np.meshgrid(np.radians(yaws), xs, 0.0, indexing="ij"), axis=-1).reshape(-1, 3)
    values, _ = losses_at(image, frame, SHARPNESS_OF[name], steps, CONFIG.quality)
    config = replace(CONFIG, sharpness=SHARPNESS_OF[name])
    refine = partial(sj.refine_yaw, image, target(), sonar_for(frame.tilt_deg), engine=engine())
    way = [moved(frame, *STARTS.T)]
    for blur in (blur for blur in CONFIG.blurs for _ in range(CONFIG.iterations)):
        # Step by step; none that makes it worse.
        way.append(refine(way[-1], config=replace(config, blurs=(blur,), iterations=1)).pose)
    path = np.stack([_off(frame, pose) for pose in way])
    return {
        "yaw_deg": yaws, "x_m": xs, "loss": values.reshape(count, count, -1), "path": path,
        "end": _off(frame, refine(way[0], config=config).pose), "true_yaw_deg": math.degrees(frame.yaw),
    }  # fmt: skip


def _off(frame: TestFrame, pose: sj.Pose) -> np.ndarray:
    """Yaw [deg] and x [m] of poses (start,) from the truth: (start, 2)."""
    turn = (np.degrees(np.asarray(pose.yaw) - frame.yaw) + 180.0) % 360.0 - 180.0
    return np.stack([turn, np.asarray(pose.x) - GROUND_RANGE_M[frame.tilt_deg]], axis=1)


def table(report: Report) -> str:
    """Derivatives and paths as two tables."""
    return "\n\n".join(columns(report[key], heads) for key, heads in HEADS.items())


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"maps": ("labels",), "frames": 1, "line_deg": 2.0, "grid": 5})
