"""Thresholds of eq. 5 from validation frames (another seed than the test's): the midpoint that errs least.

Prints what stands in `sonarjax.recognize.THRESHOLDS`. Test frames play no part.
"""

from __future__ import annotations

import argparse

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.frames import paper_frames, sonar_for
from sonarjax.segment import SEGMENTERS

VALIDATION_SEED = 1000


def best_threshold(target: np.ndarray, other: np.ndarray) -> float:
    """The middle of the widest run of thresholds with the fewest errors, from scores of both kinds."""
    edges = np.unique(np.concatenate([target, other]))
    cuts = (edges[1:] + edges[:-1]) / 2
    errors = np.array([(target < cut).sum() + (other >= cut).sum() for cut in cuts])
    least = cuts[errors == errors.min()]
    return float((least.min() + least.max()) / 2)


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step-deg", type=int, default=20, help="yaw step of the validation frames [deg]")
    settings = parser.parse_args()
    frames = paper_frames(VALIDATION_SEED, yaw_offset_deg=5.0, step_deg=settings.step_deg)
    mesh, sonars = sj.objects.target(), {tilt: sonar_for(tilt) for tilt in sorted({f.tilt_deg for f in frames})}
    for name in SEGMENTERS:
        scores = {True: [], False: []}
        for frame in tqdm(frames, desc=name, unit="frame"):
            result = sj.recognize(
                frame.image, mesh, sonars[frame.tilt_deg], segmenter=name, refine=False, threshold=0.0
            )
            scores[frame.is_target].append(result.score)
        target, other = np.array(scores[True]), np.array(scores[False])
        cut = best_threshold(target, other)
        print(f"{name}: threshold {cut:.3f}; targets {target.mean():.3f} (least {target.min():.3f}), "
              f"non-targets {other.mean():.3f} (largest {other.max():.3f})")  # fmt: skip


if __name__ == "__main__":
    main()
