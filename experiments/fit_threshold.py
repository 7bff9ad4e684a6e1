"""Thresholds of eq. 5 from validation frames (another seed than the test's): the midpoint that errs least.

Prints what stands in `sonarjax.recognize.THRESHOLDS` and `experiments.common.segmenters`. Test frames play no part.
"""

from __future__ import annotations

import argparse

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import paper_frames, sonar_for
from experiments.common.segmenters import available, map_of

VALIDATION_SEED = 1000


def best_threshold(target: np.ndarray, other: np.ndarray) -> float:
    """The middle of the widest run of thresholds with the fewest errors, from scores of both kinds."""
    edges = np.unique(np.concatenate([target, other]))
    cuts = (edges[1:] + edges[:-1]) / 2
    errors = np.array([(target < cut).sum() + (other >= cut).sum() for cut in cuts])
    least = np.flatnonzero(errors == errors.min())
    runs = np.split(least, np.flatnonzero(np.diff(least) > 1) + 1)
    widest = max(runs, key=lambda run: edges[run[-1] + 1] - edges[run[0]])
    return float((edges[widest[0]] + edges[widest[-1] + 1]) / 2)


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--step-deg", type=int, default=20, help="yaw step of the validation frames [deg]")
    parser.add_argument("--segmenters", default=",".join(available()), help="which, separated by commas")
    settings = parser.parse_args()
    frames = paper_frames(VALIDATION_SEED, yaw_offset_deg=5.0, step_deg=settings.step_deg)
    mesh = sj.objects.target()
    for name in settings.segmenters.split(","):
        scores: dict[bool, list[float]] = {True: [], False: []}
        for frame in tqdm(frames, desc=name, unit="frame"):
            sonar = sonar_for(frame.tilt_deg)
            result = sj.recognize(map_of(name, frame), mesh, sonar, segmenter="none", refine=False, threshold=0.0)
            scores[frame.is_target].append(result.score)
        target, other = np.array(scores[True]), np.array(scores[False])
        cut = best_threshold(target, other)
        print(f"{name}: threshold {cut:.3f}; targets {target.mean():.3f} (least {target.min():.3f}), "
              f"non-targets {other.mean():.3f} (largest {other.max():.3f})", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
