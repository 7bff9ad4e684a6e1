"""How `recognize` should refine: yaw errors on validation frames (another seed than the test's) for several settings.

Refined is on the segmenter's map, on the frame itself, or on the map and then on the frame.
python -m experiments.fit_refinement [--segmenters pix2pix,none] [--step-deg 30]: one row a setting and segmenter,
best first; what stands in `sonarjax.recognize.REFINEMENT` is marked. Test frames and real frames play no part.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.bench_render import parse
from experiments.common.frames import paper_frames, sonar_for
from experiments.common.segmenters import map_of
from experiments.fit_threshold import VALIDATION_SEED
from sonarjax.recognize import REFINED_AGAIN, REFINEMENT

BLURS = ((2.0, 0.8), (4.0, 1.5), (1.0, 0.5))
SHARPNESSES = (0.0, 10.0)
MARGINS = (REFINEMENT["margin"], None)


@dataclass(frozen=True)
class Settings:
    """What is compared; every field is an option of the command line."""

    segmenters: str = "pix2pix,none"
    """Segmenters, separated by commas."""
    step_deg: int = 30
    """Yaw step of the validation frames [deg]."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""


class Way(NamedTuple):
    """One way to refine."""

    on: str
    """`map`, `frame`, or `both`: the map first, as `REFINEMENT` has it, then the frame."""
    blurs: tuple[float, ...]
    sharpness: float
    margin: tuple[int, int] | None

    def is_used(self, segmenter: str) -> bool:
        """Whether `recognize` does so."""
        on = "frame" if segmenter == "none" else "both" if segmenter in REFINED_AGAIN else "map"
        used = REFINED_AGAIN.get(segmenter, REFINEMENT)
        return self.on == on and self._asdict().items() >= {name: used[name] for name in self._fields[1:]}.items()


def errors(segmenter: str, settings: Settings) -> dict[Way, np.ndarray]:
    """Yaw errors (frame,) [deg] of each way, from where `recognize` starts refining."""
    frames = paper_frames(VALIDATION_SEED, yaw_offset_deg=5.0, step_deg=settings.step_deg, severity=settings.severity)
    mesh = sj.objects.target()
    found: dict[Way, list[float]] = defaultdict(list)
    for frame in tqdm([f for f in frames if f.is_target], desc=segmenter, unit="frame"):
        sonar, semantic = sonar_for(frame.tilt_deg), map_of(segmenter, frame)
        start = sj.recognize(semantic, mesh, sonar, segmenter="none", refine=False)
        pose = sj.Pose(start.x, start.y, start.yaw)
        first = sj.refine_yaw(semantic, mesh, sonar, pose, **REFINEMENT).pose
        for setting in itertools.product(BLURS, SHARPNESSES, MARGINS):
            changed = REFINEMENT | dict(zip(Way._fields[1:], setting, strict=True))
            estimates = {"frame": sj.refine_yaw(frame.image, mesh, sonar, pose, **changed)}
            if segmenter != "none":
                estimates["map"] = sj.refine_yaw(semantic, mesh, sonar, pose, **changed)
                estimates["both"] = sj.refine_yaw(frame.image, mesh, sonar, first, **changed)
            for on, estimate in estimates.items():
                gap = math.remainder(float(estimate.yaw) - frame.yaw, 2 * math.pi)
                found[Way(on, *setting)].append(abs(math.degrees(gap)))
    return {way: np.array(values) for way, values in found.items()}


def main(settings: Settings) -> None:
    """Print one table a segmenter."""
    for segmenter in settings.segmenters.split(","):
        rows = errors(segmenter, settings)
        print(f"{segmenter}: {len(next(iter(rows.values())))} frames; error of the refined yaw [deg]")
        for way in sorted(rows, key=lambda way: float(np.percentile(rows[way], 95))):
            print(f"  median {np.median(rows[way]):5.2f}  95 % {np.percentile(rows[way], 95):5.2f}  on {way.on:<5}  "
                  f"blurs {way.blurs}  sharpness {way.sharpness:g}  margin {way.margin}"
                  f"{'  <- used' if way.is_used(segmenter) else ''}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(parse(Settings, __doc__))
