"""Recognizers of simulated frames: one for each tilt of the sonar, each of which renders its banks once."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cache

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import sonar_for
from sonarjax.match import SearchConfig
from sonarjax.refine import MAP_REFINEMENT


def recognizers(
    mesh: sj.Mesh,
    *,
    segmenter: str | sj.Segmenter = "none",
    search: SearchConfig = SearchConfig(),
    refine: sj.RefineConfig | None = MAP_REFINEMENT,
    sonar_of: Callable[[float], sj.Sonar] = sonar_for,
) -> Callable[[float], sj.Recognizer]:
    """What gives the recognizer of a tilt [deg], made when it is first asked for; `sonar_of` gives the sonar.

    Maps of any segmenter can be given to it as `semantic`: they share its banks.
    """

    def made(tilt_deg: float) -> sj.Recognizer:
        options = {"segmenter": segmenter, "search": search, "refine": refine}
        return sj.Recognizer(mesh, sonar_of(tilt_deg), **options, engine=engine())

    return cache(made)


def unrefined(recognizer: sj.Recognizer) -> sj.Recognizer:
    """The same recognizer, on the same banks, that stops at the yaw bin."""
    twin = copy(recognizer)
    twin.refine = None
    return twin
