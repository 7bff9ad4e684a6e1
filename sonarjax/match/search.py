"""Where in a frame an object is, and at which yaw bin: banks at several distances, coarse first (eq. 4).

`TargetSearch` is prepared for one target and one sonar. Rendering and matching are pure functions; which bank is
matched next is decided on the host.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import OutOfViewError, SonarjaxError
from sonarjax.io.given import check_kind, check_whole, is_number, shown
from sonarjax.match.compact import CompactBank, match_compact
from sonarjax.match.echoes import echo_templates
from sonarjax.match.ncc import PreparedBank, match_positions, prepare_bank
from sonarjax.render import (
    RenderQuality,
    TemplateBank,
    WindowSize,
    bank_place,
    check_fits,
    floor_point,
    plan_window,
    template_bank,
)
from sonarjax.render.simulate import check_sonar_alone
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar
from sonarjax.sonar.check import check_sonar

Picture = Literal["map", "frame"]
"""What is searched: a semantic map, with semantic templates, or a sonar's frame, with echo templates."""
SEARCH_MIN_VALID = 0.5
"""Least share of a template's pixels that were measured, where part of the frame is masked. It is more than that of
`match_bank`, because a search looks everywhere and would find a template of which little was measured.
"""
SIZE_STEPS = 32, 32
"""Coarse templates are rounded up to multiples of this many coarse rows and beams.

So they cannot be shifted as far to port as to starboard, which does no harm: fine templates, which are not rounded up,
find the object afterwards. A margin of background to port of the frame was tried, and raw frames then matched worse.
"""
NOT_SEEN = "{}: at no distance inside the sonar's view is any part of it visible"
"""Error message; the target's name goes in."""
KEPT_COMPACT = 4
"""Number of banks that a target of a catalogue keeps: those of the distances used last."""
MAX_DISTANCES = 1000
"""Most distances of a search (100 m of floor), as each costs a bank."""


@dataclass(frozen=True)
class SearchConfig:
    """How a target is searched for in a frame."""

    yaw_bins: int = 36
    """Templates over the full circle; the paper's 10°."""
    range_step: float = 0.1
    """Distance between banks [m]. Templates for a distance that is far off lose accuracy (`ablate --vary distance`)."""
    coarse_every: int = 3
    """The coarse search uses every such distance: 3 means every third."""
    coarse_yaws: int = 18
    """About how many yaws the coarse search tries: every floor(yaw_bins / coarse_yaws)-th yaw bin.
    That is every bin where there are more of them than bins.
    """
    decimation: int = 4
    """Range bins that are averaged into one in the coarse search; not more than a frame has."""
    hypotheses: int = 2
    """Most yaws from the map that are refined. The frame's best yaw, and poses given as `starts`, are refined too."""
    quality: RenderQuality = RenderQuality(sub_beams=1)
    """How finely templates are rendered."""
    candidates: int = 5
    """Of several targets, the most that are refined and compared: those that match best in a first look at all.

    More candidates include the right one a little more often, and take longer (experiments/fit_candidates.py)."""
    lead: float = 0.1
    """A target is a candidate only if it is at most this much worse than the best in the first look, in correlation
    with the map, or at most half as much worse in correlation with the frame itself. The two best are always
    candidates."""
    rank: int = 64
    """Components of the low-rank bank that represents all targets' templates at one distance in the first look."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for numbers that no search can have."""
        check_whole(self.yaw_bins, 4, "yaw_bins")  # peaks need neighbours
        for name in ("coarse_every", "coarse_yaws", "decimation", "hypotheses", "candidates", "rank"):
            check_whole(getattr(self, name), 1, name)
        if not (is_number(self.range_step) and 0 < self.range_step < math.inf):
            raise SonarjaxError(f"range_step: expected a positive number of metres, got {shown(self.range_step)}")
        check_kind(self.quality, RenderQuality, "quality")
        if not (is_number(self.lead) and self.lead >= 0):
            raise SonarjaxError(f"lead: expected a number of 0 or more, got {shown(self.lead)}")


class Match(NamedTuple):
    """How well one bank matches a frame, and where."""

    bank: TemplateBank
    """The bank that was matched."""
    scores: np.ndarray
    """NCC (yaw,) of each template."""
    rows: int
    """Range bins by which the best template is shifted from where it was rendered."""
    columns: int
    """Beams by which it is shifted."""
    matched: PreparedBank | CompactBank
    """The templates that it was matched by: those of the bank, or echo templates."""

    def own_scores(self) -> np.ndarray:
        """Match the best template itself with all templates, without a shift (eq. 4).

        These are about the scores of a frame without noise that shows the target at the best yaw: all nearly 1 for a
        round object.

        Returns:
            NCC (yaw,) of each template and the best one; 0 for a template without any contrast.
        """
        flat = np.asarray(self.matched.templates, np.float32).reshape(len(self.scores), -1)
        best = flat[self.scores.argmax()]
        best = best - best.mean()
        norms = np.sqrt(flat.shape[1]) * flat.std(axis=1) * np.linalg.norm(best)
        varied = np.ptp(flat, axis=1) > 0  # the norm of a constant template is not quite 0 in float32
        return np.divide(flat @ best, norms, out=np.zeros_like(norms), where=varied & varied[self.scores.argmax()])


class _Entry(NamedTuple):
    """A bank and what matching keeps of it."""

    bank: TemplateBank
    prepared: PreparedBank | CompactBank


class TargetSearch:
    """One target and one sonar, with the banks that were rendered for them so far."""

    def __init__(
        self, mesh: Mesh, sonar: Sonar, config: SearchConfig = SearchConfig(), *, name: str = "target",
        engine: Engine = PLAIN, compact: bool = False,
    ) -> None:  # fmt: skip
        """Prepare the search. Banks are rendered when a frame first needs them.

        Args:
            mesh: The target.
            sonar: The sonar.
            config: How to search.
            name: Name of the target, for error messages.
            engine: Runs the compiled functions.
            compact: Keep few banks, and small ones, at some cost in time.

        Raises:
            SonarjaxError: No distance is in view or too many are, the mesh is larger than the sonar's range, the
                `decimation` larger than its number of range bins, or a number of the sonar impossible.
        """
        if config.decimation > sonar.n_ranges:
            limit = f"at most the {sonar.n_ranges} range bins of a frame"
            raise SonarjaxError(f"decimation: expected {limit}, got {config.decimation}")
        check_sonar_alone(sonar)
        check_sonar(sonar, "sonar")  # `Sonar.replace` does not
        check_kind(engine, Engine, "engine")
        check_fits(mesh, sonar, name)
        self.mesh, self.sonar, self.config, self.name, self.engine = mesh, sonar, config, name, engine
        self.compact = compact
        self._banks: dict[tuple[int, bool, bool, Picture], _Entry | None] = {}
        self._rendered: dict[tuple[int, bool], TemplateBank] = {}  # matched with maps and with frames, rendered once
        self._lock = threading.Lock()  # several frames may be searched at once: each bank is rendered by the first
        self.distances = _ground_ranges(sonar, config.range_step)
        self.size = _bank_window(mesh, sonar, float(self.distances[0]))

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the lock, which cannot be copied or sent to another process."""
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """The copy gets a lock of its own."""
        vars(self).update(state)
        self._lock = threading.Lock()

    def find(self, image: np.ndarray, mask: np.ndarray | None = None, picture: Picture = "map") -> Match:
        """Find the best match over all distances: a coarse search, then banks near its best.

        Args:
            image: Frame or semantic map (range, beam).
            mask: True for the pixels that count (range, beam); None for all.
            picture: What the image is, and so which templates it is matched with.

        Returns:
            The best match.

        Raises:
            SonarjaxError: No part of the target can be seen at any distance.
        """
        every, masked = self.config.coarse_every, mask is not None
        small = coarse_frame(image, mask, self.config.decimation)
        indices = [k for k in range(0, len(self.distances), every) if self._bank(k, True, masked, picture) is not None]
        if not indices:
            raise SonarjaxError(NOT_SEEN.format(self.name))
        found = self.engine.map(lambda k: self._match(k, True, *small, picture), indices)
        first = max(found, key=lambda match: match.scores.max())
        return self.find_near(self.nearest(first), image, mask, picture)

    def find_near(
        self, index: int, image: np.ndarray, mask: np.ndarray | None = None, picture: Picture = "map"
    ) -> Match:
        """Match the bank at one distance, then the bank nearest to where that one found the object.

        Args:
            index: Number of the distance, in `distances`. If the target is out of view there, the nearest distance at
                which it is in view is taken instead.
            image: Frame or semantic map (range, beam).
            mask: True for the pixels that count (range, beam); None for all.
            picture: What the image is, and so which templates it is matched with.

        Returns:
            The better of the two matches.

        Raises:
            SonarjaxError: No part of the target can be seen at any distance.
        """
        masked = mask is not None
        index = self._in_view(index, masked, picture)
        best = self._match(index, False, image, mask, picture)
        closer = self._in_view(self.nearest(best), masked, picture)
        if closer == index:
            return best
        again = self._match(closer, False, image, mask, picture)
        return again if again.scores.max() > best.scores.max() else best

    def _in_view(self, index: int, masked: bool, picture: Picture) -> int:
        """The distance next to number `index` at which some of the object is in view.

        Raises SonarjaxError when there is none.
        """
        nearest_first = sorted(range(len(self.distances)), key=lambda k: abs(k - index))
        found = next((k for k in nearest_first if self._bank(k, False, masked, picture) is not None), None)
        if found is None:
            raise SonarjaxError(NOT_SEEN.format(self.name))
        return found

    def place(self, match: Match) -> tuple[float, float]:
        """Return the place of a match's object on the ground.

        Args:
            match: A match that this search found.

        Returns:
            Ground position x, y [m], forward and to port.
        """
        slant, azimuth = bank_place(match.bank, self.sonar)
        centers = np.asarray(self.sonar.azimuth)
        beam = np.interp(azimuth, centers, np.arange(len(centers))) + match.columns
        found = np.interp(beam, np.arange(len(centers)), centers)
        x, y = _floor_point(slant + match.rows * float(self.sonar.range_bin), found, self.sonar)
        return float(x), float(y)

    def nearest(self, match: Match) -> int:
        """Return the number of the distance that is nearest to a match's object.

        Args:
            match: A match that this search found.

        Returns:
            Its number in `distances`.
        """
        return int(np.argmin(np.abs(self.distances - math.hypot(*self.place(match)))))

    def _bank(self, index: int, coarse: bool, masked: bool, picture: Picture) -> _Entry | None:
        """The bank at distance `index`, ready to be matched; None where the object is not in view there."""
        key = (index, coarse, masked and not self.compact, picture)
        with self._lock:
            if key not in self._banks:
                self._banks[key] = self._prepared(index, coarse, masked, picture)
            found = self._banks[key]
            if self.compact and not coarse:
                self._make_room(key)
        return found

    def _make_room(self, latest: tuple[int, bool, bool, Picture]) -> None:
        """Let go of the fine banks that were looked at longest ago: a catalogue's memory does not grow with frames."""
        self._banks[latest] = self._banks.pop(latest)  # the last of the dict
        fine = [key for key, entry in self._banks.items() if entry is not None and not key[1]]
        for key in fine[:-KEPT_COMPACT]:
            del self._banks[key]

    def _prepared(self, index: int, coarse: bool, masked: bool, picture: Picture) -> _Entry | None:
        """As `_bank`, made anew."""
        config = self.config
        try:
            bank = self._render(index, coarse)
        except OutOfViewError:
            return None
        drawn: Any = bank.templates
        if picture == "frame":
            drawn = echo_templates(bank, self.mesh, self.sonar, self.size, config.quality, self.engine)
        if self.compact and not coarse:
            return _Entry(replace(bank, templates=bank.templates[:, :0, :0]), CompactBank.of(np.asarray(drawn)))
        if not coarse:
            frame = self.sonar.n_ranges, self.sonar.n_beams + 2 * _side(drawn)
            return _Entry(bank, prepare_bank(drawn, frame, masked=masked))
        return _Entry(bank, coarse_bank(drawn, self.sonar, config.decimation, masked))

    def _render(self, index: int, coarse: bool) -> TemplateBank:
        """The bank at distance `index`, rendered once but for catalogues. Raises OutOfViewError."""
        if (index, coarse) in self._rendered:
            return self._rendered[index, coarse]
        config = self.config
        every = max(config.yaw_bins // config.coarse_yaws, 1) if coarse else 1
        yaws = np.arange(0, config.yaw_bins, every) * (2 * math.pi / config.yaw_bins)
        x, y = mid_fan(self.sonar, float(self.distances[index]))
        bank = template_bank(
            self.mesh, self.sonar, yaws, x=x, y=y, size=self.size, quality=config.quality, engine=self.engine
        )
        if not self.compact:
            self._rendered[index, coarse] = bank
        return bank

    def _match(self, index: int, coarse: bool, image: np.ndarray, mask: np.ndarray | None, picture: Picture) -> Match:
        """The best place for each template of a bank in which something is in view."""
        entry = self._bank(index, coarse, mask is not None, picture)
        assert entry is not None
        side = 0 if coarse else _side(entry.prepared.templates)
        image, mask = widened(image, mask, side)
        if isinstance(entry.prepared, CompactBank) and mask is None:
            found = match_compact(image, entry.prepared)
        else:
            found = match_positions(image, entry.prepared, mask, min_valid=SEARCH_MIN_VALID, penalise_unmeasured=True)
        scores, row, column = jax.device_get((found.scores, found.row, found.col))
        best = int(scores.argmax())
        top, left = (int(v) for v in np.asarray(entry.bank.offset))
        scale = self.config.decimation if coarse else 1
        return Match(entry.bank, scores, scale * int(row[best]) - top, int(column[best]) - side - left, entry.prepared)


def _side(templates: Any) -> int:
    """Beams by which a frame is widened on either side for templates (yaw, h, w).

    The templates' box holds the object at every yaw and more, so it leaves the frame where the object does not yet.
    """
    return templates.shape[2] // 2


def widened(image: np.ndarray, mask: np.ndarray | None, side: int) -> tuple[np.ndarray, np.ndarray | None]:
    """A frame (range, beam) and its mask with `side` beams more on either side, of the mean grey of what was measured.

    The correlation (eq. 4) of a window that lies within the frame stays the same.
    """
    if not side:
        return image, mask
    measured = image if mask is None else image[np.asarray(mask, bool)]
    grey = measured.mean(dtype=np.float64) if measured.size else 0.0
    sides = (0, 0), (side, side)
    wide = np.pad(image, sides, constant_values=np.float32(grey))
    return wide, None if mask is None else np.pad(mask, sides, constant_values=True)


def mid_fan(sonar: Sonar, distance: float) -> tuple[float, float]:
    """Where banks are rendered: x, y [m] on the ground at a `distance` [m], in the middle of the field of view."""
    azimuth = np.asarray(sonar.azimuth)
    bearing = float(azimuth[0] + azimuth[-1]) / 2
    return distance * math.cos(bearing), distance * math.sin(bearing)


def decimated(image: np.ndarray, step: int) -> np.ndarray:
    """Means of `step` neighbouring range bins (..., range / step, beam); bins that are left over are dropped."""
    rows = image.shape[-2] // step
    groups = image[..., : rows * step, :].reshape(*image.shape[:-2], rows, step, image.shape[-1])
    return groups.mean(axis=-2)


def coarse_frame(image: np.ndarray, mask: np.ndarray | None, step: int) -> tuple[np.ndarray, np.ndarray | None]:
    """A frame (range, beam) for `coarse_bank`: `step` range bins are one, the mean of those that were measured.

    The mask, if there is one, is true where at least half of them were.
    """
    if mask is None:
        return decimated(image, step), None
    share = decimated(mask.astype(np.float32), step)
    small = decimated(np.where(mask, image, np.float32(0)), step) / np.maximum(share, np.float32(1e-6))
    return small.astype(np.float32), share >= 0.5


def coarse_bank(
    templates: Any, sonar: Sonar, step: int, masked: bool, sizes: tuple[int, int] = SIZE_STEPS
) -> PreparedBank:
    """Templates (yaw, h, w) ready to be matched with a `coarse_frame` of the sonar.

    They are rounded up to multiples of `sizes` coarse rows and beams.
    """
    views = np.asarray(templates)
    views = np.pad(views, ((0, 0), (0, max(step - views.shape[1], 0)), (0, 0)), constant_values=0.5)
    frame = sonar.n_ranges // step, sonar.n_beams
    return prepare_bank(rounded_up(decimated(views, step), frame, sizes), frame, masked=masked)


_floor_point = jax.jit(floor_point)


def _bank_window(mesh: Mesh, sonar: Sonar, nearest: float) -> WindowSize:
    """One window for the banks of all distances, in coarse steps: sonars at several tilts share compiled code."""
    planned = plan_window(mesh, sonar, nearest)
    assert planned.object_columns is not None
    columns, beams = (min(-(-n // 32) * 32, sonar.n_beams) for n in (planned.shape[1], planned.object_columns))
    return WindowSize((sonar.n_ranges, columns), beams)


def rounded_up(templates: np.ndarray, frame: tuple[int, int], steps: tuple[int, int] = SIZE_STEPS) -> np.ndarray:
    """Coarse templates (yaw, h, w) with background added past the object and to port: few shapes, so few to be
    compiled.
    """
    sizes = zip(templates.shape[1:], frame, steps, strict=True)
    room = ((0, min(-n % step, most - n)) for n, most, step in sizes)
    return np.pad(templates, ((0, 0), *room), constant_values=0.5)


def _ground_ranges(sonar: Sonar, step: float) -> np.ndarray:
    """Distances [m] at which a floor object can be in view, `step` [m] apart.

    Raises SonarjaxError when there is none, or there are more than MAX_DISTANCES.
    """
    height, half = float(sonar.height), float(sonar.elevation_aperture) / 2
    steep, flat = float(sonar.tilt) + half, max(float(sonar.tilt) - half, 1e-3)
    if steep <= 0:
        raise SonarjaxError("sonar: it looks upwards: no part of the floor is inside its aperture")
    nearest = max(height / math.tan(min(steep, math.pi / 2 - 1e-3)), _ground(float(sonar.range_min), height))
    farthest = min(height / math.tan(flat), _ground(float(sonar.range_max), height))
    if farthest <= nearest:
        raise SonarjaxError("sonar: no part of the floor is inside its aperture and range window")
    count = math.ceil((farthest - nearest) / step) + 1
    if count > MAX_DISTANCES:
        raise SonarjaxError(
            f"sonar: the floor in view reaches from {nearest:.4g} to {farthest:.4g} m, {count} distances of "
            f"{step:g} m; expected at most {MAX_DISTANCES}: give a narrower window "
            "(range_min_m to range_max_m) or a larger tilt_deg"
        )
    return np.arange(nearest, farthest + step, step)


def _ground(slant: float, height: float) -> float:
    return math.sqrt(max(slant**2 - height**2, 0.0))
