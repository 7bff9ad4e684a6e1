"""`Tracker`: a belief that is updated frame by frame. `track`: all frames of a log, optionally smoothed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, image_array, is_number, number_array, several, shown
from sonarjax.recognition import Recognition
from sonarjax.recognize import Recognizer
from sonarjax.refine import in_view
from sonarjax.refine.views import check_sonar_poses
from sonarjax.scene import Pose
from sonarjax.track.belief import Belief, next_belief, nothing_known, numbers_of, predicted
from sonarjax.track.measurement import Mode, each_of, measurement_of, modes_of
from sonarjax.track.motion import Motion, Standing, TrackConfig, Turning
from sonarjax.track.smooth import run_smoother

MOST_EXPECTED = 2
"""Most modes of a belief from which a frame is refined."""
LEAST_EXPECTED = 0.02
"""Least probability [1] of such a mode."""
WELL_KNOWN = math.radians(20.0)
"""Largest standard deviation of its predicted yaw [rad]; refinement does not reach farther."""


@dataclass(frozen=True)
class Tracked:
    """The belief after one frame."""

    modes: tuple[Mode, ...]
    """Possible poses, the most likely first; empty until a frame gives a hypothesis. Those of a frame that hardly shows
    the target have small probabilities.
    """
    recognition: Recognition | None
    """What this frame alone says; None if it could not be recognized."""
    error: str | None
    """Why it could not be recognized."""
    belief: Belief = field(repr=False)
    """The complete mixture."""

    @property
    def best(self) -> Mode:
        """The most likely mode. If there is none yet, NaN with infinite standard deviations."""
        nan = math.nan
        return self.modes[0] if self.modes else Mode(nan, nan, nan, nan, np.full((4, 4), np.inf), math.inf, 0.0)


@dataclass(frozen=True)
class Track:
    """The belief after each frame, or with `smooth` given all frames; arrays (frame,), poses in the common frame."""

    yaw: np.ndarray
    """Yaw (frame,) of the most likely mode [rad]; NaN until a frame gives a hypothesis."""
    yaw_std: np.ndarray
    """Its standard deviation (frame,) [rad], provided that this mode is the right one."""
    x: np.ndarray
    """Position (frame,) along x [m]."""
    y: np.ndarray
    """Position (frame,) along y [m]."""
    rate: np.ndarray
    """Growth of the yaw (frame,) [rad/frame]."""
    probability: np.ndarray
    """Probability (frame,) of the most likely mode [1]."""
    frames: tuple[Tracked, ...]
    """For each frame all modes, and what the frame alone says or why it could not be recognized."""
    beliefs: Belief = field(repr=False)
    """The mixtures (frame, component)."""
    smoothed: bool = False
    """Whether each frame's belief uses the later frames too."""

    @property
    def pose(self) -> Pose:
        """The most likely poses (frame,) [m, rad] on the floor."""
        return Pose(self.x, self.y, self.yaw)


class Tracker:
    """A recognizer and a belief. Call it with one frame after another."""

    def __init__(
        self, recognizer: Recognizer, motion: Motion = Standing(), *, config: TrackConfig = TrackConfig(),
        threshold: float | None = None, expect: bool = True,
    ) -> None:  # fmt: skip
        """Start without any knowledge.

        Args:
            recognizer: A recognizer of one target.
            motion: How the object may move between frames.
            config: How frames are weighted.
            threshold: The recognizer's threshold; by default that of its segmenter.
            expect: Refine each frame from the predicted poses too, so that the right hypothesis is among the frame's
                even if matching misses it.

        Raises:
            SonarjaxError: There is no recognizer, it has several targets, `motion` is not a motion, `config` no
                `TrackConfig`, or `threshold` no number.
        """
        check_kind(recognizer, Recognizer, "recognizer")
        check_kind(config, TrackConfig, "config")
        if len(recognizer.targets) != 1:
            raise SonarjaxError(f"recognizer: expected one with a single target, got {len(recognizer.targets)} targets")
        if not isinstance(motion, Standing | Turning):
            raise SonarjaxError(f"motion: expected Standing() or Turning(), got {motion!r}")
        if threshold is not None and not is_number(threshold):
            raise SonarjaxError(f"threshold: expected a number or None, got {shown(threshold)}")
        self.recognizer, self.motion, self.config = recognizer, motion, config
        self.threshold, self.expect = threshold, expect
        self.numbers = numbers_of(motion, config)
        self.belief = nothing_known(config)
        self._begun = False

    def __call__(
        self, image: Any, mask: Any = None, *, sonar_pose: Pose | None = None, elapsed: float = 1.0
    ) -> Tracked:
        """Recognize one more frame and update the belief by it.

        A frame that cannot be recognized raises nothing: the belief is only predicted, and `error` says why.

        Args:
            image: The frame (range, beam).
            mask: True where a pixel was measured (range, beam); None means everywhere.
            sonar_pose: Pose of the sonar in the common frame [m, rad]: the floor point below it and its heading. By
                default the common frame is the sonar's own.
            elapsed: Time since the previous frame [frames].

        Returns:
            The belief after this frame.

        Raises:
            SonarjaxError: The sonar's pose or the time cannot be used.
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
        """Recognize one frame by itself, refined from the predicted poses too; the belief stays as it is.

        Args:
            image: The frame (range, beam).
            mask: True where a pixel was measured (range, beam); None means everywhere.
            sonar_pose: Pose of the sonar in the common frame [m, rad]; None if that is the sonar's own.
            elapsed: Time since the previous frame [frames].

        Returns:
            What the frame alone says.

        Raises:
            SonarjaxError: As a `Recognizer`, or the sonar's pose or the time cannot be used.
        """
        at = _sonar_numbers(sonar_pose)
        _check_elapsed(elapsed)
        options: dict[str, Any] = {"threshold": self.threshold}
        if self.expect and self._begun and self.recognizer.refine is not None:
            options["starts"] = self._starts(at, elapsed)
        return self.recognizer(image, mask, **options)

    def take(
        self, found: Recognition | None, *, sonar_pose: Pose | None = None, elapsed: float = 1.0,
        error: str | None = None,
    ) -> Tracked:  # fmt: skip
        """Update the belief by a frame that was recognized elsewhere, or that could not be recognized.

        Args:
            found: What the frame alone says; None if it could not be recognized.
            sonar_pose: Pose of the sonar in the common frame [m, rad]; None if that is the sonar's own.
            elapsed: Time since the previous frame [frames]; it does not count for the first frame.
            error: Why the frame could not be recognized.

        Returns:
            The belief after this frame.

        Raises:
            SonarjaxError: The sonar's pose or the time cannot be used, or `found` is no Recognition.
        """
        if found is not None:
            check_kind(found, Recognition, "found")
        at = _sonar_numbers(sonar_pose)
        _check_elapsed(elapsed)
        elapsed = elapsed if self._begun else 0.0
        measurement = measurement_of(found, self.recognizer.search.yaw_bins, self.config, at, elapsed)
        self._begun = True
        self.belief = next_belief(self.belief, measurement, self.numbers)
        return Tracked(modes_of(self.belief), found, error, self.belief)

    def expected(self, sonar_pose: Pose | None = None, elapsed: float = 1.0) -> tuple[Mode, ...]:
        """Predict the modes of the belief for a later time.

        Args:
            sonar_pose: Pose of the sonar at that time in the common frame [m, rad]; None if that is the sonar's own.
            elapsed: Time since the last frame [frames].

        Returns:
            The predicted modes in the common frame, the most likely first.

        Raises:
            SonarjaxError: The sonar's pose or the time cannot be used.
        """
        at = _sonar_numbers(sonar_pose)
        _check_elapsed(elapsed)
        later = _predict(self.belief, jnp.asarray(at), jnp.float32(elapsed), self.numbers)
        return modes_of(replace(self.belief, mean=later.mean, covariance=later.covariance))

    def _starts(self, at: np.ndarray, elapsed: float) -> list[Pose]:
        """Poses at which the target is expected, in the frame of a sonar at `at` (3,)."""
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
    """Track a target over a sequence of frames, by a belief over its pose after each frame.

    This assumes one object, and a sonar whose geometry is right: only `TrackConfig.floor` allows for errors that all
    frames share.

    Args:
        frames: Images (range, beam) in the order in which they were taken.
        recognizer: A recognizer of one target.
        motion: How the object may move between frames.
        sonar_poses: The sonar's known poses (frame,) [m, rad] in a common frame on the floor. Views from several places
            then give one belief, in that frame.
        masks: One mask (range, beam) for each frame, true where a pixel was measured; None means everywhere.
        times: When each frame was taken (frame,), in the unit of the motion's rates. By default frames are 1 apart.
            After a gap in which the object may turn around, its yaw and rate are found anew.
        smooth: Let the belief of each frame use the later frames too.
        config: How frames are weighted.
        threshold, expect: As in `Tracker`.

    Returns:
        The belief after each frame, or with `smooth` given all frames.

    Raises:
        SonarjaxError: There are no frames, or something else than arrays; shapes differ; masks, poses or times do not
            fit; no frame can be recognized; the target is identified in none; or `recognizer` or `motion` does not suit
            a `Tracker`.
    """
    images, masked, poses, elapsed = _checked(frames, masks, sonar_poses, times)
    tracker = Tracker(recognizer, motion, config=config, threshold=threshold, expect=expect)
    if times is not None:
        _check_unit(elapsed[1:], motion)
    found = [
        tracker(image, mask, sonar_pose=pose, elapsed=gap)
        for image, mask, pose, gap in zip(images, masked, poses, elapsed, strict=True)
    ]
    return joined(found, tracker, smooth)


def joined(found: Sequence[Tracked], tracker: Tracker, smooth: bool = False) -> Track:
    """The `Track` from what a tracker returned for each frame. Raises SonarjaxError if no frame shows the target."""
    if all(one.recognition is None for one in found):
        raise SonarjaxError(f"frames: none of {len(found)} could be recognized; first error: {found[0].error}")
    if not any(one.recognition is not None and one.recognition.identified for one in found):
        raise SonarjaxError(f"frames: the target was not identified in any of {len(found)}")
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
    if isinstance(frames, str) or not isinstance(frames, Iterable):
        raise SonarjaxError(f"frames: expected a sequence of images (range, beam), got {shown(frames)}")
    images = [image_array(image, f"frames[{k}]") for k, image in enumerate(frames)]
    if not images:
        raise SonarjaxError("frames: expected at least one")
    for k, image in enumerate(images):
        if image.shape != images[0].shape:
            raise SonarjaxError(f"frames[{k}]: expected shape {images[0].shape} as in frame 0, got {image.shape}")
    masked = [None] * len(images) if masks is None else _one_for_each(masks, "masks")
    poses = _poses(sonar_poses, len(images))
    if len(masked) != len(images):
        raise SonarjaxError(f"masks: expected one for each of {len(images)} frames, got {len(masked)}")
    for k, mask in enumerate(masked):
        if mask is not None and number_array(mask, f"masks[{k}]").shape != images[k].shape:
            raise SonarjaxError(f"masks[{k}]: expected the frame's shape {images[k].shape}, got {np.shape(mask)}")
    elapsed = [1.0] * len(images)
    if times is not None:
        at = np.asarray(number_array(times, "times"), float)
        if at.shape != (len(images),) or not np.isfinite(at).all() or (np.diff(at) < 0).any():
            raise SonarjaxError(f"times: expected {len(images)} finite numbers that do not decrease")
        elapsed = [0.0, *np.diff(at).tolist()]
    return images, masked, poses, elapsed


def _check_unit(elapsed: list[float], motion: Motion) -> None:
    """Raise a SonarjaxError if an object may turn more than once around between any two frames: the unit is wrong.

    Two frames alone, or a few long gaps, are no reason to think so.
    """
    gaps = [gap for gap in elapsed if gap > 0]
    least = min(gaps, default=0.0)
    if isinstance(motion, Turning) and len(gaps) > 1 and motion.rate_std * least > 2 * math.pi:
        raise SonarjaxError(
            f"times: frames are {shown(least)} or more apart, in which a rate_std of {shown(motion.rate_std)} rad "
            "turns the object more than once around; expected times in the unit of the motion's rates"
        )


def _poses(given: Any, count: int) -> list[Pose | None]:
    if given is None:
        return [None] * count
    if isinstance(given, Pose):
        if given.shape != (count,):
            raise SonarjaxError(f"sonar_poses: expected one for each of {count} frames, got shape {given.shape}")
        return [jax.tree.map(lambda v, k=k: v[k], given) for k in range(count)]
    poses = _one_for_each(given, "sonar_poses")
    if len(poses) != count:
        raise SonarjaxError(f"sonar_poses: expected one for each of {count} frames, got {len(poses)}")
    return poses


def _one_for_each(values: Any, name: str) -> list[Any]:
    """The values as a list. Raises SonarjaxError for what holds none."""
    found = several(values)
    if found is None:
        raise SonarjaxError(f"{name}: expected one for each frame, got {shown(values)}")
    return list(found)


def _sonar_numbers(pose: Pose | None) -> np.ndarray:
    """x, y [m] and yaw [rad] (3,) of the sonar.

    Raises:
        SonarjaxError: It is no single pose of finite numbers, or it leans or is lifted.
    """
    if pose is None:
        return np.zeros(3, np.float32)
    if not isinstance(pose, Pose) or pose.shape != ():
        raise SonarjaxError(f"sonar_pose: expected one Pose, got {pose!r}")
    at = np.array([pose.x, pose.y, pose.yaw], np.float32)
    if not np.isfinite(at).all():
        raise SonarjaxError(f"sonar_pose: expected finite x, y and yaw, got {at.tolist()}")
    check_sonar_poses(pose, "sonar_pose")
    return at


def _check_elapsed(elapsed: float) -> None:
    if not (is_number(elapsed) and 0 <= elapsed < math.inf):
        raise SonarjaxError(f"elapsed: expected a time of 0 or more, got {shown(elapsed)}")
