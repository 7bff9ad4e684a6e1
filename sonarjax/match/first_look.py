"""Select the few of many targets that a frame may show, by a coarse match of all of them at once.

`FirstLook` is prepared for the searches of a catalogue. Every target is rendered at every third distance. All templates
of a distance are placed in one box, so that they are compared over the same pixels. They form one low-rank bank: a few
components represent all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sonarjax.io.errors import OutOfViewError, SonarjaxError
from sonarjax.match.compact import CompactBank, centred_on_host, window_scale
from sonarjax.match.low_rank import Factors, combined, factors
from sonarjax.match.ncc import MatchPositions
from sonarjax.match.search import NOT_SEEN, SearchConfig, TargetSearch, decimated, mid_fan
from sonarjax.match.spectra import correlate, frame_spectrum, over_chunks, pack
from sonarjax.render import WindowSize, template_bank

YAWS = 36
"""Largest number of templates of a target at each distance; never more than the search has yaw bins."""
SLACK_ROWS = 2
"""Number of coarse range bins that are searched beyond the midpoint between two distances."""
SIZE_STEP = 16
"""Box sizes are rounded up to multiples of this many coarse range bins and beams, so that few shapes are compiled."""
EVERY = 2
"""Templates are tried at every second beam, because half of this step is small compared with an object's width."""
LEADS = (1.0, 0.5)
"""Shares of `SearchConfig.lead` that are allowed on the map and on the frame itself."""
ALWAYS = 2
"""Number of targets that are always searched closely: the best one and the runner-up."""


class Sighting(NamedTuple):
    """A target that a frame may show."""

    search: TargetSearch
    """The target."""
    distance_index: int
    """Index of the distance at which it matched best."""
    score: float
    """Its approximate correlation at that distance."""


def leading(found: Sequence[Mapping[str, Sighting]], config: SearchConfig) -> list[str]:
    """Name the targets to search closely, best first.

    Targets are ordered by the better of their scores in map and frame. The first two need not be within `lead`.

    Args:
        found: One mapping from target name to sighting for the map, and one for the frame.
        config: Its `candidates` and `lead` limit which targets are taken.

    Returns:
        Names of the targets.
    """
    short = {name: np.inf for name in found[0]}
    for share, sightings in zip(LEADS, found, strict=False):
        best = max(one.score for one in sightings.values())
        short = {name: min(by, (best - sightings[name].score) / share) for name, by in short.items()}
    height = {name: max(sightings[name].score for sightings in found) for name in short}
    ordered = sorted(height, key=lambda name: -height[name])[: config.candidates]
    return [name for k, name in enumerate(ordered) if k < ALWAYS or short[name] <= config.lead]


class _Drawn(NamedTuple):
    """All targets at one distance, before the boxes of all distances are known."""

    found: Factors
    owner: np.ndarray
    row: int
    slant: float


class _DistanceBank(NamedTuple):
    """All targets at one distance, in arrays of the same size for all distances, so that they share compiled code."""

    planes: Array  # spectra of the components
    coefficients: Array
    box: tuple[int, int]
    owner: np.ndarray
    row: int
    slant: float


class FirstLook:
    """The low-rank banks of a catalogue of targets for one sonar."""

    def __init__(self, searches: Sequence[TargetSearch]) -> None:
        """Set up the banks of several targets.

        The banks are rendered when a frame first needs them. From now on, all searches render in windows of one shared
        size, so that they share compiled code; this changes the searches themselves.

        Args:
            searches: Searches of the targets, which must share one sonar and one config.
        """
        self.searches = list(searches)
        sizes = [search.size for search in self.searches]
        rows, columns = (max(size.shape[k] for size in sizes) for k in (0, 1))
        shared = WindowSize(
            (rows, columns), max(size.object_columns or self.searches[0].sonar.n_beams for size in sizes)
        )
        for search in self.searches:
            search.size = shared
        first = self.searches[0]
        self.sonar, self.config, self.engine = first.sonar, first.config, first.engine
        every = self.config.coarse_every
        step = self.config.range_step * every / (2 * float(self.sonar.range_bin) * self.config.decimation)
        self._reach = math.ceil(step) + SLACK_ROWS
        self._distances = [float(d) for d in first.distances[::every]]
        self._banks: list[_DistanceBank] = []
        """One for each distance at which any target is in view; empty until they are rendered."""
        self._residual = 0.0

    @property
    def n_distances(self) -> int:
        """Number of distances at which targets are rendered."""
        return len(self._distances)

    @property
    def residual(self) -> float:
        """Largest norm [1] that the components leave of any unit template; no score has a larger error."""
        self.prepare()
        return self._residual

    def prepare(self, progress: Callable[[int, int], None] = lambda done, of: None) -> None:
        """Render all banks unless this is already done.

        Args:
            progress: Called with the number of distances that are done, and the number of all distances.

        Raises:
            SonarjaxError: No target is in view at any distance.
        """
        if self._banks:
            return
        drawn = []
        for k, distance in enumerate(self._distances):
            drawn.append(self._draw(distance))
            progress(k + 1, len(self._distances))
        seen = [one for one in drawn if one is not None]
        if not seen:
            raise SonarjaxError(NOT_SEEN.format("targets"))
        self._banks = self._padded(seen)

    def best(self, image: np.ndarray, mask: np.ndarray | None = None) -> dict[str, Sighting]:
        """Find where each target matches a frame or semantic map best.

        Args:
            image: Frame or semantic map (range, beam).
            mask: True where it was measured (range, beam); None means everywhere. Other pixels count as background.

        Returns:
            Sightings by target name, without targets that are in view at no distance.
        """
        small = decimated(image if mask is None else np.where(mask, image, 0.5), self.config.decimation)
        self.prepare()
        found = self.engine.map(lambda bank: self._match(small, bank), self._banks)
        sightings: dict[str, Sighting] = {}
        for bank, (scores, rows) in zip(self._banks, found, strict=True):
            # The dictionary keeps the last template of each target, which is its best one in ascending order.
            order = np.argsort(scores)
            for owner, k in dict(zip(bank.owner[order].tolist(), order.tolist(), strict=True)).items():
                search, score = self.searches[owner], float(scores[k])
                if search.name not in sightings or score > sightings[search.name].score:
                    sightings[search.name] = Sighting(search, self._index(bank, int(rows[k])), score)
        return sightings

    def _index(self, bank: _DistanceBank, row: int) -> int:
        """Index of the distance that belongs to a match at `row` of the searched rows."""
        moved = (row - self._reach) * self.config.decimation * float(self.sonar.range_bin)
        ground = math.sqrt(max((bank.slant + moved) ** 2 - float(self.sonar.height) ** 2, 0.0))
        return int(np.argmin(np.abs(self.searches[0].distances - ground)))

    def _match(self, small: np.ndarray, bank: _DistanceBank) -> tuple[np.ndarray, np.ndarray]:
        """Best score and row of each template, searched near the distance where it was rendered, at all bearings."""
        (height, width), reach = bank.box, self._reach
        canvas = np.full(self._canvas, 0.5, np.float32)
        top, beside = bank.row - reach, width // 2
        first, last = max(top, 0), min(top + height + 2 * reach, len(small))
        canvas[first - top : last - top, beside : beside + small.shape[1]] = small[first:last]
        seen = canvas[: height + 2 * reach, : small.shape[1] + 2 * beside]
        centred = centred_on_host(seen)
        scale = window_scale(centred, bank.box)[: 2 * reach + 1, : small.shape[1] + 1]
        canvas = np.zeros(self._canvas, np.float32)
        canvas[: seen.shape[0], : seen.shape[1]] = centred
        found = jax.device_get(_look(canvas, scale, bank.planes, bank.coefficients))
        return found.scores[: len(bank.owner)], found.row[: len(bank.owner)]

    def _draw(self, distance: float) -> _Drawn | None:
        """Render all targets at a distance [m] and factor their templates; None if no target is in view there."""
        views = self.engine.map(lambda search: self._view(search, distance), self.searches)
        boxes = [(top, left, *view.levels.shape[1:]) for view, top, left in filter(None, views)]
        if not boxes:
            return None
        top, left = (min(box[k] for box in boxes) for k in (0, 1))
        height, width = (max(box[k] + box[k + 2] for box in boxes) - first for k, first in ((0, top), (1, left)))
        shape = -(-height // SIZE_STEP) * SIZE_STEP, -(-width // SIZE_STEP) * SIZE_STEP
        owner = np.repeat(np.arange(len(views)), [0 if view is None else len(view[0].levels) for view in views])
        templates, count = np.full((len(owner), *shape), 0.5, np.float32), 0
        for view, row, column in filter(None, views):
            yaws, h, w = view.levels.shape
            part = templates[count : count + yaws]
            part[:, row - top : row - top + h, column - left : column - left + w] = view.templates
            count += yaws
        _make_unit(templates)
        slant = math.hypot(distance, float(self.sonar.height))
        return _Drawn(factors(templates, self.config.rank), owner, top, slant)

    def _padded(self, drawn: list[_Drawn]) -> list[_DistanceBank]:
        """Pad the arrays of all distances to one size with components and coefficients of zero."""
        height, width = (max(one.found.components.shape[k] for one in drawn) for k in (1, 2))
        count, rank = (max(one.found.coefficients.shape[k] for one in drawn) for k in (0, 1))
        self._canvas = height + 2 * self._reach, self.sonar.n_beams + 2 * (width // 2)
        self._residual = max(float(one.found.residual.max()) for one in drawn)
        banks = []
        for one in drawn:
            components, coefficients = np.zeros((rank, height, width), np.float32), np.zeros((count, rank), np.float32)
            kept, h, w = one.found.components.shape
            components[:kept, :h, :w] = one.found.components
            coefficients[: len(one.owner), :kept] = one.found.coefficients
            planes = _planes(components, self._canvas)
            banks.append(_DistanceBank(planes, jnp.asarray(coefficients), (h, w), one.owner, one.row, one.slant))
        return banks

    def _view(self, search: TargetSearch, distance: float) -> tuple[CompactBank, int, int] | None:
        """A target's coarse templates at a distance [m], with the coarse row and the column of their first pixel.

        None if the target is out of view there.
        """
        step, count = self.config.decimation, min(self.config.yaw_bins, YAWS)
        yaws = np.arange(count) * (2 * math.pi / count)
        try:
            x, y = mid_fan(self.sonar, distance)
            bank = template_bank(
                search.mesh, self.sonar, yaws, x=x, y=y, size=search.size, quality=self.config.quality,
                engine=self.engine,
            )  # fmt: skip
        except OutOfViewError:
            return None
        row, column = (int(v) for v in np.asarray(bank.offset))
        templates = np.asarray(bank.templates)
        ends = row % step, -(row + templates.shape[1]) % step
        padded = np.pad(templates, ((0, 0), ends, (0, 0)), constant_values=0.5)
        return CompactBank.of(decimated(padded, step)), row // step, column


def _make_unit(templates: np.ndarray) -> None:
    """Give templates (template, h, w) mean 0 and norm 1, in place: a second such array would take too much memory."""
    for one in templates:
        one -= one.mean()
        norm = float(np.linalg.norm(one))
        one *= 1 / norm if norm > 1e-5 else 0.0


@partial(jax.jit, static_argnums=1)
def _planes(components: Array, canvas: tuple[int, int]) -> Array:
    return pack(components, canvas)


@jax.jit
def _look(canvas: Array, scale: Array, planes: Array, coefficients: Array) -> MatchPositions:
    """The best window of each template on `canvas`; `scale` (row, col) is 1/norm of the window at each corner."""
    frame, shape = frame_spectrum(canvas), (scale.shape[0], scale.shape[1])
    maps = over_chunks(lambda part: correlate(frame, part, shape) * scale, planes)
    return combined(maps.reshape(-1, *shape)[: coefficients.shape[1], :, ::EVERY], coefficients)
