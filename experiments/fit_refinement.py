"""How should `recognize` refine? Yaw errors on validation frames (another seed than the test's) for several settings.

python -m experiments.fit_refinement [--preset smoke] [--help]

Yaw is refined on the segmenter's map, on the frame itself, or on the map and then on the frame. On the frame the
semantic template or the echo template is fitted. There is one row for each setting and segmenter, best first. How
`recognize` refines last is marked, and also tried with fewer and with more iterations. Test and real frames play no
part.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import TILTS_DEG, VALIDATION_SEED, TestFrame, paper_frames, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, summary_deg, yaw_error_deg
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.scores import target
from experiments.common.segmenters import Name, map_of
from sonarjax.refine import FRAME_BLURS, MAP_REFINEMENT, on_frame

BLURS = ((2.0, 0.8), (4.0, 1.5), (1.0, 0.5))
SHARPNESSES = (0.0, 10.0)
MARGINS = (MAP_REFINEMENT.margin, None)
ITERATIONS = (2, 4, 8, 16, 32)
"""Other numbers of iterations at each blur, tried with all else as `recognize` does it."""
HALF = NormalDist().inv_cdf(0.75)

HEADS = {
    "segmenter": "segmenter",
    "median": "median [°]",
    "p95": "95 % [°]",
    "besides": "besides yaw_std [°]",
    "settled": "settled",
    "on": "on",
    "template": "template",
    "blurs": "blurs",
    "sharpness": "sharpness",
    "margin": "margin",
    "iterations": "iterations",
    "used": "",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    segmenters: tuple[Name, ...] = ("pix2pix", "none")
    """Segmenters whose maps are refined on."""
    step_deg: int = 30
    """Yaw step of the validation frames [deg]."""
    severity: float = 1.0
    """Severity of the sensor model [1]."""
    drawn: bool = False
    """Another device of the family for every frame, instead of the nominal one."""
    most: int = 0
    """How many blurs, sharpnesses and margins are tried together at most; 0 for all."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""


class Way(NamedTuple):
    """One way to refine."""

    on: str
    """`map`, `frame`, or `both`: the map first, as `MAP_REFINEMENT` has it, then the frame."""
    template: str
    blurs: tuple[float, ...]
    sharpness: float
    margin: tuple[int, int] | None
    iterations: int


ON_FRAME = on_frame(MAP_REFINEMENT)
USED = Way("both", "either", FRAME_BLURS, ON_FRAME.sharpness, ON_FRAME.margin, ON_FRAME.iterations)
"""How `recognize` refines last; its brief refinements before that are left out (`sonarjax.refine.refine_starts`)."""


def ways(most: int, segmenter: str) -> list[Way]:
    """What is compared, `most` settings for each image and template; 0 for all. Only `semantic` has a sharpness.

    Without a segmenter the map is the frame.
    """
    settings = list(itertools.product(BLURS, SHARPNESSES, MARGINS))[: most or None]
    plain = [setting for setting in settings if setting[1] == 0.0]
    chosen = {("map", "semantic"): settings, ("frame", "semantic"): settings, ("both", "semantic"): settings}
    chosen |= {("frame", "echo"): plain, ("both", "echo"): plain}
    if segmenter == "none":
        del chosen["map", "semantic"]
    iterations = {"semantic": MAP_REFINEMENT.iterations, "echo": USED.iterations}
    compared = [Way(*what, *how, iterations[what[1]]) for what, all_of_it in chosen.items() for how in all_of_it]
    return [*compared, USED, *(USED._replace(iterations=count) for count in ITERATIONS)]


def run(settings: Settings, job: Job) -> Report:
    """One row for each segmenter and way, best first."""
    frames = paper_frames(
        VALIDATION_SEED + job.seed,
        yaw_offset_deg=5.0,
        step_deg=settings.step_deg,
        severity=settings.severity,
        drawn=settings.drawn,
        tilts_deg=settings.tilts_deg,
    )
    targets = [frame for frame in frames if frame.is_target]
    found = job.map(partial(_measure, targets, settings.most), settings.segmenters, "segmenters")
    return {"frames": len(targets), "rows": [row for rows in found.values() for row in rows]}


def _measure(frames: list[TestFrame], most: int, segmenter: str) -> list[dict[str, Any]]:
    return [
        {"segmenter": segmenter, "besides": besides(error, std), "settled": float(settled.mean())}
        | summary_deg(error)
        | way._asdict()
        | {"used": way == USED}
        for way, (error, std, settled) in errors(frames, segmenter, most).items()
    ]


def besides(error: np.ndarray, std: np.ndarray) -> float:
    """What a standard deviation (frame,) must be joined by in quadrature, so that half of the errors are in its middle.

    Half of all normal deviates are less than 0.6745 standard deviations off; 0 where `std` is large enough by itself.
    """
    low, high = 0.0, float(error.max()) / HALF
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if np.median(error / np.hypot(std, middle)) > HALF else (low, middle)
    return high


def errors(frames: list[TestFrame], segmenter: str, most: int) -> dict[Way, np.ndarray]:
    """Yaw error [deg], `yaw_std` [deg] and whether it settled (3, frame), of each way, from `recognize`'s start.

    `most` as in `ways`.
    """
    mesh, recognizer_of = target(), recognizers(target(), refine=None)
    found: dict[Way, list[tuple[float, ...]]] = defaultdict(list)
    for frame in tqdm(frames, desc=segmenter, unit="frame", leave=False):
        sonar, semantic = sonar_for(frame.tilt_deg), map_of(segmenter, frame)
        start = recognizer_of(frame.tilt_deg)(semantic)
        pose = sj.Pose(start.x, start.y, start.yaw)
        begun = {"map": (semantic, pose), "frame": (frame.image, pose)}
        on_map = sj.refine_yaw(semantic, mesh, sonar, pose, config=MAP_REFINEMENT, engine=engine())
        begun["both"] = frame.image, on_map.pose
        for way in ways(most, segmenter):
            image, at = begun[way.on]
            tried = {name: value for name, value in way._asdict().items() if name != "on"}
            config = replace(MAP_REFINEMENT, **tried)
            estimate = sj.refine_yaw(image, mesh, sonar, at, config=config, engine=engine())
            error = yaw_error_deg(estimate.yaw, frame.yaw)
            found[way].append((float(error), math.degrees(float(estimate.yaw_std)), float(estimate.converged)))
    return {way: np.array(values).T for way, values in found.items()}


def table(report: Report) -> str:
    """The rows as a table, the best of each segmenter first; what is used is marked."""
    # Here rather than in the rows: those of several seeds must be of one order.
    names = list(dict.fromkeys(row["segmenter"] for row in report["rows"]))
    best_first = sorted(report["rows"], key=lambda row: (names.index(row["segmenter"]), row["p95"]))
    rows = [row | {"used": "used" if row["used"] else ""} for row in best_first]
    return (
        f"{report['frames']} frames; error of the refined yaw, and what yaw_std must be joined by in quadrature for\n"
        f"half of the errors to be within 0.67 of it\n\n{columns(rows, HEADS)}"
    )


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"segmenters": ("none",), "step_deg": 360, "most": 1, "tilts_deg": (20.0,)})
