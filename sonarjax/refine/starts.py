"""Where refinement starts, how it goes on from the map to the frame, and the evidence for what it finds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.match import Match, TargetSearch, between_bins, peaks
from sonarjax.match.search import Picture
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.evidence import Evidence, gather_evidence
from sonarjax.refine.template import Drawn
from sonarjax.refine.yaw import YawEstimate
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Pose

MAP_REFINEMENT = RefineConfig(
    bounds=(math.radians(10.0), 0.06, 0.06), blurs=(2.0, 0.8), polish=0, margin=(MARGIN_BINS, MARGIN_BEAMS),
    sharpness=0.0,
)  # fmt: skip
"""How a match is refined on the segmenter's map, within one bin of yaw [rad] and a few pixels of x and y [m].

Refinement starts close to the solution, so it needs no coarse blur to widen the basin of convergence. With a coarse
blur, it would follow the uneven floor of a grey frame. A plain template (sharpness 0) works best, because a threshold
applied to speckle does not give a clean label image."""
FRAME_BLURS = (1.0, 0.5)
"""Blurs [range bins] of the refinement on the frame itself, which starts from the result on the map."""
FRAME_ITERATION_FACTOR = 3
"""Largest number of renders at each of these blurs, relative to the refinement on the map [1].

In a speckled frame it takes more steps to settle: experiments/fit_refinement.py compares numbers of iterations."""
BESIDE = math.radians(10.0)
"""How far from the best yaw a score is compared with the highest [rad]."""
PEAK_SHARE = 1 / 12
"""Share of the yaw bins that share the highest peak of the scores, beside the best bin [1]."""


class Candidate(NamedTuple):
    """A target's best match in a frame."""

    search: TargetSearch
    """The target."""
    match: Match
    """Its best match: the bank with the highest score, and the scores of that bank."""
    x: float
    """Forward position at which it matched [m]."""
    y: float
    """Position to port [m]."""

    @property
    def score(self) -> float:
        """The highest score over the bank (eq. 5)."""
        return float(self.match.scores.max())

    @property
    def yaws(self) -> np.ndarray:
        """Absolute yaw (yaw,) of each bin [rad].

        A bank's yaws hold for the bearing at which it was rendered; the difference in bearing is added to them.
        """
        bank = self.match.bank
        turned = math.atan2(self.y, self.x) - math.atan2(float(bank.y), float(bank.x))
        return np.asarray(bank.yaws) + turned

    def between_bins(self, k: int) -> Pose:
        """Move the yaw of a bin to the peak of a parabola through the neighbouring scores.

        Args:
            k: Number of the bin.

        Returns:
            The pose [m, rad] at that yaw, where the target matched.
        """
        scores = self.match.scores
        yaw = float(self.yaws[k]) + between_bins(scores, k) * (2 * math.pi / len(scores))
        return Pose(x=self.x, y=self.y, yaw=yaw)


class Start(NamedTuple):
    """A starting point for refinement."""

    candidate: Candidate
    """The match it comes from."""
    bin: int
    """Number of the yaw bin."""
    picture: np.ndarray
    """The map or frame (range, beam) in which the target was matched."""
    pose: Pose | None = None
    """The pose to start from; None to start at the yaw bin."""

    @property
    def begin(self) -> Pose:
        """The pose [m, rad] to start from."""
        return self.candidate.between_bins(self.bin) if self.pose is None else self.pose


def locate(
    search: TargetSearch, image: np.ndarray, mask: np.ndarray | None, picture: Picture = "map", near: int | None = None
) -> Candidate:
    """Find the target's best match in a map or a frame.

    Args:
        search: The target.
        image: The map or frame (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        picture: Which of the two it is.
        near: Index of the distance near which to search; None searches all distances.

    Returns:
        The best match and its place.

    Raises:
        SonarjaxError: No part of the target can be seen at any distance (as `TargetSearch.find`).
    """
    image = np.asarray(image, np.float32)
    match = search.find(image, mask, picture) if near is None else search.find_near(near, image, mask, picture)
    return Candidate(search, match, *search.place(match))


def make_starts(
    in_map: Candidate, in_frame: Candidate | None, seen: np.ndarray, image: np.ndarray, count: int
) -> list[Start]:
    """List the starts for refinement: the best yaws in the map, then the best yaw in the frame.

    Args:
        in_map: The match in the map.
        in_frame: The match in the frame; None if there is none.
        seen: The map (range, beam).
        image: The frame (range, beam).
        count: Largest number of starts from the map; each is a peak of its scores over yaw.

    Returns:
        The starts, those in the map first.
    """
    starts = [Start(in_map, k, seen) for k in peak_bins(in_map.match.scores, in_map.yaws, count)]
    if in_frame is not None:
        starts.append(Start(in_frame, int(in_frame.match.scores.argmax()), image))
    return starts


def agreeing(in_map: Candidate, in_frame: Candidate) -> bool:
    """Tell whether map and frame match the target at the same place and yaw.

    Args:
        in_map: The match in the map.
        in_frame: The match in the frame.

    Returns:
        True if the places are closer than the target's radius in plan, and the best yaw bins are the same or
        neighbours.
    """
    corners = np.asarray(in_map.search.mesh.vertices)
    apart = math.hypot(in_map.x - in_frame.x, in_map.y - in_frame.y)
    yaws = [float(one.yaws[one.match.scores.argmax()]) for one in (in_map, in_frame)]
    turned = abs(math.remainder(yaws[0] - yaws[1], 2 * math.pi))
    return apart < float(np.hypot(*corners[:, :2].T).max()) and turned < 1.5 * 2 * math.pi / len(in_map.yaws)


def peak_bins(scores: np.ndarray, yaws: np.ndarray, count: int) -> list[int]:
    """Find the yaw bins at the highest peaks of the scores.

    Args:
        scores: Score of each bin (yaw,).
        yaws: Yaw of each bin (yaw,) [rad].
        count: Most peaks to return.

    Returns:
        Numbers of the bins, best first; at least one.
    """
    found = peaks(scores, yaws, max_peaks=count)
    return [int(k) for k, valid in zip(np.asarray(found.yaw_bin), np.asarray(found.valid), strict=True) if valid]


def on_frame(config: RefineConfig) -> RefineConfig:
    """Derive the config of the refinement on the frame itself from that of the refinement on the map.

    Args:
        config: The config of the refinement on the map.

    Returns:
        The config with `FRAME_BLURS`, more iterations (`FRAME_ITERATION_FACTOR`) and the template `either`.
    """
    blurs, iterations = FRAME_BLURS[-len(config.blurs) :], FRAME_ITERATION_FACTOR * config.iterations
    return replace(config, blurs=blurs, iterations=iterations, template="either")


def evidence_of(drawn: Drawn, image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, engine: Engine) -> Evidence:
    """Gather the evidence for a drawn template in its window of the frame."""
    weights = np.ones(image.shape, np.float32) if mask is None else mask.astype(np.float32)
    parts = (drawn.part(v) for v in (image, np.asarray(seen, np.float32), weights))
    return engine.run(gather_evidence, *parts, drawn.template, drawn.labels)


def curve_evidence(in_map: Candidate, in_frame: Candidate | None) -> dict[str, float]:
    """Measure how far the peak of the scores over yaw stands out in map and frame, and its height in the frame.

    `map_rise` and `frame_rise` are the highest score minus the fourth highest (of 36). `own_rise` is the same of the
    own scores of the frame's best template (`Match.own_scores`): how far the best yaw of this target can stand out, 0
    for a round one. `frame_drop` is the frame's highest score minus the mean of the two scores 10° before and after it.
    `frame_peak` is the frame's highest score.

    Args:
        in_map: The match in the map.
        in_frame: The match in the frame; None uses the match in the map instead.

    Returns:
        These five numbers [NCC] by name.
    """
    frame = (in_map if in_frame is None else in_frame).match
    return {
        "map_rise": _rise(in_map.match.scores),
        "frame_rise": _rise(frame.scores),
        "own_rise": _rise(frame.own_scores()),
        "frame_peak": float(frame.scores.max()),
        "frame_drop": _drop(frame.scores),
    }


def _rise(scores: np.ndarray) -> float:
    """How far the highest of scores over the full circle (yaw,) stands out from those that do not share its peak.

    With the usual 36 bins that is the fourth highest; a peak takes up as large a share of any other number of bins.
    """
    ordered = np.sort(scores)
    return float(ordered[-1] - ordered[-1 - max(round(PEAK_SHARE * len(scores)), 1)])


def _drop(scores: np.ndarray) -> float:
    """How far scores over the full circle (yaw,) fall from the highest, on average, `BESIDE` to either side."""
    best, bins = int(scores.argmax()), BESIDE * len(scores) / (2 * math.pi)
    beside = np.interp([best - bins, best + bins], np.arange(len(scores)), scores, period=len(scores))
    return float(scores[best] - beside.mean())


def is_kept(estimate: YawEstimate) -> Any:
    """True where refinement converged, or where its result scores higher than its start."""
    return np.asarray(estimate.converged) | (np.asarray(estimate.score) > np.asarray(estimate.start_score))


def kept_pose(estimate: YawEstimate, start: Pose) -> Pose:
    """The refined poses, or `start` where the refined pose is not kept (see `is_kept`)."""
    kept = is_kept(estimate)
    refined: dict[str, Any] = {
        name: np.where(kept, np.asarray(getattr(estimate, name)), np.asarray(getattr(start, name)))
        for name in ("x", "y", "yaw")
    }
    return replace(start, **refined)
