"""How hard the sensor model's frames are: correlation of unsegmented frames of §4.1 with their own template (Table 4).

python -m experiments.calibrate_sensor [--severity 1] [--help]

Prints the mean normalised cross-correlation (eq. 4) by set, of validation frames, for the template of the true yaw bin
and for wrong ones, beside the paper's Table 4. The constants of `SensorModel` are set by these correlations alone:
accuracy, thresholds and test frames play no part. Wrong templates are the target's at quarter turns from the truth, as
in Table 4, and all of those 30° or more from it; the non-target's frames are matched with the target's whole bank.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import GROUND_RANGE_M, TILTS_DEG, sonar_for
from experiments.fit_threshold import VALIDATION_SEED
from sonarjax.sensor import SensorModel, observe_scene

PAPER_OWN = (0.5972, 0.6446, 0.4726, 0.5735)
"""Table 4: correlation of the target's frames at 0, 90, 180 and 270° with their own template."""
PAPER_WRONG = 0.4709
"""Table 4: the largest correlation with the template of another yaw."""
BINS = 36
SLACK = (6, 2)  # (bins, beams) around the templates' box that the template may slide over


@dataclass(frozen=True)
class Settings:
    """What is measured; every field is a command line option."""

    seed: int = VALIDATION_SEED
    """Root seed of the frames: the validation draw of §4.1, not the test's."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""
    step_deg: int = 10
    """Yaw step of each set [deg]."""
    yaw_offset_deg: float = 0.0
    """Uniform offset of each yaw within ± this [deg]."""
    drawn: bool = False
    """Draw another device of the family for every frame instead of the nominal one."""
    pictures: str = ""
    """PNG file with one frame of each tilt, near range at the bottom; none by default."""


class Correlations(NamedTuple):
    """Correlations of one set's frames."""

    own: np.ndarray
    """Target frames with the template of their own yaw bin (frame,)."""
    quarter: np.ndarray
    """Target frames with the best of those at 90, 180 and 270° to it (frame,)."""
    wrong: np.ndarray
    """Target frames with the best of those at 30° to it or more (frame,)."""
    other: np.ndarray
    """Non-target frames with the best of the target's templates (frame,)."""
    right_bin: np.ndarray
    """Whether the best of a target frame's templates is its own (frame,): shown, never tuned."""


@partial(jax.jit, static_argnames="drawn")
def _observed(
    mesh: sj.Mesh, pose: sj.Pose, sonar: sj.Sonar, severity: jax.Array, drawn: bool, *, key: jax.Array
) -> jax.Array:
    draw, noise = jax.random.split(key)
    model = SensorModel.draw(key=draw, severity=severity) if drawn else SensorModel.nominal(severity)
    return observe_scene(mesh, pose, sonar, model, key=noise)[0]


def measure(tilt_deg: float, settings: Settings, *, key: jax.Array) -> tuple[Correlations, np.ndarray]:
    """Correlations of one set at `tilt_deg` [deg], and its first target frame (range, beam)."""
    sonar, x = sonar_for(tilt_deg), GROUND_RANGE_M[tilt_deg]
    yaws = np.arange(BINS) * 2 * math.pi / BINS
    bank = sj.template_bank(sj.objects.target(), sonar, yaws, x=x)
    box = _box(bank, sonar)
    found: dict[str, list[float]] = {name: [] for name in Correlations._fields}
    first = np.zeros(0)
    for is_target, mesh in ((True, sj.objects.target()), (False, sj.objects.non_target())):
        for yaw_deg in tqdm(range(0, 360, settings.step_deg), desc=f"{tilt_deg:g}°", leave=False):
            part = jax.random.fold_in(key, yaw_deg * 2 + is_target)
            offset = settings.yaw_offset_deg * float(jax.random.uniform(part, minval=-1.0, maxval=1.0))
            pose = sj.Pose(*(jnp.float32(v) for v in (x, 0.0, math.radians(yaw_deg + offset))))
            image = _observed(mesh, pose, sonar, settings.severity, settings.drawn, key=jax.random.fold_in(part, 1))
            first = first if first.size else np.asarray(image)
            scores = np.asarray(sj.match_bank(image[box], bank))
            _collect(found, scores, is_target, round(yaw_deg * BINS / 360) % BINS)
    return Correlations(**{name: np.array(values) for name, values in found.items()}), first


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
    sizes = zip(bank.offset, bank.templates.shape[1:], SLACK, sonar.shape, strict=True)
    rows, columns = (slice(max(start - slack, 0), min(start + size + slack, end)) for start, size, slack, end in sizes)
    return rows, columns


def table(rows: list[tuple[str, Correlations]]) -> str:
    """The sets, their mean and the paper's Table 4, as a table for the terminal."""
    whole = Correlations(*(np.concatenate(parts) for parts in zip(*(c for _, c in rows), strict=True)))
    lines = [
        "| set | own template | quarter turns | other yaws | non-target | own bin is best |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in [*rows, ("all", whole)]:
        cells = [f"{v.mean():.3f} ({v.min():.3f}–{v.max():.3f})" for v in found[:4]]
        lines.append(f"| {name} | {' | '.join(cells)} | {found.right_bin.mean():.2f} |")
    own = np.array(PAPER_OWN)
    lines.append(
        f"| paper, Table 4 | {own.mean():.3f} ({own.min():.3f}–{own.max():.3f}) | at most {PAPER_WRONG:.3f} | | | |"
    )
    return "\n".join(lines)


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(Settings):
        kind = {"action": "store_true"} if field.default is False else {"type": type(field.default)}
        parser.add_argument(f"--{field.name.replace('_', '-')}", default=field.default, **kind)
    settings = Settings(**vars(parser.parse_args()))
    key = jax.random.key(settings.seed)
    drawn = TILTS_DEG[int(jax.random.randint(jax.random.fold_in(key, 10**6), (), 0, len(TILTS_DEG)))]
    rows, pictures = [], []
    for number, tilt in enumerate((*TILTS_DEG, drawn)):
        found, picture = measure(tilt, settings, key=jax.random.fold_in(key, number))
        rows.append((f"{tilt:g}°" if number < len(TILTS_DEG) else f"{tilt:g}° (drawn)", found))
        pictures.append(picture[::-1, ::-1])
    print(table(rows))
    if settings.pictures:
        from sonarjax.io import write_png

        write_png(Path(settings.pictures), np.concatenate(pictures, axis=1))


if __name__ == "__main__":
    main()
