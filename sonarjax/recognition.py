"""`Recognition`: what a `Recognizer` finds in a frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sonarjax.refine import YAW_WEIGHTS, YawSet, make_yaw_set


@dataclass(frozen=True)
class Hypothesis:
    """One possible yaw of the target."""

    yaw: float
    """Absolute yaw [rad]."""
    score: float
    """NCC (eq. 4) of its template; after refinement a weighted mean of those with the frame and with the map."""
    yaw_std: float | None
    """Standard deviation of the refined yaw [rad], given this hypothesis; None without refinement.

    See `refine.ErrorBar`. It includes what the sonar's `geometry_std` adds, if the sonar states one."""
    converged: bool = True
    """False if refinement did not settle inside its bounds. The yaw is then whichever fits better, the bin's or the
    refined one."""
    x: float | None = None
    """Forward position [m] of the target at this yaw; None if it is that of the `Recognition`."""
    y: float | None = None
    """Position to port [m], likewise."""


@dataclass(frozen=True, eq=False)
class Recognition:
    """What a `Recognizer` found in one frame."""

    identified: bool
    """True if `score` reaches `threshold` (eq. 5)."""
    target: str
    """Name of the target that matches best."""
    score: float
    """By the segmenter's `rule`, the smaller of two probabilities: that the object is the target, and that any object
    is shown. This is compared with the threshold.

    It equals `score_bank`, eq. 5's maximum, without refinement, without a rule, or with a map of your own."""
    score_bank: float
    """Largest NCC over the bank's yaw bins."""
    score_refined: float | None
    """Score of the best hypothesis after refinement (`Hypothesis.score`); None without refinement."""
    threshold: float
    """Smallest score of an identified target."""
    runner_up: str | None
    """Name of the second best target; None with a single target."""
    margin: float | None
    """Probability of this target less that of the runner-up, given that one of the candidates is shown.

    None with a single target. Without refinement or a rule, the difference of their `score_bank`."""
    yaw_bin: float
    """Yaw of the best template [rad], turned to the bearing at which it was found."""
    yaw: float
    """Mean absolute yaw [rad] over the poses near the best fit (`refine.mean_yaw`); without refinement, that of the
    bin."""
    yaw_std: float | None
    """Standard deviation of the refined yaw [rad]; None without refinement."""
    x: float
    """Forward position of the target [m]."""
    y: float
    """Position of the target to port [m]."""
    converged: bool
    """False if refinement did not settle inside its bounds; True without refinement."""
    scores_by_yaw: np.ndarray
    """NCC (yaw,) of each bin."""
    hypotheses: tuple[Hypothesis, ...]
    """Possible yaws, best first."""
    segmenter: str
    """Name of the segmenter that made the semantic map; `given` for a map of your own."""
    semantic: np.ndarray = field(repr=False)
    """The image (range, beam) that was matched."""
    agree: bool | None = None
    """Whether the map and the frame itself match the target at the same place and yaw, before refinement.

    If not, at least one of them is wrong, unless the object looks the same at several yaws; the better fit after
    refinement decides. None where only one of them is matched: without refinement, for the segmenter `none`, and with a
    map of your own."""
    evidence: Mapping[str, float] | None = field(default=None, repr=False)
    """The rule's inputs, by the names of `segment.EVIDENCE`, and `own_rise`. It also holds what `yaw_std` is
    computed from, beside the score: `frame_drop` [NCC] (see `curve_evidence`), and `curvature_std` [rad], the standard
    deviation from `refine_yaw`. None without refinement."""

    @property
    def yaw_set(self) -> YawSet | None:
        """All yaws that the frame allows, with weights: the hypotheses and the bank's other peaks.

        `yaw_set.intervals(0.95)` gives the disjoint intervals that together hold 95 %. The weights assume that the
        frame shows the target. They were fitted on validation frames (experiments/fit_yaw_set.py).

        None without refinement, and for a frame of a sequence that was found without the bank.
        """
        stds = [one.yaw_std for one in self.hypotheses if one.yaw_std is not None]
        count = len(self.scores_by_yaw)
        if len(stds) < len(self.hypotheses) or not count:
            return None
        bins = (np.arange(count) - int(self.scores_by_yaw.argmax())) * (2 * math.pi / count)
        yaws, scores = [one.yaw for one in self.hypotheses], [one.score for one in self.hypotheses]
        return make_yaw_set(yaws, stds, scores, self.scores_by_yaw, self.yaw_bin + bins, YAW_WEIGHTS)
