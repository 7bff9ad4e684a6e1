"""Fig. 1: frame → semantic map → yaw bin → refined yaw. `Recognizer` is prepared once and called with frames."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sonarjax.calibrate import stated_std, yaw_std_of_geometry
from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, is_number, listed, shown
from sonarjax.match import FirstLook, SearchConfig, TargetSearch
from sonarjax.recognition import Hypothesis, Recognition
from sonarjax.refine import (
    ERROR_BAR,
    MAP_REFINEMENT,
    SAME_YAW,
    Look,
    RefineConfig,
    RefinedStart,
    Start,
    YawEstimate,
    agreeing,
    apart,
    by_echoes,
    compared,
    curve_evidence,
    look_closely,
    make_starts,
    on_frame,
    peak_bins,
    plan_refinement,
    plan_shared,
    prepare_mean_yaw,
    prepare_refinement,
    quick_evidence,
    refine_starts,
    refine_yaw,
    with_mean_yaw,
)
from sonarjax.refine.free import wrapped
from sonarjax.render import WindowSize
from sonarjax.render.simulate import check_sonar_alone
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import DEFAULT_SEGMENTER, IdentificationRule, Segmenter, load_segmenter
from sonarjax.sonar import Sonar, checked_image

NEARER = 0.15
"""Refinement's usual window is planned for this quantile of the distances; farther objects need no larger one."""
GIVEN = "given"


class _Result(NamedTuple):
    """What is known of one candidate target."""

    look: Look
    score: float
    """What the threshold is compared with."""
    hypotheses: tuple[Hypothesis, ...]
    """Possible yaws, best first."""
    x: float
    y: float
    evidence: dict[str, float] | None
    """Inputs of the rule; None without refinement."""
    rank: float = math.nan
    """What candidates are ordered by."""


class Recognizer:
    """Recognizes its targets in frames of its sonar: prepare it once, then call it with frames."""

    def __init__(
        self,
        targets: Mesh | Sequence[Mesh] | Mapping[str, Mesh],
        sonar: Sonar,
        *,
        segmenter: str | os.PathLike[str] | Segmenter = DEFAULT_SEGMENTER,
        search: SearchConfig = SearchConfig(),
        refine: RefineConfig | None = MAP_REFINEMENT,
        engine: Engine = PLAIN,
    ) -> None:
        """Prepare the search. Template banks are rendered when a frame first needs them.

        Args:
            targets: One mesh, several, or several by name. Without names a single one is called `target`, several are
                numbered.
            sonar: The sonar that takes the frames.
            segmenter: One of `SEGMENTERS`, a weights file, or a loaded `Segmenter`.
            search: How templates are matched.
            refine: How yaw is refined on the map; None stops at the yaw bin. Its bounds are widened to a bin's width.
                On the frame, `on_frame` changes blurs and template and allows more iterations.
            engine: Runs compiled functions: `sonarjax.cpu.CpuEngine()` on a CPU.

        Raises:
            SonarjaxError: There is no target, an argument is of another kind, the segmenter is unknown, no distance is
                in view or too many are, or a mesh is larger than the sonar's maximum range.
        """
        check_sonar_alone(sonar)
        check_kind(search, SearchConfig, "search")
        check_kind(engine, Engine, "engine")
        if refine is not None and not isinstance(refine, RefineConfig):
            raise SonarjaxError(f"refine: expected a RefineConfig, or None for no refinement, got {refine!r}")
        named = _named(targets)
        self._stated = stated_std(sonar)
        sonar = sonar.replace(geometry_std=None)  # no part of what is rendered: else all would be compiled again
        self.sonar, self.search, self.engine = sonar, search, engine
        several = len(named) > 1
        how: dict[str, Any] = {"engine": engine, "compact": several}
        self.targets = {name: TargetSearch(m, sonar, search, name=name, **how) for name, m in named.items()}
        self.first_look = FirstLook(list(self.targets.values())) if several else None
        self.refine = None if refine is None else _widened(refine, search.yaw_bins)
        self._prepared = False
        self._windows = {name: self._usual_window(search) for name, search in self.targets.items()}
        self.segmenter = segmenter if isinstance(segmenter, Segmenter) else load_segmenter(segmenter)

    def __call__(
        self,
        image: Any,
        mask: Any = None,
        *,
        semantic: Any = None,
        threshold: float | None = None,
        starts: Sequence[Pose] = (),
    ) -> Recognition:
        """Find which target is in a frame, and its yaw: segment, match (eq. 4–5), refine.

        Args:
            image: Grey frame (range, beam) in [0, 1].
            mask: True (range, beam) where a pixel was measured; None means everywhere.
            semantic: A map of your own (range, beam) instead of the segmenter's: shadow 0, background 0.5, highlight 1.
                It needs a `threshold`.
            threshold: Replaces the segmenter's own, which comes from validation frames.
            starts: Single poses [m, rad] at which the best target is expected. They are refined beside the hypotheses
                that matching finds; without refinement they are not used.

        Returns:
            What was found: the best target, its score and its yaw [rad].

        Raises:
            SonarjaxError: A shape does not fit the sonar, a measured value is far outside [0, 1], nothing was measured,
                a threshold is needed or no number, or a start is no pose.
        """
        starts = listed(starts, Pose, "starts")
        if any(start.shape != () for start in starts):
            raise SonarjaxError("starts: expected single poses, got a batch of them in one Pose")
        image, mask = checked_image(image, mask, self.sonar)
        given = None if semantic is None else checked_image(semantic, mask, self.sonar, "semantic")[0]
        least = self._threshold(threshold, given is not None)
        self._prepare()
        rule = self.segmenter.rule if given is None and self.refine is not None else None
        seen, looks = self._looks(image, mask, given)
        results = self._results(looks, image, seen, mask, starts, rule)
        best, second = results[0], results[1] if len(results) > 1 else None
        found = best.look.in_map
        hypotheses = tuple(self._with_geometry(one, found.search, image, mask) for one in best.hypotheses)
        return Recognition(
            identified=best.score >= least,
            target=found.search.name,
            score=best.score,
            score_bank=found.score,
            score_refined=hypotheses[0].score if self.refine else None,
            threshold=least,
            runner_up=None if second is None else second.look.in_map.search.name,
            margin=None if second is None else best.rank - second.rank,
            yaw_bin=_wrap(found.yaws[found.match.scores.argmax()]),
            yaw=hypotheses[0].yaw,
            yaw_std=hypotheses[0].yaw_std,
            x=best.x,
            y=best.y,
            converged=hypotheses[0].converged,
            scores_by_yaw=found.match.scores,
            hypotheses=hypotheses,
            segmenter=self.segmenter.name if given is None else GIVEN,
            semantic=np.asarray(seen),
            agree=None if best.look.in_frame is None else agreeing(found, best.look.in_frame),
            evidence=best.evidence,
        )

    def stream(
        self, images: Iterable[Any], mask: Any = None, *, threshold: float | None = None
    ) -> Iterator[Recognition]:
        """Recognize frames in their order.

        The engine decides how many at once: a `CpuEngine` takes one for each core.

        Args:
            images: Grey frames (range, beam). They are read as they are needed, a few in advance.
            mask: True (range, beam) where a pixel was measured, the same for all frames; None means everywhere.
            threshold: Replaces the segmenter's own.

        Yields:
            What was found in each frame.

        Raises:
            SonarjaxError: As a call does, when the frame's turn comes.
        """
        return self.engine.stream(_recognize_one, (self, mask, threshold), images)

    def prepare(self) -> None:
        """Render the coarse bank of several targets now, so that the first frame need not wait for it.

        With a single target there is no such bank, and nothing is done.
        """
        if self.first_look is not None:
            self.first_look.prepare()

    def _usual_window(self, search: TargetSearch) -> WindowSize | None:
        """The window that refinement needs at distance quantile `NEARER`. It is large enough for all beyond."""
        if self.refine is None:
            return None
        return self._planned(search, Pose(x=float(np.quantile(search.distances, NEARER))), self.refine)

    def _planned(self, search: TargetSearch, at: Pose, config: RefineConfig) -> WindowSize:
        """The window that refinement needs; of several targets in coarse steps, so that they share compiled code."""
        plan = plan_refinement if self.first_look is None else plan_shared
        return plan(search.mesh, self.sonar, at, config)

    def _prepare(self) -> None:
        """Have refinement compiled while the first frame is segmented and matched."""
        if self.refine is None or self._prepared:
            return
        self._prepared = True
        name, search = next(iter(self.targets.items()))
        window = self._windows[name]
        assert window is not None
        prepare_refinement(search.mesh, self.sonar, Pose(), self.refine, self.engine, window)
        prepare_mean_yaw(search.mesh, self.sonar, on_frame(self.refine), window, self.engine)

    def _window(self, search: TargetSearch, at: Pose) -> WindowSize | None:
        """The usual window where it is large enough for the target `at` its place, else what that needs."""
        usual = self._windows[search.name]
        if usual is None or self.refine is None:
            return None
        needed = self._planned(search, at, self.refine)
        return usual if usual.holds(needed) else needed

    def _threshold(self, threshold: float | None, given: bool) -> float:
        rule = self.segmenter.rule if self.refine is not None else None
        own = None if given else self.segmenter.threshold if rule is None else rule.threshold
        if threshold is not None and not is_number(threshold):
            raise SonarjaxError(f"threshold: expected a number, got {shown(threshold)}")
        if threshold is None and own is None:
            what = "a `semantic` map" if given else f"the segmenter {self.segmenter.name}"
            raise SonarjaxError(f"threshold: expected a number, because {what} has no threshold of its own")
        return float(own if threshold is None else threshold)  # type: ignore[arg-type]

    def _looks(
        self, image: np.ndarray, mask: np.ndarray | None, given: np.ndarray | None
    ) -> tuple[np.ndarray, list[Look]]:
        """The semantic map, `given` or the segmenter's, and how the targets match map and frame, best first.

        The frame itself is matched too where there is another map, because it may succeed where a segmenter fails.
        """
        frame_too = given is None and self.refine is not None and self.segmenter.name != "none"
        seen = self.segmenter.semantic(image, mask, self.engine) if given is None else given
        pictures = (seen, image) if frame_too else (seen,)
        return seen, look_closely(self.targets, self.first_look, self.search, pictures, mask, self.engine)

    def _results(
        self, looks: Sequence[Look], image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None,
        expected: Sequence[Pose], rule: IdentificationRule | None,
    ) -> list[_Result]:  # fmt: skip
        """The targets, best first: ordered by the rule if there is one, otherwise by their match with the map."""
        if self.refine is None:
            return [self._unrefined(look) for look in looks]
        if rule is None:
            best, found = self._refined(looks[0], image, seen, mask, expected, None), looks[0].in_map.score
            return [best._replace(score=found, rank=found), *(self._unrefined(look) for look in looks[1:])]
        ranked = [(looks[0], 1.0)] if len(looks) == 1 else self._compared(looks, image, seen, mask)
        best = self._refined(ranked[0][0], image, seen, mask, expected, rule)._replace(rank=ranked[0][1])
        return [best, *(self._unrefined(look)._replace(rank=share) for look, share in ranked[1:])]

    def _compared(
        self, looks: Sequence[Look], image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None
    ) -> list[tuple[Look, float]]:
        """The looks, likeliest first, each with its probability, given that one of them is shown."""
        assert self.refine is not None
        return compared(looks, quick_evidence(looks, image, seen, mask, self.refine, self._window, self.engine))

    def _unrefined(self, look: Look) -> _Result:
        found, scores = look.in_map, look.in_map.match.scores
        bins = peak_bins(scores, found.yaws, self.search.hypotheses)
        plain = [Hypothesis(_wrap(found.yaws[k]), float(scores[k]), None, x=found.x, y=found.y) for k in bins]
        return _Result(look, found.score, _distinct(plain), found.x, found.y, None, found.score)

    def _refined(
        self, look: Look, image: np.ndarray, seen: np.ndarray, mask: np.ndarray | None, expected: Sequence[Pose],
        rule: IdentificationRule | None,
    ) -> _Result:  # fmt: skip
        """Refine a target's hypotheses, and gather the evidence for the best one, which the rule judges."""
        if self.first_look is not None:
            look = by_echoes(look, image, mask)
        starts = make_starts(*look, seen, image, self.search.hypotheses)
        if self.first_look is not None:  # a frame already takes long with many targets
            starts = apart(starts)
        for pose in expected:
            found = look.in_map._replace(x=float(pose.x), y=float(pose.y))
            starts.append(Start(found, starts[0].bin, seen, pose))

        def window_of(start: Start) -> WindowSize | None:
            return self._window(start.candidate.search, Pose(x=start.candidate.x, y=start.candidate.y))

        assert self.refine is not None
        best, *others = refine_starts(starts, image, seen, mask, self.refine, window_of, self.engine)
        return _result(look, [with_mean_yaw(best, image, mask, self.refine, self.engine), *others], rule)

    def _with_geometry(
        self, one: Hypothesis, search: TargetSearch, image: np.ndarray, mask: np.ndarray | None
    ) -> Hypothesis:
        """The hypothesis, its error bar widened by the uncertain geometry if the sonar states `geometry_std`."""
        if not self._stated or self.refine is None or one.yaw_std is None or one.x is None or one.y is None:
            return one
        at = Pose(x=one.x, y=one.y, yaw=one.yaw)
        added = yaw_std_of_geometry(
            image, search.mesh, self.sonar, at, self._stated, on_frame(self.refine), mask=mask,
            window=self._window(search, at), engine=self.engine,
        )  # fmt: skip
        return replace(one, yaw_std=math.hypot(one.yaw_std, added))


def recognize(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    *,
    segmenter: str | os.PathLike[str] | Segmenter = DEFAULT_SEGMENTER,
    semantic: Any = None,
    search: SearchConfig = SearchConfig(),
    refine: RefineConfig | None = MAP_REFINEMENT,
    threshold: float | None = None,
    mask: Any = None,
    engine: Engine = PLAIN,
) -> Recognition:
    """Find one target in one frame, and its yaw, by one call of a new `Recognizer`.

    For several frames keep a `Recognizer`, which renders its banks only once.

    Args:
        image: Grey frame (range, beam).
        mesh: The target.
        sonar: The sonar that took the frame.
        segmenter: One of `SEGMENTERS`, a weights file, or a loaded `Segmenter`.
        semantic: A map of your own (range, beam) instead of the segmenter's. It needs a `threshold`.
        search: How templates are matched.
        refine: How yaw is refined; None stops at the yaw bin.
        threshold: Replaces the segmenter's own.
        mask: True (range, beam) where a pixel was measured; None means everywhere.
        engine: Runs compiled functions: `sonarjax.cpu.CpuEngine()` on a CPU.

    Returns:
        What was found: the score of the target and its yaw [rad].

    Raises:
        SonarjaxError: As `Recognizer` and its call do.
    """
    checked_image(image, mask, sonar)  # before anything is prepared
    recognizer = Recognizer(mesh, sonar, segmenter=segmenter, search=search, refine=refine, engine=engine)
    return recognizer(image, mask, semantic=semantic, threshold=threshold)


def _recognize_one(shared: tuple[Recognizer, Any, float | None], image: Any, _: Engine) -> Recognition:
    recognizer, mask, threshold = shared
    return recognizer(image, mask, threshold=threshold)


def refine_on_frame(
    image: Any, mesh: Mesh, sonar: Sonar, start: Pose, mask: Any = None, config: RefineConfig = MAP_REFINEMENT,
    window: WindowSize | None = None, engine: Engine = PLAIN,
) -> YawEstimate:  # fmt: skip
    """Refine poses on the grey frame instead of its map, with the template that fits the frame better.

    A map shows where highlight and shadow are, but its edges are blunt, and an object is equally bright all over. The
    echo template fits a sonar's frame, the semantic one a frame that was drawn without a sensor. The better score at
    the start decides (experiments/fit_refinement.py).

    Args:
        image: Grey frame (range, beam).
        mesh: The target.
        sonar: The sonar that took the frame.
        start: Where to start [m, rad], one pose or several, as in `refine_yaw`.
        mask: True (range, beam) where a pixel was measured; None means everywhere.
        config: Config of the refinement on the map; that of the refinement on the frame is derived from it.
        window: Size of the window to render, as in `refine_yaw`.
        engine: Runs the compiled functions.

    Returns:
        The refined poses: yaw [rad], x and y [m].

    Raises:
        SonarjaxError: As `refine_yaw` does.
    """
    return refine_yaw(image, mesh, sonar, start, mask=mask, config=on_frame(config), window=window, engine=engine)


def _named(targets: Mesh | Sequence[Mesh] | Mapping[str, Mesh]) -> dict[str, Mesh]:
    if isinstance(targets, Mapping):
        named = dict(targets)
        for name, mesh in named.items():
            check_kind(mesh, Mesh, f"targets[{name!r}]")
    else:
        meshes = listed(targets, Mesh, "targets")
        named = {"target" if len(meshes) == 1 else str(k): mesh for k, mesh in enumerate(meshes)}
    if not named:
        raise SonarjaxError("targets: expected at least one mesh")
    return named


def _widened(config: RefineConfig, yaw_bins: int) -> RefineConfig:
    """The config with bounds of a bin's width [rad] where that is more than its own."""
    yaw, x, y = config.bounds
    return replace(config, bounds=(max(yaw, 2 * math.pi / yaw_bins), x, y))


def _result(look: Look, refined: Sequence[RefinedStart], rule: IdentificationRule | None) -> _Result:
    """A look's refined starts, best first, as hypotheses, with the evidence for the best; a rule gives its score."""
    best, curves = refined[0], curve_evidence(*look)
    evidence = {name: float(value) for name, value in vars(best.evidence).items()}
    evidence |= curves | {"curvature_std": float(best.estimate.yaw_std)}
    score = None if rule is None else rule.probability(evidence)
    stds = ERROR_BAR.std(np.stack([np.asarray(one.estimate.yaw_std) for one in refined]), curves["frame_drop"], score)
    hypotheses = [_hypothesis(one, float(std)) for one, std in zip(refined, stds, strict=True)]
    place = float(best.pose.x), float(best.pose.y)
    return _Result(look, math.nan if score is None else score, _distinct(hypotheses), *place, evidence)


def _hypothesis(one: RefinedStart, std: float) -> Hypothesis:
    """The start's refined pose, with the standard deviation of its yaw [rad] and how well it fits."""
    pose, settled = one.pose, bool(one.estimate.converged)
    return Hypothesis(_wrap(pose.yaw), one.fit, std, settled, float(pose.x), float(pose.y))


def _distinct(hypotheses: list[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Different yaws, best first; those closer than SAME_YAW are one."""
    kept: list[Hypothesis] = []
    for one in sorted(hypotheses, key=lambda h: -h.score):
        gaps = [abs(math.remainder(one.yaw - other.yaw, 2 * math.pi)) for other in kept]
        if all(gap > SAME_YAW for gap in gaps):
            kept.append(one)
    return tuple(kept)


def _wrap(angle: Any) -> float:
    return float(wrapped(np.float32(angle)))
