"""How an object may move between frames, and how frames are weighted: frozen records of numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_whole, is_number, shown

SHORTEST_MEMORY = 0.1
"""Least `memory` [frames]: evidence fades by exp(-1 / memory), which must not become 0."""


@dataclass(frozen=True)
class Standing:
    """An object that stays where it is, apart from a slow drift."""

    yaw_drift: float = 0.0
    """Standard deviation of the change of yaw from frame to frame [rad]."""
    place_drift: float = 0.0
    """Standard deviation of the change of x and of y from frame to frame [m]."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for negative or infinite drifts."""
        _check(self)


@dataclass(frozen=True)
class Turning:
    """An object that turns at a slowly changing rate: yaw grows by the rate, and the rate is a random walk.

    Rates are per frame, or per unit of the times that are given with the frames.
    """

    rate_std: float = math.radians(10.0)
    """Standard deviation of the rate before the first frame [rad/frame]. Its mean is 0: both directions are
    equally likely.
    """
    rate_drift: float = math.radians(0.5)
    """Standard deviation of the change of the rate from frame to frame [rad/frame]."""
    yaw_drift: float = math.radians(3.0)
    """Standard deviation of changes of yaw in addition to the rate [rad]; an object turned by hand turns unevenly."""
    place_drift: float = 0.005
    """Standard deviation of the change of x and of y from frame to frame [m]."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for negative or infinite numbers."""
        _check(self)


Motion = Standing | Turning


@dataclass(frozen=True)
class TrackConfig:
    """How frames are weighted. The defaults come from drawn validation sequences (experiments/fit_tracking.py)."""

    softness: float = 0.01
    """Difference in score that makes a hypothesis e times less likely [NCC]."""
    memory: float = 8.0
    """Number of frames over which evidence for one hypothesis against another accumulates; older evidence fades.

    Errors of neighbouring frames are alike. Hundreds of frames that slightly prefer one of two equal hypotheses must
    therefore not decide, and a belief that was right for hundreds of frames must still be able to change.
    """
    misses: float = 0.02
    """Share of frames that show the target but have no right hypothesis [1]."""
    alias: float = 0.1
    """Share of wrong hypotheses [1] that lie at another mode of the belief; the others may lie anywhere. Objects look
    alike at some other yaws, and the errors of a frame are much like those of the frame before.
    """
    floor: float = math.radians(0.53)
    """Standard deviation of the part of the yaw error that all frames of one aspect share [rad]."""
    aspect: float = math.radians(6.0)
    """Change of aspect over which the correlation of that part falls by a factor of e [rad]."""
    place_floor: float = 0.005
    """Standard deviation of the error of x and of y that all frames share, in the sonar's frame [m]."""
    place_std: float = 0.005
    """Standard deviation of the error of x and of y that differs from frame to frame [m]."""
    yaw_scale: float = 0.75
    """Factor on the recognizer's `yaw_std` for the part of the error that differs from frame to frame [1];
    `floor` is added to it in quadrature.
    """
    tail: float = 0.2
    """Share of right hypotheses whose errors are `tail_scale` times as large [1]; the tails are heavier than normal."""
    tail_scale: float = 6.0
    """Factor on the standard deviations of those hypotheses [1]."""
    area: float = 1.0
    """Area of floor over which a wrong hypothesis may lie anywhere [m²]."""
    components: int = 24
    """Number of Gaussians that are kept; another number means other compiled code."""
    hypotheses: int = 6
    """Number of hypotheses of a frame that are used, the best first; another number means other compiled code."""
    merge: float = 1.0
    """Gaussians that differ by less in yaw, x, y and rate are merged [standard deviations]."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for numbers that no tracker can have."""
        _check(self)
        shares = self.misses, self.tail, self.alias
        lengths = self.softness, self.memory, self.floor, self.aspect, self.place_floor, self.place_std, self.area
        if not all(0 < v < 1 for v in shares):
            raise SonarjaxError(f"TrackConfig: expected misses, tail and alias between 0 and 1, got {shares}")
        if not all(v > 0 for v in (*lengths, self.yaw_scale, self.tail_scale, self.merge)):
            raise SonarjaxError(f"TrackConfig: expected positive numbers, got {self}")
        if self.memory < SHORTEST_MEMORY:
            raise SonarjaxError(f"memory: expected {SHORTEST_MEMORY} frames or more, got {shown(self.memory)}")
        check_whole(self.components, 2, "components")
        check_whole(self.hypotheses, 1, "hypotheses")


def _check(config: object) -> None:
    """Raise a SonarjaxError for a field that is no number, negative or not finite."""
    for one in fields(config):  # type: ignore[arg-type]
        value = getattr(config, one.name)
        if not (is_number(value) and 0 <= value < math.inf):
            raise SonarjaxError(f"{one.name}: expected a number of 0 or more, got {shown(value)}")
