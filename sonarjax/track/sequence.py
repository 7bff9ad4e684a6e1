"""`Tracker`: a belief fed frame by frame; `track`: all frames of a log, perhaps smoothed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.recognize import Recognition, Recognizer
from sonarjax.refine import in_view
from sonarjax.scene import Pose
from sonarjax.track.belief import Belief, next_belief, nothing_known, numbers_of, predicted
from sonarjax.track.measurement import Mode, each_of, measurement_of, modes_of
from sonarjax.track.motion import Motion, Standing, TrackConfig, Turning
from sonarjax.track.smooth import run_smoother

MOST_EXPECTED = 2
"""Modes of a belief from which a frame's hypotheses are refined, at most."""
LEAST_EXPECTED = 0.02
"""Least probability [1] of such a mode."""
WELL_KNOWN = math.radians(20.0)
"""Largest standard deviation of its predicted yaw [rad]: refining does not reach farther."""


@dataclass(frozen=True)
class Tracked:
    """What is believed after one frame."""

    modes: tuple[Mode, ...]
    """Possible poses, the likeliest first; empty before the target was first seen."""
    recognition: Recognition | None
    """What the frame alone says; None where it could not be recognized."""
    error: str | None
    """Why it could not."""
    belief: Belief = field(repr=False)
    """The whole mixture."""

    @property
    def best(self) -> Mode:
        """The likeliest mode; where nothing was seen yet, NaN with infinite standard deviations."""
        nan = math.nan
        return self.modes[0] if self.modes else Mode(nan, nan, nan, nan, np.full((4, 4), np.inf), math.inf, 0.0)


@dataclass(frozen=True)
class Track:
    """What is believed after each frame, or with `smooth` after all; arrays (frame,), poses in the common frame."""

    yaw: np.ndarray
    """Yaw (frame,) of the likeliest mode [rad]; NaN before the target was first seen."""
    yaw_std: np.ndarray
    """Its standard deviation (frame,) [rad], if this mode is the right one."""
    x: np.ndarray
    """Position (frame,) along x [m]."""
    y: np.ndarray
    """Position (frame,) along y [m]."""
    rate: np.ndarray
    """Growth of the yaw (frame,) [rad/frame]."""
    probability: np.ndarray
    """Probability (frame,) of the likeliest mode [1]."""
    frames: tuple[Tracked, ...]
    """All modes, what each frame alone says, or why it could not be recognized."""
    beliefs: Belief = field(repr=False)
    """The mixtures (frame, component)."""
    smoothed: bool = False
    """Whether each frame's belief knows the later frames too."""

    @property
    def pose(self) -> Pose:
        """The likeliest poses (frame,) [m, rad] on the floor."""
        return Pose(self.x, self.y, self.yaw)


class Tracker:
    """A recognizer and a belief: call it with one frame after another."""

    def __init__(
        self, recognizer: Recognizer, motion: Motion = Standing(), *, config: TrackConfig = TrackConfig(),
        threshold: float | None = None, expect: bool = True,
    ) -> None:  # fmt: skip
        """Nothing is known yet. `threshold` is the recognizer's, if not the segmenter's own.

        With `expect` each frame is refined from the predicted poses too: where matching goes astray, the right
        hypothesis is still among the frame's.
        Raises SonarjaxError for a recognizer of several targets, or what is no motion.
        """
        if len(recognizer.targets) != 1:
            raise SonarjaxError(f"recognizer: expected one of a single target, got {len(recognizer.targets)}")
        if not isinstance(motion, Standing | Turning):
            raise SonarjaxError(f"motion: expected Standing() or Turning(), got {motion!r}")
        self.recognizer, self.motion, self.config = recognizer, motion, config
        self.threshold, self.expect = threshold, expect
        self.numbers = numbers_of(motion, config)
        self.belief = nothing_known(config)
        self._begun = False

    def __call__(
        self, image: Any, mask: Any = None, *, sonar_pose: Pose | None = None, elapsed: float = 1.0
    ) -> Tracked:
        """The belief after one more frame `image` (range, beam), of which `mask` is true where it was measured.

        `sonar_pose` is where the sonar is in the common frame [m, rad]: its floor point and heading; the common frame
        is the sonar's own where none is given. `elapsed` is the time since the frame before, in frames.
        What cannot be recognized costs this frame alone: the belief is predicted, and `error` says why.
        Raises SonarjaxError for a sonar's pose or a time that cannot be used.
        """
        _sonar_numbers(sonar_pose)
        _check_elapsed(elapsed)
        found, error = None, None
        try:
            found = self.recognize(image, mask, sonar_pose=sonar_pose, elapsed=elapsed)
        except SonarjaxError as problem:
            error = " ".join(str(problem).split())
        return self.take(found, sonar_pose=sonar_pose, elapsed=elapsed, error=error)

    def recognize(
        self, image: Any, mask: Any = None, *, sonar_pose: Pose | None = None, elapsed: float = 1.0
    ) -> Recognition:
        """What one frame (range, beam) says, refined from the predicted poses too; the belief stays as it is.

        Raises SonarjaxError as a `Recognizer` does.
        """
        at = _sonar_numbers(sonar_pose)
        options: dict[str, Any] = {"threshold": self.threshold}
        if self.expect and self._begun and self.recognizer.refine is not None:
            options["starts"] = self._starts(at, elapsed)
        return self.recognizer(image, mask, **options)

    def take(
        self, found: Recognition | None, *, sonar_pose: Pose | None = None, elapsed: float = 1.0,
        error: str | None = None,
    ) -> Tracked:  # fmt: skip
        """The belief after a frame that was recognized elsewhere, or that could not be (None, and why)."""
        at = _sonar_numbers(sonar_pose)
        _check_elapsed(elapsed)
        elapsed = elapsed if self._begun else 0.0
        measurement = measurement_of(found, self.recognizer.search.yaw_bins, self.config, at, elapsed)
        self._begun = True
        self.belief = next_belief(self.belief, measurement, self.numbers)
        return Tracked(modes_of(self.belief), found, error, self.belief)

    def expected(self, sonar_pose: Pose | None = None, elapsed: float = 1.0) -> tuple[Mode, ...]:
        """The modes as they will be in the common frame after `elapsed` [frames], the sonar then at `sonar_pose`."""
        at = _sonar_numbers(sonar_pose)
        mean, covariance, _, _ = _predict(self.belief, jnp.asarray(at), jnp.float32(elapsed), self.numbers)
        return modes_of(replace(self.belief, mean=mean, covariance=covariance))

    def _starts(self, at: np.ndarray, elapsed: float) -> list[Pose]:
        """Where the target is expected in the frame of a sonar at `at` (3,)."""
        modes = self.expected(Pose(*at.tolist()), elapsed)[:MOST_EXPECTED]
        known = [m for m in modes if m.probability >= LEAST_EXPECTED and m.yaw_std <= WELL_KNOWN]
        return [in_view(Pose(mode.x, mode.y, mode.yaw), at) for mode in known]


_predict = jax.jit(predicted)


def track(
    frames: Sequence[Any],
    recognizer: Recognizer,
    motion: Motion = Standing(),
    *,
    sonar_poses: Pose | Sequence[Pose] | None = None,
    masks: Sequence[Any] | None = None,
    times: Any = None,
    smooth: bool = False,
    config: TrackConfig = TrackConfig(),
    threshold: float | None = None,
    expect: bool = True,
) -> Track:
    """A belief over the target's pose after each of the `frames`, images (range, beam) in the order they were taken.

    `motion` says how the object may move between them. `sonar_poses` (frame,) are the sonar's known poses [m, rad] in
    a common frame on the floor: views from several places become one belief, in that frame. `masks` are true where a
    pixel was measured, None for all; `times` (frame,) say when frames were taken, in the unit of the motion's rates,
    and are the frames' numbers without. With `smooth` the belief of each frame knows the later ones too. The rest is
    as in `Tracker`. It assumes one object, and a sonar whose geometry is right: what is wrong in all frames alike is
    in `TrackConfig.floor` only.

    Raises SonarjaxError for no frames, mixed shapes, masks, poses or times that do not fit them, frames none of which
    can be recognized, and where the target is identified in none.
    """
    images, masked, poses, elapsed = _checked(frames, masks, sonar_poses, times)
    tracker = Tracker(recognizer, motion, config=config, threshold=threshold, expect=expect)
    found = [
        tracker(image, mask, sonar_pose=pose, elapsed=gap)
        for image, mask, pose, gap in zip(images, masked, poses, elapsed, strict=True)
    ]
    return joined(found, tracker, smooth)


def joined(found: Sequence[Tracked], tracker: Tracker, smooth: bool = False) -> Track:
    """The `Track` of what a tracker gave for each frame. Raises SonarjaxError where no frame shows the target."""
    if all(one.recognition is None for one in found):
        raise SonarjaxError(f"frames: none of {len(found)} could be recognized; the first: {found[0].error}")
    if not any(one.recognition is not None and one.recognition.identified for one in found):
        raise SonarjaxError(f"frames: the target was identified in none of {len(found)}")
    beliefs = jax.tree.map(lambda *v: jnp.stack(v), *[one.belief for one in found])
    if smooth:
        beliefs = run_smoother(beliefs, tracker.numbers)
        found = [
            Tracked(modes_of(belief), one.recognition, one.error, belief)
            for one, belief in zip(found, each_of(beliefs), strict=True)
        ]
    best = [one.best for one in found]
    columns = {name: np.array([getattr(mode, name) for mode in best]) for name in _COLUMNS}
    return Track(**columns, frames=tuple(found), beliefs=beliefs, smoothed=smooth)


_COLUMNS = ("yaw", "yaw_std", "x", "y", "rate", "probability")


def _checked(
    frames: Sequence[Any], masks: Sequence[Any] | None, sonar_poses: Any, times: Any
) -> tuple[list[np.ndarray], list[Any], list[Pose | None], list[float]]:
    images = [np.asarray(image) for image in frames]
    if not images:
        raise SonarjaxError("frames: expected at least one")
    for k, image in enumerate(images):
        if image.shape != images[0].shape:
            raise SonarjaxError(f"frames: expected one shape, got {images[0].shape} and, of frame {k}, {image.shape}")
    masked = [None] * len(images) if masks is None else list(masks)
    poses = _poses(sonar_poses, len(images))
    if len(masked) != len(images):
        raise SonarjaxError(f"masks: expected one for each of {len(images)} frames, got {len(masked)}")
    elapsed = [1.0] * len(images)
    if times is not None:
        at = np.asarray(times, float)
        if at.shape != (len(images),) or not np.isfinite(at).all() or (np.diff(at) < 0).any():
            raise SonarjaxError(f"times: expected {len(images)} finite numbers that do not decrease")
        elapsed = [0.0, *np.diff(at).tolist()]
    return images, masked, poses, elapsed


def _poses(given: Any, count: int) -> list[Pose | None]:
    if given is None:
        return [None] * count
    if isinstance(given, Pose):
        if given.shape != (count,):
            raise SonarjaxError(f"sonar_poses: expected one for each of {count} frames, got shape {given.shape}")
        return [jax.tree.map(lambda v, k=k: v[k], given) for k in range(count)]
    if len(given) != count:
        raise SonarjaxError(f"sonar_poses: expected one for each of {count} frames, got {len(given)}")
    return list(given)


def _sonar_numbers(pose: Pose | None) -> np.ndarray:
    """x, y [m] and yaw [rad] (3,) of the sonar. Raises SonarjaxError unless it is one pose of finite numbers."""
    if pose is None:
        return np.zeros(3, np.float32)
    if not isinstance(pose, Pose) or pose.shape != ():
        raise SonarjaxError(f"sonar_pose: expected one Pose, got {pose!r}")
    at = np.array([pose.x, pose.y, pose.yaw], np.float32)
    if not np.isfinite(at).all():
        raise SonarjaxError(f"sonar_pose: expected finite x, y and yaw, got {at.tolist()}")
    return at


def _check_elapsed(elapsed: float) -> None:
    if not 0 <= elapsed < math.inf:
        raise SonarjaxError(f"elapsed: expected a time of 0 or more, got {elapsed}")
