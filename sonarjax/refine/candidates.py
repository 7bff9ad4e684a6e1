"""Targets that come into question in a frame: how they match, and a quick refinement that says which to refine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.match import FirstLook, SearchConfig, TargetSearch, leading
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.starts import Candidate, Start, curve_evidence, evidence_of, locate, make_starts, on_frame
from sonarjax.refine.yaw import refine_and_draw
from sonarjax.render import WindowSize
from sonarjax.scene import Pose

QUICK_ITERATIONS = 1
"""Renders at each blur of the quick refinement."""

SAME_START = math.radians(5.0)
"""Starts whose yaws [rad] are no farther apart are one."""


class Look(NamedTuple):
    """A target's best match on the map, and on the frame itself where that is asked for."""

    in_map: Candidate
    """On the map."""
    in_frame: Candidate | None = None
    """On the frame."""

    @property
    def name(self) -> str:
        """Name of the target."""
        return self.in_map.search.name


def look_closely(
    targets: Mapping[str, TargetSearch], first_look: FirstLook | None, config: SearchConfig,
    pictures: Sequence[np.ndarray], mask: np.ndarray | None,
) -> list[Look]:  # fmt: skip
    """The targets that come into question, best first, as they match the map and perhaps the frame: `pictures`.

    Where a segmenter fails, the match on the frame may be right. A `first_look` leaves few of many targets.
    """
    near: list[Mapping[str, Any]] = [dict.fromkeys(targets)] * len(pictures)
    names = list(targets)
    if first_look is not None:
        found = [first_look.best(np.asarray(picture, np.float32), mask) for picture in pictures]
        names = leading(found, config)
        near = [{name: sightings[name].place for name in names} for sightings in found]

    def look(name: str) -> Look:
        return Look(*(locate(targets[name], p, mask, at[name]) for p, at in zip(pictures, near, strict=True)))

    return sorted(map(look, names), key=lambda one: -one.in_map.score)


def quick_evidence(
    looks: Sequence[Look], image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, config: RefineConfig,
    window: Callable[[TargetSearch, Pose], WindowSize | None], engine: Engine,
) -> list[dict[str, float]]:  # fmt: skip
    """What speaks for each of `looks`, refined a little on the frame `image` (range, beam) from its best bins.

    `seen` is the map of the frame; `window` tells the window that a target at a pose needs. With `score_bank`.
    """
    brief = replace(on_frame(config), iterations=QUICK_ITERATIONS)
    starts = [(k, start) for k, look in enumerate(looks) for start in _apart(make_starts(*look, seen, image, 1))]

    def refined(numbered: tuple[int, Any]) -> tuple[int, dict[str, float]]:
        k, start = numbered
        search, begin = start.candidate.search, start.begin
        _, drawn = refine_and_draw(
            image, search.mesh, search.sonar, begin, mask, brief, window(search, begin), engine
        )  # fmt: skip
        gathered = evidence_of(drawn, image, seen, mask, engine)
        return k, {name: float(value) for name, value in vars(gathered).items()}

    best: dict[int, dict[str, float]] = {}
    for k, evidence in engine.map(refined, starts):
        if k not in best or evidence["frame_fit"] > best[k]["frame_fit"]:
            best[k] = evidence
    return [best[k] | curve_evidence(*look) | {"score_bank": look.in_map.score} for k, look in enumerate(looks)]


def _apart(starts: list[Start]) -> list[Start]:
    """The starts without those that begin as one before them does."""
    kept: list[Start] = []
    for start in starts:
        turns = [
            abs((float(start.begin.yaw) - float(one.begin.yaw) + math.pi) % (2 * math.pi) - math.pi) for one in kept
        ]
        if all(turn > SAME_START for turn in turns):
            kept.append(start)
    return kept
