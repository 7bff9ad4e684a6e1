"""Which of several objects is it? How candidates are compared, and which come into question: on validation frames.

python -m experiments.fit_candidates [--preset smoke] [--help]

Every candidate of the first look is refined quickly. A conditional logit weighs the evidence for each against the
others'; its top-1 is given with each group of alike objects left out of the fit in turn. What is found stands in
`sonarjax.refine.candidates.COMPARISON` and in `sonarjax.match.SearchConfig`. No object is one of the catalogue's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax
import numpy as np
from scipy.optimize import minimize

import sonarjax as sj
from experiments.common.catalogue import validation_catalogue
from experiments.common.drawn_device import draw_device
from experiments.common.engine import engine
from experiments.common.frames import TILTS_DEG, VALIDATION_SEED, observed, sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.progress import Progress
from experiments.common.runs import Job
from experiments.common.validation import ODD, SEVERITIES
from sonarjax.match import FirstLook, SearchConfig, Sighting, TargetSearch, leading
from sonarjax.refine import COMPARISON, MAP_REFINEMENT, look_closely, plan_shared, quick_evidence
from sonarjax.render import WindowSize

RIDGE = 1.0
"""Weight of the squared coefficients of standardised evidence [1]."""
ALL = SearchConfig(candidates=8, lead=0.2)
"""How many candidates are looked at here: more than are needed."""
COUNTS, LEADS = (3, 4, 5, 6, 8), (0.05, 0.1, 0.15, 0.2)
"""Settings that are compared: the most candidates, and how much worse than the best they may be."""
SMOKE = {"count": 2, "objects": 2, "segmenter": "none", "tilts_deg": (20.0,)}


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    count: int = 72
    """Validation frames."""
    objects: int = 26
    """Objects of the validation catalogue, from its beginning."""
    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1, in turn."""


def run(settings: Settings, job: Job) -> Report:
    """Weights of the comparison, the share of frames whose object it finds, and what fewer candidates would cost."""
    measured = job.map(lambda tilt: _measure(settings, float(tilt), job.seed), map(str, settings.tilts_deg), "tilt")
    frames = [frame for part in measured.values() for frame in part]
    weights = fit([frame for frame in frames if frame["true"] in frame["rows"]])
    ways: dict[str, Callable[[Mapping[str, float]], float]] = {
        "correlation with the map": lambda row: row["score_bank"],
        "correlation with the frame": lambda row: row["frame_fit"],
        "comparison, as shipped": lambda row: odds(row, COMPARISON),
        "comparison, fitted here": lambda row: odds(row, weights),
    }
    rows = [{"by": name, "top_1": _share(frames, way)} for name, way in ways.items()]
    rows.append({"by": "comparison, group left out of the fit", "top_1": _left_out(frames)})
    lists = [_short(frames, SearchConfig(candidates=count, lead=lead)) for count, lead in product(COUNTS, LEADS)]
    return {"weights": weights, "rows": rows, "lists": lists, "per_frame": frames}


def _measure(settings: Settings, tilt_deg: float, seed: int) -> list[dict[str, Any]]:
    """What is found of each candidate in the frames of one tilt."""
    objects = dict(list(validation_catalogue().items())[: settings.objects])
    key = jax.random.fold_in(jax.random.key(VALIDATION_SEED + seed), int(10 * tilt_deg))
    sonar, segmenter = sonar_for(tilt_deg), sj.load_segmenter(settings.segmenter)
    how: dict[str, Any] = {"engine": engine(), "compact": True}
    targets = {name: TargetSearch(one.mesh, sonar, ALL, name=name, **how) for name, one in objects.items()}
    first_look = FirstLook(list(targets.values()))
    first, every = settings.tilts_deg.index(tilt_deg), len(settings.tilts_deg)
    found = []
    with Progress(f"{tilt_deg:g} deg", settings.count // every, unit="frame", leave=False) as progress:
        for number in range(settings.count // every):
            name = list(objects)[(number * every + first) % len(objects)]
            with progress.part(name):
                part = jax.random.fold_in(key, number)
                device = draw_device(objects[name].mesh, tilt_deg, SEVERITIES, wide=ODD, key=part)
                look = jax.random.fold_in(part, 5)
                image = np.asarray(observed(device.mesh, device.start, device.sonar, device.model, key=look)[0])
                facts = {"true": name, "group": objects[name].like, "odd": device.odd}
                found.append(facts | _candidates(image, targets, first_look, segmenter))
    return found


def _candidates(
    image: np.ndarray, targets: dict[str, TargetSearch], first_look: FirstLook, segmenter: sj.Segmenter
) -> dict[str, Any]:
    """Evidence for each candidate by name, refined quickly; of all targets the first look's scores."""
    seen = np.asarray(segmenter.semantic(image, None, engine()))
    sighted = [{name: one.score for name, one in first_look.best(picture).items()} for picture in (seen, image)]
    looks = look_closely(targets, first_look, ALL, (seen, image), None, engine())
    found = quick_evidence(looks, image, seen, None, MAP_REFINEMENT, _window, engine())
    return {"rows": {look.name: one for look, one in zip(looks, found, strict=True)}, "sighted": sighted}


def _window(search: TargetSearch, at: sj.Pose) -> WindowSize:
    return plan_shared(search.mesh, search.sonar, at, MAP_REFINEMENT)


def fit(frames: list[dict[str, Any]]) -> dict[str, float]:
    """Weights of a conditional logit: the right one of each frame's candidates is the most likely."""
    every = np.array([[row[name] for name in COMPARISON] for frame in frames for row in frame["rows"].values()])
    spread = every.std(axis=0) + 1e-9
    parts = [
        (np.array([[row[name] for name in COMPARISON] for row in frame["rows"].values()]) / spread,
         list(frame["rows"]).index(frame["true"]))
        for frame in frames
    ]  # fmt: skip

    def loss(beta: np.ndarray) -> float:
        total = RIDGE * float(beta @ beta) / 2
        for values, right in parts:
            logits = values @ beta
            total += float(np.logaddexp.reduce(logits) - logits[right])
        return total

    beta = minimize(loss, np.zeros(len(COMPARISON))).x
    return {name: float(value) for name, value in zip(COMPARISON, beta / spread, strict=True)}


def odds(evidence: Mapping[str, float], weights: Mapping[str, float]) -> float:
    """Log-odds of a candidate, but for a constant that all share."""
    return sum(weight * evidence[name] for name, weight in weights.items())


def _share(frames: list[dict[str, Any]], score: Callable[[Mapping[str, float]], float]) -> float:
    best = [max(frame["rows"], key=lambda name, rows=frame["rows"]: score(rows[name])) for frame in frames]
    return float(np.mean([one == frame["true"] for one, frame in zip(best, frames, strict=True)]))


def _left_out(frames: list[dict[str, Any]]) -> float:
    shares = []
    for group in sorted({frame["group"] for frame in frames}):
        weights = fit([one for one in frames if one["group"] != group and one["true"] in one["rows"]])
        own = [frame for frame in frames if frame["group"] == group]
        shares += [_share([frame], lambda row, w=weights: odds(row, w)) for frame in own]
    return float(np.mean(shares))


def _short(frames: list[dict[str, Any]], config: SearchConfig) -> dict[str, Any]:
    """How often the right object is among the candidates that a config keeps, and how many these are."""
    kept = []
    for frame in frames:
        found = [{n: Sighting(None, 0, score) for n, score in one.items()} for one in frame["sighted"]]  # type: ignore[arg-type]
        kept.append(leading(found, config))
    right = [frame["true"] in names for frame, names in zip(frames, kept, strict=True)]
    number = float(np.mean([len(names) for names in kept]))
    return {"most": config.candidates, "lead": config.lead, "right_among": float(np.mean(right)), "number": number}


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    weights = ", ".join(f"{name} {value:.4g}" for name, value in report["weights"].items())
    rows = columns(report["rows"], {"by": "the best by", "top_1": "object right"})
    heads = {"most": "candidates", "lead": "lead", "right_among": "right one among them", "number": "how many, mean"}
    return f"{weights}\n\n{rows}\n\n{columns(report['lists'], heads)}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
