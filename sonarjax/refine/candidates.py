"""Targets that come into question in a frame, and how each of them matches it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sonarjax.match import FirstLook, SearchConfig, TargetSearch, leading
from sonarjax.refine.starts import Candidate, locate


class Look(NamedTuple):
    """A target's best match on the map, and on the frame itself where that is asked for."""

    in_map: Candidate
    """On the map."""
    in_frame: Candidate | None = None
    """On the frame."""


def look_closely(
    targets: Mapping[str, TargetSearch], first_look: FirstLook | None, config: SearchConfig,
    pictures: Sequence[np.ndarray], mask: np.ndarray | None,
) -> list[Look]:  # fmt: skip
    """The targets that come into question, best first, as they match the `pictures`: the map, and perhaps the frame.

    Pictures and `mask` are (range, beam). Where a segmenter fails, the match on the frame may be right. A `first_look`
    leaves few of many targets. Raises SonarjaxError as `TargetSearch.find` does.
    """
    near: list[Mapping[str, Any]] = [dict.fromkeys(targets)] * len(pictures)
    names = list(targets)
    if first_look is not None:
        found = [first_look.best(np.asarray(picture, np.float32), mask) for picture in pictures]
        names = leading(found, config)
        near = [{name: sightings[name].distance_index for name in names} for sightings in found]

    def look(name: str) -> Look:
        return Look(*(locate(targets[name], p, mask, at[name]) for p, at in zip(pictures, near, strict=True)))

    return sorted(map(look, names), key=lambda one: -one.in_map.score)
