"""Refine the starts of a frame in stages, so that most of the work goes to the best of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.evidence import Evidence
from sonarjax.refine.free import wrapped
from sonarjax.refine.mean_yaw import mean_yaw
from sonarjax.refine.pose import plan_refinement
from sonarjax.refine.starts import Start, evidence_of, is_kept, kept_pose, on_frame
from sonarjax.refine.template import Drawn
from sonarjax.refine.yaw import YawEstimate, refine_and_draw
from sonarjax.render import WindowSize
from sonarjax.scene import Pose

BRIEF_ON_MAP, BRIEF_ON_FRAME = 1, 2
"""Most renders at each blur of the brief refinements that every start gets."""
LEAD = 0.1
"""A start is refined no further if its score on the frame is lower than the best by more than this [NCC], unless its
`fit` is the best.

The score on the map says too little: on frames of odd devices the right start can be far behind there."""
MAP_SHARE = 1 / 3
"""Weight of the map in `RefinedStart.fit`; the frame has the rest [1].

On the frame alone, the template may fit a tank's wall better than the target (experiments/fit_start_choice.py)."""
SAME_POSE = math.radians(5.0), 0.02
"""Poses that differ by less than this in yaw [rad] and in place [m] after the brief refinement count as one."""


class RefinedStart(NamedTuple):
    """A start, refined on the frame."""

    start: Start
    """The start."""
    estimate: YawEstimate
    """The estimate on the frame."""
    pose: Pose
    """The refined pose, or that before this refinement where it is not kept (see `kept_pose`)."""
    evidence: Evidence
    """The evidence for the target at this pose."""
    drawn: Drawn
    """The templates there."""
    size: WindowSize
    """Size of the window in which it was refined."""

    @property
    def score(self) -> float:
        """The score on the frame (NCC, eq. 4) that belongs to the pose."""
        found = self.estimate
        return float(np.where(is_kept(found), np.asarray(found.score), np.asarray(found.start_score)))

    @property
    def fit(self) -> float:
        """How well the template fits frame and map: the mean of its NCCs, weighted by `MAP_SHARE`."""
        return (1 - MAP_SHARE) * self.score + MAP_SHARE * float(self.evidence.map_fit)


def refine_starts(
    starts: Sequence[Start], image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, config: RefineConfig,
    window_of: Callable[[Start], WindowSize | None], engine: Engine,
) -> list[RefinedStart]:  # fmt: skip
    """Refine starts, each in the picture in which it was found and then on the frame itself.

    All are refined briefly. Then the best one is refined until it settles, and so are those that score nearly as high
    on the frame as the highest. The second refinement on the frame begins again with the widest blur, and chooses
    template and echo law anew. This makes large errors rarer on noisy frames.

    Args:
        starts: The starts. Those with a pose of their own count only where refinement settles or fits better.
        image: The frame (range, beam).
        seen: The frame's semantic map (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        config: How to refine on the map; `on_frame` derives the refinement on the frame from it.
        window_of: Gives the size of a window that is large enough for a start; None lets refinement plan it.
        engine: Runs the compiled functions.

    Returns:
        The refined starts with different poses, best `fit` first. Those that score far less than the best are refined
        only briefly.

    Raises:
        SonarjaxError: As `refine_yaw`.
    """

    def refine(
        start: Start, picture: np.ndarray, pose: Pose, how: RefineConfig
    ) -> tuple[YawEstimate, Drawn, WindowSize]:
        mesh, sonar = start.candidate.search.mesh, start.candidate.search.sonar
        size = window_of(start) or plan_refinement(mesh, sonar, pose, how)
        return *refine_and_draw(picture, mesh, sonar, pose, mask, how, size, engine), size

    def in_frame(start: Start, pose: Pose, how: RefineConfig) -> RefinedStart:
        estimate, drawn, size = refine(start, image, pose, how)
        evidence = evidence_of(drawn, image, seen, mask, engine)
        return RefinedStart(start, estimate, kept_pose(estimate, pose), evidence, drawn, size)

    def briefly(start: Start) -> RefinedStart:
        estimate, *_ = refine(start, start.picture, start.begin, _at_most(config, BRIEF_ON_MAP))
        return in_frame(start, kept_pose(estimate, start.begin), _at_most(final, BRIEF_ON_FRAME))

    final = on_frame(config)
    found = filter(_counts, engine.map(briefly, starts))
    poses = different(sorted(found, key=lambda one: -one.fit))
    least = max((one.score for one in poses), default=0.0) - LEAD
    leads = [k == 0 or one.score >= least for k, one in enumerate(poses)]
    settled = engine.map(lambda one: in_frame(one.start, one.pose, final), list(compress(poses, leads)))
    rest = compress(poses, [not lead for lead in leads])
    return sorted([*settled, *rest], key=lambda one: -one.fit)


def with_mean_yaw(
    found: RefinedStart, image: np.ndarray, mask: np.ndarray | None, config: RefineConfig, engine: Engine
) -> RefinedStart:
    """Give a refined start the mean yaw over the poses near it (see `mean_yaw`).

    Args:
        found: The refined start.
        image: The frame (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        config: How it was refined on the map, as in `refine_starts`.
        engine: Runs the compiled functions.

    Returns:
        The start with that yaw [rad], and all else as it was. Nothing changes if its refined pose was not kept, because
        the drawn templates are not those of its pose.
    """
    if not is_kept(found.estimate):
        return found
    search, how = found.start.candidate.search, (on_frame(config), found.size, engine)
    yaw = mean_yaw(image, mask, search.mesh, search.sonar, found.pose, found.drawn, *how)
    return found._replace(pose=replace(found.pose, yaw=wrapped(np.float32(yaw))))


def different(found: Sequence[RefinedStart]) -> list[RefinedStart]:
    """The refined starts, without those whose pose is the same as an earlier one's (see `SAME_POSE`)."""
    kept: list[RefinedStart] = []
    for one in found:
        if not any(_same(one.pose, other.pose) for other in kept):
            kept.append(one)
    return kept


def _at_most(config: RefineConfig, iterations: int) -> RefineConfig:
    return replace(config, iterations=min(config.iterations, iterations))


def _counts(found: RefinedStart) -> bool:
    """False for an expected pose that refinement does not confirm: it is not what the frame shows."""
    return found.start.pose is None or bool(is_kept(found.estimate))


def _same(one: Pose, other: Pose) -> bool:
    turned = abs(math.remainder(float(one.yaw) - float(other.yaw), 2 * math.pi))
    moved = math.hypot(float(one.x) - float(other.x), float(one.y) - float(other.y))
    return turned < SAME_POSE[0] and moved < SAME_POSE[1]
