"""From a match to a refined pose and the evidence for it: on the segmenter's map first, then on the frame itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.match import Match, TargetSearch, between_bins, peaks
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.evidence import Evidence, gather_evidence
from sonarjax.refine.pose import Drawn
from sonarjax.refine.yaw import YawEstimate, refine_and_draw, refine_yaw
from sonarjax.render import WindowSize
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Pose

MAP_REFINEMENT = RefineConfig(
    bounds=(math.radians(10.0), 0.06, 0.06), blurs=(2.0, 0.8), polish=0, margin=(MARGIN_BINS, MARGIN_BEAMS),
    sharpness=0.0,
)  # fmt: skip
"""How a match is refined on the segmenter's map: bounds of a bin of yaw [rad] and some pixels of x and y [m].

Refining starts at a match, so no blur has to widen the basin: a coarse one follows the uneven floor of a grey frame.
What a threshold makes of speckle is no label image: a plain template (sharpness 0) does best for it."""
FRAME_BLURS = (1.0, 0.5)
"""Blurs [range bins] of the refinement on the frame itself, which goes on from the map's."""
FRAME_ITERATIONS = 3
"""Renders at each of these blurs, at most."""


class Candidate(NamedTuple):
    """A target's best match in a frame."""

    search: TargetSearch
    """The target."""
    match: Match
    """Its best bank."""
    x: float
    """Forward position at which it matched [m]."""
    y: float
    """Position to port [m]."""

    @property
    def score(self) -> float:
        """Eq. 5's maximum over the bank."""
        return float(self.match.scores.max())

    @property
    def yaws(self) -> np.ndarray:
        """Absolute yaw (yaw,) of each bin [rad]: a bank's aspect is relative to the bearing it was rendered at."""
        bank = self.match.bank
        turned = math.atan2(self.y, self.x) - math.atan2(float(bank.y), float(bank.x))
        return np.asarray(bank.yaws) + turned

    def between_bins(self, k: int) -> Pose:
        """The pose at bin `k`, its yaw moved to where a parabola through the neighbouring scores peaks."""
        scores = self.match.scores
        yaw = float(self.yaws[k]) + between_bins(scores, k) * (2 * math.pi / len(scores))
        return Pose(x=self.x, y=self.y, yaw=yaw)


class Start(NamedTuple):
    """Where refinement starts."""

    candidate: Candidate
    """What was matched."""
    bin: int
    """The yaw bin."""
    picture: np.ndarray
    """The map or the frame (range, beam) that it was matched in."""
    pose: Pose | None = None
    """Where it starts, if not at the bin."""

    @property
    def begin(self) -> Pose:
        """The pose [m, rad] to start from."""
        return self.candidate.between_bins(self.bin) if self.pose is None else self.pose


def locate(search: TargetSearch, picture: np.ndarray, mask: np.ndarray | None, near: int | None = None) -> Candidate:
    """The target's best match in a map or a frame (range, beam), `near` a distance of that number where it is known.

    Raises SonarjaxError as `TargetSearch.find` does.
    """
    picture = np.asarray(picture, np.float32)
    match = search.find(picture, mask) if near is None else search.find_near(near, picture, mask)
    return Candidate(search, match, *search.place(match))


def make_starts(
    in_map: Candidate, in_frame: Candidate | None, seen: np.ndarray, image: np.ndarray, count: int
) -> list[Start]:
    """Up to `count` peaks over yaw of the match in the map `seen`, then the best of that in the frame `image`, if any.

    Both pictures are (range, beam).
    """
    starts = [Start(in_map, k, seen) for k in peak_bins(in_map.match.scores, in_map.yaws, count)]
    if in_frame is not None:
        starts.append(Start(in_frame, int(in_frame.match.scores.argmax()), image))
    return starts


def refine_start(
    start: Start, image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, config: RefineConfig,
    window: WindowSize | None, engine: Engine,
) -> tuple[YawEstimate, Pose, Evidence]:  # fmt: skip
    """A start refined where it was found, then on the frame `image` (range, beam), whose map is `seen`.

    With the pose that is kept, and what speaks for it. `window` is large enough for the start.
    """
    search, found = start.candidate.search, start.begin
    how: dict[str, Any] = {"mask": mask, "window": window, "engine": engine}
    first = kept_pose(refine_yaw(start.picture, search.mesh, search.sonar, found, config=config, **how), found)
    estimate, drawn = refine_and_draw(image, search.mesh, search.sonar, first, config=on_frame(config), **how)
    return estimate, kept_pose(estimate, first), evidence_of(drawn, image, seen, mask, engine)


def peak_bins(scores: np.ndarray, yaws: np.ndarray, count: int) -> list[int]:
    """Bins of the highest peaks of `scores` (yaw,) over `yaws` (yaw,) [rad], best first; at least one."""
    found = peaks(scores, yaws, max_peaks=count)
    return [int(k) for k, valid in zip(np.asarray(found.yaw_bin), np.asarray(found.valid), strict=True) if valid]


def on_frame(config: RefineConfig) -> RefineConfig:
    """The config of the refinement on the frame itself that follows one on the map."""
    blurs, iterations = FRAME_BLURS[-len(config.blurs) :], min(FRAME_ITERATIONS, config.iterations)
    return replace(config, blurs=blurs, iterations=iterations, template="either")


def evidence_of(drawn: Drawn, image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, engine: Engine) -> Evidence:
    """What speaks for a template in its window of the frame."""
    rows, columns = np.shape(drawn.template)
    top, left = int(drawn.row), int(drawn.column)
    whole = np.ones(image.shape, np.float32) if mask is None else mask.astype(np.float32)
    parts = (v[top : top + rows, left : left + columns] for v in (image, np.asarray(seen, np.float32), whole))
    return engine.run(gather_evidence, *parts, drawn.template, drawn.labels)


def curve_evidence(in_map: Candidate, in_frame: Candidate | None) -> dict[str, float]:
    """What the scores over yaw tell, those of the map and those of the frame: their peak, and how far it stands out."""
    curves = in_map.match.scores, (in_map if in_frame is None else in_frame).match.scores
    rises = [float(ordered[-1] - ordered[-4]) for ordered in map(np.sort, curves)]
    return {"map_rise": rises[0], "frame_rise": rises[1], "frame_peak": float(curves[1].max())}


def is_kept(estimate: YawEstimate) -> Any:
    """True where refinement settled, or fits better than its start did."""
    return np.asarray(estimate.converged) | np.asarray(estimate.score > estimate.start_score)


def kept_pose(estimate: YawEstimate, start: Pose) -> Pose:
    """The refined poses; the start where the refined one is not kept."""
    pairs = ((estimate.x, start.x), (estimate.y, start.y), (estimate.yaw, start.yaw))
    return Pose(*(np.where(is_kept(estimate), np.asarray(new), np.asarray(old)) for new, old in pairs))
