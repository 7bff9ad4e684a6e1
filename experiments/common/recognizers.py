"""Recognizers of simulated frames: one for each tilt of the sonar, each of which renders its banks once."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cache

import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.frames import sonar_for
from sonarjax.match import SearchConfig
from sonarjax.refine import MAP_REFINEMENT, RefinedStart, look_closely, make_starts, refine_starts


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


def refined_starts(recognizer: sj.Recognizer, image: np.ndarray) -> list[RefinedStart]:
    """The refined starts in a frame (range, beam), best first, as `Recognizer` finds them before the mean yaw."""
    assert recognizer.refine is not None
    seen = np.asarray(recognizer.segmenter.semantic(image, None, engine()))
    (look,) = look_closely(recognizer.targets, None, recognizer.search, (seen, image), None, engine())
    starts = make_starts(*look, seen, image, recognizer.search.hypotheses)
    return refine_starts(starts, image, seen, None, recognizer.refine, lambda _: None, engine())
