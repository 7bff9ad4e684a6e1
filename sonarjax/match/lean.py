"""Which way an object leans: match a bank over yaw, roll, pitch and height where the upright template matched.

An upright template suffices to find the place: the correlation falls with lean, but not everywhere alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_whole, is_number, several, shown
from sonarjax.match.ncc import PreparedBank, match_positions
from sonarjax.match.search import SEARCH_MIN_VALID, SIZE_STEPS, Match, TargetSearch, coarse_bank, coarse_frame, mid_fan
from sonarjax.render import TemplateBank, WindowSize, template_bank
from sonarjax.scene import Mesh, Pose

COLUMN_STEP, ROW_STEP = 32, 64
"""The window of a leaning object is rounded up to multiples of this many beams and range bins."""


@dataclass(frozen=True)
class LeanSearchConfig:
    """Which poses of a leaning or lifted object are tried."""

    yaw_bins: int = 24
    """Number of yaws over the full circle."""
    lean: float = math.radians(10.0)
    """Roll and pitch, where they are free, are tried at 0 and at ± this angle [rad]."""
    lifts: tuple[float, ...] = (0.01, 0.04)
    """Heights of the lowest point above the floor [m] that are tried if z is free; otherwise z is 0."""
    candidates: int = 6
    """Most poses that are kept."""
    apart: float = math.radians(25.0)
    """Least rotation between two of them [rad]."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for counts below 1, no lift, or angles that are out of bounds."""
        check_whole(self.yaw_bins, 1, "yaw_bins")
        check_whole(self.candidates, 1, "candidates")
        lifts = several(self.lifts)
        if not lifts or not all(is_number(lift) and math.isfinite(lift) for lift in lifts):
            raise SonarjaxError(f"lifts: expected at least one finite number [m], got {shown(self.lifts)}")
        object.__setattr__(self, "lifts", tuple(float(lift) for lift in lifts))
        for name, most, text in (("lean", math.pi / 2, "π/2"), ("apart", math.pi, "π")):
            angle = getattr(self, name)
            if not (is_number(angle) and 0 < angle < most):
                raise SonarjaxError(f"{name}: expected an angle above 0 and below {text} [rad], got {shown(angle)}")


class LeanMatch(NamedTuple):
    """The poses that match best, best first."""

    poses: Pose
    """Poses (candidate,) that the object may have."""
    scores: Float[np.ndarray, "candidate"]
    """NCC (eq. 4) of each pose."""


class _Bank(NamedTuple):
    """A bank at one distance, ready to be matched."""

    bank: TemplateBank
    prepared: PreparedBank


class LeanSearch:
    """The banks of leaning poses of one target, for one sonar; each is rendered when a frame first needs it."""

    def __init__(
        self, search: TargetSearch, free: Sequence[str], config: LeanSearchConfig = LeanSearchConfig()
    ) -> None:
        """Set up the banks of a target's leaning poses.

        Args:
            search: The search that finds the target's place.
            free: Free numbers; of these z, roll and pitch are tried at several values.
            config: Which poses are tried.
        """
        self.search, self.config = search, config
        self.attitudes = _attitudes(search.mesh, free, config)
        self._banks: dict[tuple[int, bool], _Bank] = {}

    def find(self, image: np.ndarray, mask: np.ndarray | None = None) -> LeanMatch:
        """Find the poses that match a frame or semantic map best.

        Args:
            image: Frame or semantic map (range, beam).
            mask: True for the pixels that count (range, beam); None for all.

        Returns:
            `poses` (candidate,) [m, rad] and their `scores` (candidate,), best first.

        Raises:
            SonarjaxError: No part of the target can be seen at any distance, or none of its leaning poses at
                the distance where it was found.
        """
        search, step = self.search, self.search.config.decimation
        place = search.place(search.find(np.asarray(image, np.float32), mask))
        index = int(np.argmin(np.abs(search.distances - math.hypot(*place))))
        entry = self._bank(index, mask is not None)
        small, seen = coarse_frame(np.asarray(image, np.float32), mask, step)
        found = match_positions(small, entry.prepared, seen, min_valid=SEARCH_MIN_VALID, penalise_unmeasured=True)
        scores, rows, columns = jax.device_get((found.scores, found.row, found.col))
        top, left = (int(v) for v in np.asarray(entry.bank.offset))
        turns = np.stack([_rotation(*attitude) for attitude in self.attitudes[:, [0, 2, 3]]])
        kept = distinct_turns(turns, scores, self.config.apart, self.config.candidates)
        poses = []
        for k in kept:
            match = Match(entry.bank, scores, step * int(rows[k]) - top, int(columns[k]) - left, entry.prepared)
            x, y = search.place(match)
            yaw, z, roll, pitch = self.attitudes[k]
            # A bank's aspect is relative to the bearing at which it was rendered.
            poses.append((x, y, yaw + math.atan2(y, x) - float(entry.bank.bearing), z, roll, pitch))
        return LeanMatch(Pose(*np.asarray(poses, np.float32).T), np.asarray(scores)[kept])

    def _bank(self, index: int, masked: bool) -> _Bank:
        """The bank at distance number `index`. Raises SonarjaxError if the object is out of view there."""
        if (index, masked) not in self._banks:
            search, step = self.search, self.search.config.decimation
            yaws, z, roll, pitch = self.attitudes.T
            x, y = mid_fan(search.sonar, float(search.distances[index]))
            bank = template_bank(
                search.mesh, search.sonar, yaws, x=x, y=y, z=z, roll=roll, pitch=pitch,
                size=self._window(), quality=search.config.quality, engine=search.engine,
            )  # fmt: skip
            # No fine templates come after these, so they must reach as far to port as to starboard.
            prepared = coarse_bank(bank.templates, search.sonar, step, masked, (SIZE_STEPS[0], 1))
            self._banks[index, masked] = _Bank(bank, prepared)
        return self._banks[index, masked]

    def _window(self) -> WindowSize:
        """All ranges and beams, because the place may be anywhere; only the object's beams cost anything."""
        sonar = self.search.sonar
        return WindowSize(sonar.shape, sonar.n_beams)


def distinct_turns(turns: np.ndarray, scores: np.ndarray, apart: float, most: int) -> list[int]:
    """Numbers of the poses with the best `scores` (pose,), at most `most` of them.

    Each is rotated by `apart` [rad] or more from all before it. `turns` (pose, 3, 3) are the rotations.
    """
    kept: list[int] = []
    for k in np.argsort(-scores):
        cosines = [(np.trace(turns[k].T @ turns[other]) - 1) / 2 for other in kept]
        if all(cosine < math.cos(apart) for cosine in cosines):
            kept.append(int(k))
        if len(kept) == most:
            break
    return kept


def _attitudes(mesh: Mesh, free: Sequence[str], config: LeanSearchConfig) -> np.ndarray:
    """Yaw [rad], z [m], roll and pitch [rad] of each template (template, 4)."""
    yaws = np.arange(config.yaw_bins) * (2 * math.pi / config.yaw_bins)
    rolls, pitches = ((0.0, -config.lean, config.lean) if name in free else (0.0,) for name in ("roll", "pitch"))
    lifts = config.lifts if "z" in free else (0.0,)
    vertices, found = np.asarray(mesh.vertices, float), []
    for roll, pitch in itertools.product(rolls, pitches):
        # If z is free, the lowest point of the leaning object is put at each of the lifts.
        lowest = (vertices @ _rotation(0.0, roll, pitch).T)[:, 2].min() if "z" in free else 0.0
        found += [(yaw, lift - lowest, roll, pitch) for lift in lifts for yaw in yaws]
    return np.asarray(found, np.float32)


def _rotation(yaw: Any, roll: Any, pitch: Any) -> np.ndarray:
    """Rotation matrix (3, 3) as in `Pose`."""
    return np.asarray(Pose(yaw=yaw, roll=roll, pitch=pitch).rotation(), float)
