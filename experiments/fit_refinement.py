"""How `recognize` should refine: yaw errors on validation frames (another seed than the test's) for several settings.

python -m experiments.fit_refinement [--segmenters "pix2pix; none"] [--step-deg 30]: one row a setting and segmenter,
best first; what stands in `sonarjax.recognize.REFINEMENT` is marked. Test frames and real frames play no part.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.bench_render import parse
from experiments.fit_threshold import VALIDATION_SEED
from experiments.frames import paper_frames, sonar_for
from experiments.segmenters import map_of
from sonarjax.recognize import REFINEMENT

BLURS = ((2.0, 0.8), (4.0, 1.5), (1.0, 0.5))
SHARPNESSES = (0.0, 10.0)
MARGINS = (REFINEMENT["margin"], None)


@dataclass(frozen=True)
class Settings:
    """What is compared; every field is an option of the command line."""

    segmenters: str = "pix2pix; none"
    """Segmenters, separated by semicolons."""
    step_deg: int = 30
    """Yaw step of the validation frames [deg]."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""


def errors(segmenter: str, settings: Settings) -> dict[tuple, np.ndarray]:
    """Yaw errors (frame,) [deg] of each setting (blurs, sharpness, margin), from where `recognize` starts refining."""
    frames = paper_frames(VALIDATION_SEED, yaw_offset_deg=5.0, step_deg=settings.step_deg, severity=settings.severity)
    mesh = sj.objects.target()
    found: dict[tuple, list[float]] = {key: [] for key in itertools.product(BLURS, SHARPNESSES, MARGINS)}
    for frame in tqdm([f for f in frames if f.is_target], desc=segmenter, unit="frame"):
        sonar, image = sonar_for(frame.tilt_deg), map_of(segmenter, frame)
        start = sj.recognize(image, mesh, sonar, segmenter="none", refine=False)
        pose = sj.Pose(start.x, start.y, start.yaw)
        for (blurs, sharpness, margin), values in found.items():
            changed = REFINEMENT | {"blurs": blurs, "sharpness": sharpness, "margin": margin}
            yaw = float(sj.refine_yaw(image, mesh, sonar, pose, **changed).yaw)
            values.append(abs(math.degrees(math.remainder(yaw - frame.yaw, 2 * math.pi))))
    return {key: np.array(values) for key, values in found.items()}


def main(settings: Settings) -> None:
    """Print one table a segmenter."""
    for segmenter in settings.segmenters.split("; "):
        rows = errors(segmenter, settings)
        print(f"{segmenter}: {len(next(iter(rows.values())))} frames; error of the refined yaw [deg]")
        for key in sorted(rows, key=lambda k: float(np.percentile(rows[k], 95))):
            values, (blurs, sharpness, margin) = rows[key], key
            used = dict(zip(("blurs", "sharpness", "margin"), key, strict=True)).items() <= REFINEMENT.items()
            print(f"  median {np.median(values):5.2f}  95 % {np.percentile(values, 95):5.2f}  blurs {blurs}  "
                  f"sharpness {sharpness:g}  margin {margin}{'  <- used' if used else ''}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(parse(Settings, __doc__))
