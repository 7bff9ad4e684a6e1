"""`PoseFinder`: the whole pose of a known object in a frame, from nothing: banks over lean, then `refine_pose`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from sonarjax.engine import PLAIN, Engine
from sonarjax.match import LeanSearch, LeanSearchConfig, SearchConfig, TargetSearch
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.free import ALL, check_free
from sonarjax.refine.pose import PoseEstimate, plan_refinement, refine_pose
from sonarjax.render import WindowSize
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import DEFAULT_SEGMENTER, Segmenter, load_segmenter
from sonarjax.sonar import Sonar

FINDING = RefineConfig(
    bounds=(math.radians(20.0), 0.08, 0.08), lean_bounds=(0.06, math.radians(15.0), math.radians(15.0)),
    blurs=(3.0, 1.0), iterations=6, polish=0, margin=(MARGIN_BINS, MARGIN_BEAMS), sharpness=0.0,
)  # fmt: skip
"""How a candidate is refined on the map, and then on the frame: bounds of a step of the bank."""
FRAME_BLURS = (2.0, 0.7)
"""Blurs [range bins] of the refinement on the frame itself, which goes on from the map's."""


class Prepared(NamedTuple):
    """A frame as it is searched."""

    image: np.ndarray
    """The frame (range, beam)."""
    semantic: np.ndarray
    """Its map (range, beam)."""
    mask: np.ndarray | None
    """True (range, beam) where a pixel was measured."""


class PoseFinder:
    """One target and one sonar, with the banks over lean that were rendered for them so far: call it with frames."""

    def __init__(
        self, mesh: Mesh, sonar: Sonar, *, free: Sequence[str] = ALL, segmenter: str | Segmenter = DEFAULT_SEGMENTER,
        search: SearchConfig = SearchConfig(), lean: LeanSearchConfig = LeanSearchConfig(),
        refine: RefineConfig = FINDING, engine: Engine = PLAIN,
    ) -> None:  # fmt: skip
        """`free` are the numbers that are not 0 for sure; banks go over those of z, roll and pitch among them.

        Raises SonarjaxError as `Recognizer` and `refine_pose` do.
        """
        self.free, self.refine, self.engine = check_free(free), refine, engine
        self.sonar = sonar.replace(geometry_std=None)
        self.mesh = mesh
        self.segmenter = segmenter if isinstance(segmenter, Segmenter) else load_segmenter(segmenter)
        self.lean = LeanSearch(TargetSearch(mesh, self.sonar, search, engine=engine), self.free, lean)
        nearest = Pose(x=float(self.lean.search.distances[0]), z=max(lean.lifts), roll=lean.lean, pitch=lean.lean)
        self.window: WindowSize = plan_refinement(mesh, self.sonar, nearest, refine, self.free)

    def __call__(self, image: Any, mask: Any = None) -> PoseEstimate:
        """The poses (hypothesis,) at which the target may be in `image` (range, beam), best first.

        `mask` (range, beam) is true where a pixel was measured. Raises SonarjaxError for a shape that does not fit.
        """
        return self.hypotheses(self.prepared(image, mask))

    def prepared(self, image: Any, mask: Any = None) -> Prepared:
        """The frame (range, beam) and its map. Raises SonarjaxError for a shape that does not fit the sonar."""
        image = np.asarray(image, np.float32)
        mask = None if mask is None else np.asarray(mask, bool)
        return Prepared(image, np.asarray(self.segmenter.semantic(image, mask, self.engine)), mask)

    def hypotheses(self, frame: Prepared) -> PoseEstimate:
        """The poses (hypothesis,) at which the target may be, best first: matched and refined on map and frame."""
        found = [self.lean.find(picture, frame.mask) for picture in (frame.semantic, frame.image)]
        start = jax.tree.map(lambda *v: np.concatenate(v), *(match.poses for match in found))
        on_map = self._refined(frame.semantic, start, self.refine, frame)
        config = replace(self.refine, blurs=FRAME_BLURS[-len(self.refine.blurs) :], template="either")
        estimate = self._refined(frame.image, kept(on_map, start), config, frame)
        order = np.argsort(-np.asarray(estimate.score))
        return jax.tree.map(lambda v: v[order], estimate)

    def _refined(self, picture: np.ndarray, start: Pose, config: RefineConfig, frame: Prepared) -> PoseEstimate:
        count = start.shape[0]
        pictures = np.broadcast_to(picture, (1, *picture.shape))
        starts = jax.tree.map(lambda v: np.asarray(v).reshape(1, count), start)
        mask = None if frame.mask is None else frame.mask[None]
        how: dict[str, Any] = {"free": self.free, "mask": mask, "config": config, "window": self.window}
        found = refine_pose(pictures, self.mesh, self.sonar, starts, engine=self.engine, **how)
        return jax.tree.map(lambda v: v[0], found)


def kept(estimate: PoseEstimate, start: Pose) -> Pose:
    """The refined poses; the start where refinement neither settled nor fits better."""
    better = np.asarray(estimate.converged) | np.asarray(estimate.score > estimate.start_score)
    return jax.tree.map(lambda new, old: np.where(better, np.asarray(new), np.asarray(old)), estimate.pose, start)
