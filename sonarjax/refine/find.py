"""`PoseFinder`: find the complete pose of a known object in a frame, without a start.

It matches banks of leaning poses, and refines the best matches by `refine_pose`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind
from sonarjax.match import LeanSearch, LeanSearchConfig, SearchConfig, TargetSearch
from sonarjax.match.lean import distinct_turns
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.errorbar import POSE_ERROR_BAR, PoseErrorBar
from sonarjax.refine.free import ALL, check_free
from sonarjax.refine.pose import PoseEstimate, plan_refinement, refine_pose
from sonarjax.refine.views import check_views, in_common
from sonarjax.render import WindowSize
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.render.room import with_lean_room
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import DEFAULT_SEGMENTER, Segmenter, load_segmenter
from sonarjax.sonar import Sonar, checked_image

FINDING = RefineConfig(
    bounds=(math.radians(20.0), 0.08, 0.08), lean_bounds=(0.06, math.radians(15.0), math.radians(15.0)),
    blurs=(3.0, 1.0), iterations=6, polish=0, margin=(MARGIN_BINS, MARGIN_BEAMS), sharpness=0.0,
)  # fmt: skip
"""How a candidate is refined on the map, and then on the frame; the bounds are those of a step of the bank."""
FINDING_BLURS = (2.0, 0.7)
"""Blurs [range bins] of the refinement on the frame itself, which continues that on the map."""
PERTURBATIONS = {"z": 0.02, "roll": math.radians(8.0), "pitch": math.radians(8.0)}
"""Changes of the best poses [m, rad], from which they are refined again, because lesser optima lie near the
right pose, some 6° and 1 cm off.
"""
PERTURBED = 2
"""Number of hypotheses that are refined again from changed poses."""
SAME, APART = math.radians(2.0), math.radians(20.0)
"""Poses within the first rotation are the same; poses beyond the second are different hypotheses [rad]."""
MOST_LEANS = 64
"""About how many leaning poses are looked at, to make room for their triangles."""
KEPT_OF_EACH = 3
"""Number of hypotheses of each view from which the joint refinement of several views starts."""


class Prepared(NamedTuple):
    """A frame, ready to be searched."""

    image: np.ndarray
    """The frame (range, beam)."""
    semantic: np.ndarray
    """Its semantic map (range, beam)."""
    mask: np.ndarray | None
    """True where a pixel was measured (range, beam); None for everywhere."""


class PoseFinder:
    """One target and one sonar, with the banks over lean that were rendered so far. Call it with frames."""

    def __init__(
        self, mesh: Mesh, sonar: Sonar, *, free: Sequence[str] = ALL, segmenter: str | Segmenter = DEFAULT_SEGMENTER,
        search: SearchConfig = SearchConfig(), lean: LeanSearchConfig = LeanSearchConfig(),
        refine: RefineConfig = FINDING, error_bar: PoseErrorBar | None = POSE_ERROR_BAR, engine: Engine = PLAIN,
    ) -> None:  # fmt: skip
        """Prepare the search.

        Args:
            mesh: The target.
            sonar: The sonar.
            free: Numbers that refinement may change. Yaw, x and y are always searched, z, roll and pitch only if they
                are free.
            segmenter: The segmenter, or its name.
            search: How the place is searched for.
            lean: Which leaning poses are tried.
            refine: How candidates are refined.
            error_bar: Turns the curvature's covariance into that of the errors; None keeps that of the curvature.
            engine: Runs the compiled functions.

        Raises:
            SonarjaxError: As `Recognizer` for target, sonar and segmenter, and as `refine_pose` for `free`; or a config
                or `error_bar` is something else.
        """
        check_kind(mesh, Mesh, "mesh")
        check_kind(sonar, Sonar, "sonar")
        for name, config, kind in (("search", search, SearchConfig), ("lean", lean, LeanSearchConfig)):
            check_kind(config, kind, name)
        check_kind(engine, Engine, "engine")
        if error_bar is not None:
            check_kind(error_bar, PoseErrorBar, "error_bar")
        self.free, self.refine, self.engine = check_free(free), refine, engine
        self.error_bar = error_bar
        self.sonar = sonar.replace(geometry_std=None)
        self.segmenter = segmenter if isinstance(segmenter, Segmenter) else load_segmenter(segmenter)
        self.lean = LeanSearch(TargetSearch(mesh, self.sonar, search, engine=engine), self.free, lean)
        nearest = Pose(x=float(self.lean.search.distances[0]), z=max(lean.lifts), roll=lean.lean, pitch=lean.lean)
        # Refinement starts at these poses: with room for all of them at once, it is compiled only once.
        leans = self.lean.attitudes[:: max(len(self.lean.attitudes) // MOST_LEANS, 1)]
        middle = float(np.median(self.lean.search.distances))
        leaning = Pose(middle, 0.0, leans[:, 0], leans[:, 1], leans[:, 2], leans[:, 3])
        self.mesh = with_lean_room(mesh, leaning, self.sonar)
        self.window: WindowSize = plan_refinement(mesh, self.sonar, nearest, refine, self.free)

    def __call__(self, image: Any, mask: Any = None) -> PoseEstimate:
        """Find the poses at which the target may be in a frame.

        Args:
            image: The frame (range, beam).
            mask: True where a pixel was measured (range, beam); None means everywhere.

        Returns:
            The poses (hypothesis,), best first.

        Raises:
            SonarjaxError: A shape does not fit the sonar, or no part of the target can be seen at any distance.
        """
        return self.hypotheses(self.prepared(image, mask))

    def prepared(self, image: Any, mask: Any = None) -> Prepared:
        """Segment a frame, so that `hypotheses` can search it.

        Args:
            image: The frame (range, beam).
            mask: True where a pixel was measured (range, beam); None means everywhere.

        Returns:
            The frame with its semantic map.

        Raises:
            SonarjaxError: A shape does not fit the sonar, or a value is not finite.
        """
        image, mask = checked_image(image, mask, self.sonar)
        return Prepared(image, np.asarray(self.segmenter.semantic(image, mask, self.engine)), mask)

    def hypotheses(self, frame: Prepared) -> PoseEstimate:
        """Find the poses at which the target may be, by matching and refining on map and frame.

        Args:
            frame: The frame with its semantic map, from `prepared`.

        Returns:
            The poses (hypothesis,), best first.

        Raises:
            SonarjaxError: A shape does not fit the sonar, or no part of the target can be seen at any distance.
        """
        found = [self.lean.find(picture, frame.mask) for picture in (frame.semantic, frame.image)]
        start = jax.tree.map(lambda *v: np.concatenate(v), *(match.poses for match in found))
        on_map = self._refined(frame.semantic, start, self.refine, frame)
        start = _picked(kept(on_map, start), distinct(on_map, SAME, len(np.asarray(on_map.score))))
        first = self._refined(frame.image, start, self._on_frame(), frame)
        best = _picked(first.pose, distinct(first, APART, PERTURBED))
        second = self._refined(frame.image, self._perturbed(best), self._on_frame(), frame)
        found = jax.tree.map(lambda *v: np.concatenate([np.asarray(x) for x in v]), first, second)
        order = distinct(found, SAME, len(found.score))
        return self._widened(jax.tree.map(lambda v: v[order], found))

    def _widened(self, found: PoseEstimate) -> PoseEstimate:
        """The estimates (hypothesis,) with the covariance of the error bar."""
        found = jax.tree.map(jax.device_put, found)
        if self.error_bar is None:
            return found
        curvature, observable = np.asarray(found.covariance), np.asarray(found.observable)
        covariance = self.error_bar.covariance(curvature, observable, self.free)
        return replace(found, covariance=jax.device_put(covariance.astype(np.float32)))

    def _perturbed(self, poses: Pose) -> Pose:
        """Poses (hypothesis · change,) around each of `poses` (hypothesis,), with z, roll and pitch changed if
        they are free.
        """
        moved = []
        for name, by in PERTURBATIONS.items():
            if name in self.free:
                moved += [replace(poses, **{name: getattr(poses, name) + np.float32(way * by)}) for way in (1, -1)]
        return jax.tree.map(lambda *v: np.concatenate([np.asarray(x) for x in v]), *(moved or [poses]))

    def views(self, images: Any, sonar_poses: Pose, alone: Sequence[PoseEstimate] | None = None) -> PoseEstimate:
        """Find the poses that explain several views of one object at rest.

        Args:
            images: Frames (view, range, beam).
            sonar_poses: x, y [m] and yaw [rad] of each sonar (view,) in a common ground frame, which is that of the
                result.
            alone: The finder's estimate for each view by itself; None lets the finder make them.

        Returns:
            The poses (hypothesis,) in the common frame, best first.

        Raises:
            SonarjaxError: As `refine_pose`, or `alone` does not have one estimate for each view.
        """
        sonars = check_views(images, sonar_poses, Pose(), self.sonar)
        alone = [self(image) for image in np.asarray(images, np.float32)] if alone is None else list(alone)
        if len(alone) != len(sonars):
            raise SonarjaxError(f"alone: expected one estimate for each of {len(sonars)} views, got {len(alone)}")
        best = [_picked(found.pose, distinct(found, APART, KEPT_OF_EACH)) for found in alone]
        starts = [in_common(pose, sonar) for pose, sonar in zip(best, sonars, strict=True)]
        start = jax.tree.map(lambda *v: np.concatenate(v), *starts)
        how: dict[str, Any] = {"free": self.free, "config": self._on_frame(), "window": self.window}
        found = refine_pose(images, self.mesh, self.sonar, start, sonar_poses=sonar_poses, engine=self.engine, **how)
        order = np.argsort(-np.asarray(found.score))
        return self._widened(jax.tree.map(lambda v: v[order], found))

    def _on_frame(self) -> RefineConfig:
        return replace(self.refine, blurs=FINDING_BLURS[-len(self.refine.blurs) :], template="either")

    def _refined(self, picture: np.ndarray, start: Pose, config: RefineConfig, frame: Prepared) -> PoseEstimate:
        count = start.shape[0]
        pictures = np.broadcast_to(picture, (1, *picture.shape))
        starts = jax.tree.map(lambda v: np.asarray(v).reshape(1, count), start)
        mask = None if frame.mask is None else frame.mask[None]
        how: dict[str, Any] = {"free": self.free, "mask": mask, "config": config, "window": self.window}
        found = refine_pose(pictures, self.mesh, self.sonar, starts, engine=self.engine, **how)
        return jax.tree.map(lambda v: v[0], found)


def kept(estimate: PoseEstimate, start: Pose) -> Pose:
    """The refined poses, but the start where refinement neither converged nor fits better."""
    better = np.asarray(estimate.converged) | np.asarray(estimate.score > estimate.start_score)
    return jax.tree.map(lambda new, old: np.where(better, np.asarray(new), np.asarray(old)), estimate.pose, start)


def distinct(estimate: PoseEstimate, apart: float, most: int) -> np.ndarray:
    """Numbers of the best-scoring poses (hypothesis,), each rotated by `apart` [rad] or more from all before it."""
    turns, scores = np.asarray(_rotations(estimate.pose)), np.asarray(estimate.score)
    return np.asarray(distinct_turns(turns, scores, apart, most))


@jax.jit
def _rotations(poses: Pose) -> Float[Array, "hypothesis 3 3"]:
    return jax.vmap(Pose.rotation)(poses)


def _picked(poses: Pose, order: np.ndarray) -> Pose:
    return jax.tree.map(lambda v: np.asarray(v)[order], poses)
