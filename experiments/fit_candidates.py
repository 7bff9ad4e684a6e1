"""Which of several objects is it? How candidates are compared, and which come into question: on validation frames.

python -m experiments.fit_candidates [--preset smoke] [--help]

Every candidate of the first look is refined. A conditional logit weighs the evidence for each against the others'; its
top-1 is given with each group of alike objects left out of the fit in turn. How far a target stands out over yaw is no
part of it: that tells of its symmetry, not of the frame. What is found stands in `sonarjax.segment.rule.COMPARISON` and
in `sonarjax.match.SearchConfig`. No object is one of the catalogue's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

import sonarjax as sj
from experiments.common.catalogue import validation_catalogue
from experiments.common.drawn_device import draw_device
from experiments.common.engine import engine
from experiments.common.frames import TILTS_DEG, VALIDATION_SEED, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.validation import ODD, SEVERITIES
from sonarjax.match import FirstLook, SearchConfig, TargetSearch
from sonarjax.refine import (
    MAP_REFINEMENT,
    Start,
    curve_evidence,
    is_kept,
    look_closely,
    make_starts,
    plan_refinement,
    quick_evidence,
    refine_start,
)
from sonarjax.render import WindowSize

COMPARED = ("map_fit", "frame_fit", "coarse_fit", "unexplained", "left_over", "frame_peak", "score_bank")
"""What the comparison may weigh."""
RIDGE = 1.0
"""Weight of the squared coefficients of standardised evidence [1]."""
GAPS = (0.0, 1.0, 2.0, 4.0)
"""Log-odds within which candidates are refined fully."""
ALL = SearchConfig(candidates=8, lead=0.2)
"""How many candidates are looked at here: more than are needed."""


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    count: int = 120
    """Validation frames."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1, in turn."""


def run(settings: Settings, job: Job) -> Report:
    """Weights of the comparison for quick and for full refinement, and the share of frames whose object is found."""
    measured = job.map(lambda tilt: _measure(settings, float(tilt), job.seed), map(str, settings.tilts_deg), "tilt")
    frames = [frame for part in measured.values() for frame in part]
    short = [frame for frame in frames if frame["true"] in frame["rows"]]
    rows: list[dict[str, Any]] = [{"by": "among the candidates", "top_1": len(short) / len(frames)}]
    rows += [
        {"by": name, "top_1": _share(frames, lambda row, name=name: row[name])}
        for name in ("score_bank", "score_refined", "probability")
    ]
    fitted = {}
    for how in ("quick", "full"):
        weights = fit(short, how)
        fitted[how] = weights
        rows.append(
            {"by": f"comparison, {how}", "top_1": _share(frames, lambda row, h=how, w=weights: odds(row[h], w))}
        )
        rows.append({"by": f"comparison, {how}, group left out", "top_1": _left_out(frames, short, how)})
    for gap in GAPS:
        share, count = _in_two_steps(frames, fitted, gap)
        rows.append({"by": f"quick, full within {gap:g} of the best", "top_1": share, "refined": count})
    return {"weights": fitted, "rows": rows, "frames": frames}


def _measure(settings: Settings, tilt_deg: float, seed: int) -> list[dict[str, Any]]:
    """What is found of each candidate in the frames of one tilt."""
    objects = validation_catalogue()
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), int(10 * tilt_deg))
    meshes = {name: entry.mesh for name, entry in objects.items()}
    sonar, segmenter = sonar_for(tilt_deg), sj.load_segmenter(settings.segmenter)
    targets = {
        name: TargetSearch(m, sonar, ALL, name=name, engine=engine(), compact=True) for name, m in meshes.items()
    }
    first_look = FirstLook(list(targets.values()))
    found = []
    for number in tqdm(
        range(settings.count // len(settings.tilts_deg)), f"{tilt_deg:g} deg", leave=False, disable=None
    ):
        name, part = list(meshes)[number % len(meshes)], jax.random.fold_in(key, number)
        device = draw_device(meshes[name], tilt_deg, SEVERITIES, wide=ODD, key=part)
        image, _ = observed(device.mesh, device.start, device.sonar, device.model, key=jax.random.fold_in(part, 5))
        rows = _candidates(np.asarray(image), targets, first_look, segmenter)
        found.append({"true": name, "group": objects[name].like, "odd": device.odd, "rows": rows})
    return found


def _candidates(
    image: np.ndarray, targets: dict[str, TargetSearch], first_look: FirstLook, segmenter: sj.Segmenter
) -> dict[str, dict[str, Any]]:
    """Scores and evidence of each candidate by name, refined quickly and fully."""
    seen = np.asarray(segmenter.semantic(image, None, engine()))
    looks = look_closely(targets, first_look, ALL, (seen, image), None)
    quick = quick_evidence(looks, image, seen, None, MAP_REFINEMENT, _window, engine())
    rule, rows = segmenter.rule, {}
    for look, brief in zip(looks, quick, strict=True):
        starts = make_starts(*look, seen, image, ALL.hypotheses)

        def refined(start: Start) -> tuple[Any, ...]:
            search = start.candidate.search
            return refine_start(start, image, seen, None, MAP_REFINEMENT, _window(search, start.begin), engine())

        parts = engine().map(refined, starts)
        scores = [float(one.score if is_kept(one) else one.start_score) for one, _, _ in parts]
        gathered = vars(parts[int(np.argmax(scores))][2])
        full = {name: float(value) for name, value in gathered.items()} | curve_evidence(*look)
        rows[look.name] = {
            "quick": brief,
            "full": full | {"score_bank": look.in_map.score},
            "score_bank": look.in_map.score,
            "score_refined": max(scores),
            "probability": rule.probability(full) if rule else 0.0,
        }
    return rows


def _window(search: TargetSearch, at: sj.Pose) -> WindowSize:
    return plan_refinement(search.mesh, search.sonar, at, MAP_REFINEMENT)


def fit(frames: list[dict[str, Any]], how: str) -> dict[str, float]:
    """Weights of a conditional logit: the right one of each frame's candidates is the most likely."""
    every = np.array([[row[how][name] for name in COMPARED] for frame in frames for row in frame["rows"].values()])
    spread = every.std(axis=0) + 1e-9
    parts = [
        (np.array([[row[how][name] for name in COMPARED] for row in frame["rows"].values()]) / spread,
         list(frame["rows"]).index(frame["true"]))
        for frame in frames
    ]  # fmt: skip

    def loss(beta: np.ndarray) -> float:
        total = RIDGE * float(beta @ beta) / 2
        for values, right in parts:
            logits = values @ beta
            total += float(np.logaddexp.reduce(logits) - logits[right])
        return total

    beta = minimize(loss, np.zeros(len(COMPARED))).x
    return {name: float(value) for name, value in zip(COMPARED, beta / spread, strict=True)}


def odds(evidence: Mapping[str, float], weights: Mapping[str, float]) -> float:
    """Log-odds of a candidate, but for a constant that all share."""
    return sum(weight * evidence[name] for name, weight in weights.items())


def _share(frames: list[dict[str, Any]], score: Callable[[dict[str, Any]], float]) -> float:
    best = [max(frame["rows"], key=lambda name, rows=frame["rows"]: score(rows[name])) for frame in frames]
    return float(np.mean([one == frame["true"] for one, frame in zip(best, frames, strict=True)]))


def _left_out(frames: list[dict[str, Any]], short: list[dict[str, Any]], how: str) -> float:
    shares = []
    for group in sorted({frame["group"] for frame in frames}):
        weights = fit([frame for frame in short if frame["group"] != group], how)
        own = [frame for frame in frames if frame["group"] == group]
        shares += [_share([frame], lambda row, w=weights: odds(row[how], w)) for frame in own]
    return float(np.mean(shares))


def _in_two_steps(frames: list[dict[str, Any]], fitted: dict[str, dict[str, float]], gap: float) -> tuple[float, float]:
    """Top-1 where only candidates within `gap` of the best log-odds are refined fully, and how many these are."""
    right, count = [], []
    for frame in frames:
        quick = {name: odds(row["quick"], fitted["quick"]) for name, row in frame["rows"].items()}
        kept = [name for name, value in quick.items() if value >= max(quick.values()) - gap]
        best = max(kept, key=lambda name, rows=frame["rows"]: odds(rows[name]["full"], fitted["full"]))
        right.append(best == frame["true"])
        count.append(len(kept))
    return float(np.mean(right)), float(np.mean(count))


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    weights = [f"{how}: " + ", ".join(f"{name} {value:.4g}" for name, value in found.items())
               for how, found in report["weights"].items()]  # fmt: skip
    heads = {"by": "the best by", "top_1": "object right", "refined": "refined fully, mean"}
    return "\n".join(weights) + "\n\n" + columns([{"refined": None} | row for row in report["rows"]], heads)


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 4, "segmenter": "none", "tilts_deg": (20.0,)})
