"""How hard are the sensor model's frames? Correlation of unsegmented frames of §4.1 with their own template (Table 4).

python -m experiments.calibrate_sensor [--preset smoke] [--help]

The mean normalised cross-correlation (eq. 4) by set, of validation frames, for the template of the true yaw bin
and for wrong ones, beside the paper's Table 4. The constants of `SensorModel` are set by these correlations alone:
accuracy, thresholds and test frames play no part. Wrong templates are the target's at quarter turns from the truth, as
in Table 4, and all of those 30° or more from it; the non-target's frames are matched with the target's whole bank.
Leaves a picture of one frame of each set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, VALIDATION_SEED, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.paper import TABLE_4
from experiments.common.runs import Job
from experiments.common.tables import off_diagonal
from sonarjax.io import write_png
from sonarjax.sensor import SensorModel

BINS = 36
SLACK = (6, 2)  # (bins, beams) around the templates' box that the template may slide over


COLUMNS = {
    "own": "own template",
    "quarter": "quarter turns",
    "wrong": "other yaws",
    "other": "non-target",
}
"""Correlations (frame,): of target frames with the template of their own yaw bin, the best of those at 90, 180 and
270° to it, the best of those at 30° to it or more; of non-target frames with the best of the target's templates."""


@dataclass(frozen=True)
class Settings:
    """What is measured, on the validation draw of §4.1."""

    severity: float = 1.0
    """Severity of the sensor model [1]."""
    step_deg: int = 10
    """Yaw step of each set [deg]."""
    yaw_offset_deg: float = 0.0
    """Uniform offset of each yaw within ± this [deg]."""
    drawn: bool = False
    """Draw another device of the family for every frame instead of the nominal one."""


def _frame(mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, settings: Settings, *, key: jax.Array) -> jax.Array:
    draw, noise = jax.random.split(key)
    drawn = partial(SensorModel.draw, key=draw) if settings.drawn else SensorModel.nominal
    return observed(mesh, pose, sonar, drawn(severity=settings.severity), key=noise)[0]


def measure(tilt_deg: float, settings: Settings, *, key: jax.Array) -> tuple[dict[str, list[float]], np.ndarray]:
    """Correlations by name of one set at `tilt_deg` [deg], and its first target frame (range, beam)."""
    sonar, x = sonar_for(tilt_deg), GROUND_RANGE_M[tilt_deg]
    yaws = np.arange(BINS) * 2 * math.pi / BINS
    bank = sj.template_bank(sj.objects.target(), sonar, yaws, x=x, engine=engine())
    box = _box(bank, sonar)
    found: dict[str, list[float]] = {name: [] for name in (*COLUMNS, "right_bin")}
    first = np.zeros(0)
    for is_target, mesh in ((True, sj.objects.target()), (False, sj.objects.non_target())):
        for yaw_deg in tqdm(range(0, 360, settings.step_deg), desc=f"{tilt_deg:g}°", leave=False):
            part = jax.random.fold_in(key, yaw_deg * 2 + is_target)
            offset = settings.yaw_offset_deg * float(jax.random.uniform(part, minval=-1.0, maxval=1.0))
            pose = sj.Pose(x, 0.0, math.radians(yaw_deg + offset))
            image = _frame(mesh, pose, sonar, settings, key=jax.random.fold_in(part, 1))
            first = first if first.size else np.asarray(image)
            scores = np.asarray(sj.match_bank(image[box], bank))
            _collect(found, scores, is_target, round(yaw_deg * BINS / 360) % BINS)
    return found, first


def _collect(found: dict[str, list[float]], scores: np.ndarray, is_target: bool, own: int) -> None:
    if not is_target:
        found["other"].append(float(scores.max()))
        return
    found["own"].append(float(scores[own]))
    turned = np.roll(scores, -own)
    found["quarter"].append(float(turned[BINS // 4 :: BINS // 4].max()))
    found["wrong"].append(float(turned[BINS // 12 : -BINS // 12 + 1].max()))
    found["right_bin"].append(float(scores.argmax() == own))


def _box(bank: sj.TemplateBank, sonar: sj.Sonar) -> tuple[slice, slice]:
    """The templates' box in the frame, with slack around it."""
    sizes = zip(np.asarray(bank.offset).tolist(), bank.templates.shape[1:], SLACK, sonar.shape, strict=True)
    rows, columns = (slice(max(start - slack, 0), min(start + size + slack, end)) for start, size, slack, end in sizes)
    return rows, columns


def run(settings: Settings, job: Job) -> Report:
    """Correlations of the four sets, and a row for each set and for all."""
    key = jax.random.key(VALIDATION_SEED + job.seed)
    drawn = TILTS_DEG[int(jax.random.randint(jax.random.fold_in(key, 10**6), (), 0, len(TILTS_DEG)))]
    sets = {f"{tilt:g}°": (number, tilt) for number, tilt in enumerate(TILTS_DEG)}
    sets["drawn"] = (len(TILTS_DEG), drawn)

    def part(case: tuple[int, float]) -> dict[str, list[float]]:
        found, picture = measure(case[1], settings, key=jax.random.fold_in(key, case[0]))
        write_png(job.folder / f"set_{case[0]}.png", picture[::-1, ::-1])
        return found

    found = job.map(part, sets, "sets")
    whole = {name: [v for values in found.values() for v in values[name]] for name in (*COLUMNS, "right_bin")}
    tilts = {name: tilt for name, (_, tilt) in sets.items()}
    rows = [
        {"set": name, "tilt_deg": tilts.get(name)} | _summary(values)
        for name, values in (found | {"all": whole}).items()
    ]
    return {"rows": rows, "correlations": found}


def _summary(found: dict[str, list[float]]) -> dict[str, Any]:
    """Mean, least and largest correlation by name, and how often a target frame's best template is its own."""
    ends = {name: [float(np.mean(found[name])), min(found[name]), max(found[name])] for name in COLUMNS}
    return ends | {"right_bin": float(np.mean(found["right_bin"]))}  # shown, never tuned


def table(report: Report) -> str:
    """The sets, their mean and the paper's Table 4: means, and ranges in parentheses."""
    own, wrong = np.diag(TABLE_4), off_diagonal(TABLE_4).max()
    rows = [
        [row["set"], row["tilt_deg"], *(_range(*row[name]) for name in COLUMNS), f"{row['right_bin']:.2f}"]
        for row in report["rows"]
    ]
    paper = ["paper, Table 4", None, _range(own.mean(), own.min(), own.max()), f"at most {wrong:.3f}", None, None, None]
    return markdown(("set", "tilt [°]", *COLUMNS.values(), "own bin is best"), [*rows, paper])


def _range(mean: float, least: float, largest: float) -> str:
    return f"{mean:.3f} ({least:.3f}–{largest:.3f})"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"step_deg": 360})
