"""Find the target in each frame, and whether it is there at all, with the sonar as it is known so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.match import SearchConfig, TargetSearch
from sonarjax.refine import (
    MAP_REFINEMENT,
    curve_evidence,
    locate,
    make_starts,
    plan_refinement,
    refine_starts,
)
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import Segmenter
from sonarjax.sonar import Sonar


class Prepared(NamedTuple):
    """A frame and its semantic map."""

    image: np.ndarray
    """The frame (range, beam)."""
    mask: np.ndarray | None
    """True where the frame was measured (range, beam); None for everywhere."""
    seen: np.ndarray
    """Semantic map (range, beam)."""


class Detection(NamedTuple):
    """The target's best pose in a frame."""

    pose: Pose
    """The refined pose."""
    probability: float
    """Probability that the target is shown, by the segmenter's rule; the score of eq. 5 if it has no rule."""


def detect(
    frames: Sequence[Prepared], mesh: Mesh, sonar: Sonar, segmenter: Segmenter, search: SearchConfig, engine: Engine
) -> list[Detection]:
    """Find the target in each frame. Raises SonarjaxError as `TargetSearch` does."""
    banks = TargetSearch(mesh, sonar, search, engine=engine)
    nearest = float(banks.distances[0])
    window = plan_refinement(mesh, sonar, Pose(x=nearest), MAP_REFINEMENT)
    return engine.map(lambda frame: _detect(frame, banks, segmenter, window, engine), frames)


def _detect(
    frame: Prepared, banks: TargetSearch, segmenter: Segmenter, window: WindowSize, engine: Engine
) -> Detection:
    in_map = locate(banks, frame.seen, frame.mask)
    in_frame = None if segmenter.name == "none" else locate(banks, frame.image, frame.mask, "frame")
    starts = make_starts(in_map, in_frame, frame.seen, frame.image, banks.config.hypotheses)
    how = MAP_REFINEMENT, lambda _: window, engine
    best = refine_starts(starts, frame.image, frame.seen, frame.mask, *how)[0]
    evidence = {name: float(value) for name, value in vars(best.evidence).items()} | curve_evidence(in_map, in_frame)
    rule = segmenter.rule
    return Detection(best.pose, in_map.score if rule is None else rule.probability(evidence))


def best_height(
    frames: Sequence[Prepared], mesh: Mesh, sonar: Sonar, heights: np.ndarray, search: SearchConfig, engine: Engine
) -> float:
    """The height [m], of `heights` (height,), with which the target's templates match the frames' semantic maps best.

    Frames whose best score over all heights is below the median are left out, because they may not show the target.
    Heights from which the aperture sees no floor in the window are skipped.

    Raises:
        SonarjaxError: All heights were skipped.
    """
    scores = np.full((len(heights), len(frames)), -math.inf)
    for row, height in enumerate(heights):
        try:
            banks = TargetSearch(mesh, sonar.replace(height=float(height)), search, engine=engine)
        except SonarjaxError:
            if row + 1 == len(heights) and np.isneginf(scores).all():
                raise
            continue
        scores[row] = [locate(banks, frame.seen, frame.mask).score for frame in frames]
    best = scores.max(axis=0)
    chosen = best >= np.median(best)
    return float(heights[scores[:, chosen].mean(axis=1).argmax()])
