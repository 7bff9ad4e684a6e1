"""Candidates among several targets: how each matches the frame, and a quick refinement that ranks them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sonarjax.engine import Engine
from sonarjax.match import FirstLook, SearchConfig, TargetSearch, leading
from sonarjax.match.search import Picture
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.pose import plan_refinement
from sonarjax.refine.starts import Candidate, Start, curve_evidence, evidence_of, locate, make_starts, on_frame
from sonarjax.refine.yaw import refine_and_draw
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

QUICK_ITERATIONS = 1
"""Renders at each blur of the quick refinement."""
COMPARISON: Mapping[str, float] = {
    "map_fit": 9.05, "frame_fit": 13.4, "coarse_fit": 0.207, "unexplained": -10.6, "left_over": -0.701,
    "frame_peak": 6.43, "score_bank": 10.1,
}  # fmt: skip
"""Weight of each number in the log-odds that a candidate is the one shown, fitted on validation frames
(experiments/fit_candidates.py). How far the best yaw stands out is left out: it depends on the object's symmetry."""
STEPS = (256, 64, 48)
"""Shared windows are multiples of these: range bins, beams, and beams of the object."""
FEW_BEAMS = 32
"""Beams of the object in a shared window of the fewest range bins, if they suffice: most small objects are narrow."""
SAME_START = math.radians(5.0)
"""Starts whose yaws differ by less [rad] count as one."""


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
    pictures: Sequence[np.ndarray], mask: np.ndarray | None, engine: Engine,
) -> list[Look]:  # fmt: skip
    """Match the candidate targets with the map of a frame, and optionally with the frame itself.

    Where a segmenter fails, the match on the frame may still be right.

    Args:
        targets: The search of each target, by name.
        first_look: Selects the candidates among many targets; None takes all targets.
        config: Its `candidates` and `lead` limit what the first look selects.
        pictures: The map (range, beam), and optionally the frame (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        engine: Runs the compiled functions.

    Returns:
        One look for each candidate, the best match on the map first.

    Raises:
        SonarjaxError: No part of a target can be seen at any distance (as `TargetSearch.find`).
    """
    near: list[Mapping[str, Any]] = [dict.fromkeys(targets)] * len(pictures)
    names = list(targets)
    if first_look is not None:
        found = [first_look.best(np.asarray(picture, np.float32), mask) for picture in pictures]
        names = leading(found, config)
        near = [{name: sightings[name].distance_index for name in names} for sightings in found]

    # Several targets are compared by their semantic templates in both pictures, as the first look does.
    kinds: tuple[Picture, ...] = ("map", "frame" if first_look is None else "map")

    def look(name: str) -> Look:
        each = zip(pictures, kinds, near, strict=False)
        return Look(*(locate(targets[name], image, mask, kind, at[name]) for image, kind, at in each))

    return sorted(engine.map(look, names), key=lambda one: -one.in_map.score)


def by_echoes(look: Look, image: np.ndarray, mask: np.ndarray | None) -> Look:
    """Match one of several targets with the frame again, with echo templates, near where it was found.

    Args:
        look: The target's best matches.
        image: The frame (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.

    Returns:
        The look with the new match in the frame, or as it is without a match there.
    """
    if look.in_frame is None:
        return look
    search = look.in_frame.search
    return look._replace(in_frame=locate(search, image, mask, "frame", search.nearest(look.in_frame.match)))


def plan_shared(mesh: Mesh, sonar: Sonar, at: Pose, config: RefineConfig) -> WindowSize:
    """Plan the window of a refinement in coarse steps, so that many targets share compiled code.

    Args:
        mesh: The object.
        sonar: The sonar.
        at: Where refinement starts [m, rad].
        config: How refinement searches.

    Returns:
        The size from `plan_refinement`, rounded up to multiples of `STEPS`, or in a small window to `FEW_BEAMS`, and
        limited to the frame.
    """
    needed = plan_refinement(mesh, sonar, at, config)
    sizes = *needed.shape, needed.object_columns or sonar.n_beams
    most = sonar.n_ranges, sonar.n_beams, sonar.n_beams
    rows, columns, beams = (min(-(-n // step) * step, m) for n, step, m in zip(sizes, STEPS, most, strict=True))
    few = rows <= STEPS[0] and sizes[2] <= FEW_BEAMS
    return WindowSize((rows, columns), min(FEW_BEAMS, beams) if few else beams)


def quick_evidence(
    looks: Sequence[Look], image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, config: RefineConfig,
    window: Callable[[TargetSearch, Pose], WindowSize | None], engine: Engine,
) -> list[dict[str, float]]:  # fmt: skip
    """Gather the evidence for each look, after a brief refinement on the frame.

    A target is refined from its best bin on the map and from that on the frame. The better fit to the frame counts.

    Args:
        looks: The candidates.
        image: The grey frame (range, beam).
        seen: Its semantic map (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        config: The full refinement on the map. That on the frame derives from it (`on_frame`), with fewer iterations.
        window: Gives the window that refinement of a target at a pose [m, rad] needs; None lets refinement plan it.
        engine: Runs the compiled functions.

    Returns:
        The inputs of `compared` [1] by name, for each look.
    """
    brief = replace(on_frame(config), iterations=QUICK_ITERATIONS)
    starts = [(k, start) for k, look in enumerate(looks) for start in apart(make_starts(*look, seen, image, 1))]

    def refined(numbered: tuple[int, Start]) -> tuple[int, dict[str, float]]:
        k, start = numbered
        search, begin = start.candidate.search, start.begin
        size = window(search, begin)
        drawn = refine_and_draw(image, search.mesh, search.sonar, begin, mask, brief, size, engine)[1]
        gathered = evidence_of(drawn, image, seen, mask, engine)
        return k, {name: float(value) for name, value in vars(gathered).items()}

    best: dict[int, dict[str, float]] = {}
    for k, evidence in engine.map(refined, starts):
        if k not in best or evidence["frame_fit"] > best[k]["frame_fit"]:
            best[k] = evidence
    return [best[k] | curve_evidence(*look) | {"score_bank": look.in_map.score} for k, look in enumerate(looks)]


def compared(looks: Sequence[Look], evidence: Sequence[Mapping[str, float]]) -> list[tuple[Look, float]]:
    """Order the looks by how likely each is the one shown, as `COMPARISON` weighs the evidence.

    Args:
        looks: The candidates.
        evidence: The numbers that `COMPARISON` names [1], for each look.

    Returns:
        The looks, the likeliest first, each with the probability [1] that it is the one shown. They sum to 1.
    """
    odds = np.array([sum(weight * one[name] for name, weight in COMPARISON.items()) for one in evidence])
    shares = np.exp(odds - odds.max())
    shares /= shares.sum()
    return [(looks[k], float(shares[k])) for k in np.argsort(-odds, kind="stable")]


def apart(starts: list[Start]) -> list[Start]:
    """Drop the starts whose yaw is within `SAME_START` of that of an earlier start.

    Args:
        starts: The starts, the most important first.

    Returns:
        The starts that are left, in the same order.
    """
    kept: list[Start] = []
    for start in starts:
        turns = (float(start.begin.yaw) - float(one.begin.yaw) for one in kept)
        if all(abs(math.remainder(turn, 2 * math.pi)) > SAME_START for turn in turns):
            kept.append(start)
    return kept
