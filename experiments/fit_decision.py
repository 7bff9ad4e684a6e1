"""How should a refined match be judged, and how large are its errors? A rule and error bars from validation frames.

python -m experiments.fit_decision [--segmenter FILE] [--preset smoke] [--help]

A logistic regression weighs the evidence of `sonarjax.refine.evidence` (its AUC is also given with each object left out
of the fit in turn), a threshold is set on its probability, and `yaw_std` is scaled and joined by a constant so that the
errors are most likely. Validation frames show other objects and other devices than any test: see
`experiments.common.validation`. What is found stands in the weights file's metadata, `sonarjax.segment.rule` and
`sonarjax.recognize`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import TILTS_DEG
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.scores import area
from experiments.common.validation import Case, scenes, validation_cases
from sonarjax.recognize import STD_SCALE, UNMODELLED_YAW
from sonarjax.segment import EVIDENCE

RIDGE = 1.0
"""Weight of the squared coefficients of standardised evidence in the logistic loss [1]."""
ASTRAY_DEG = 30.0
"""Yaw errors beyond it are of another hypothesis: no error bar is fitted to them."""
TAIL = 4.0
"""An error of more standard deviations than this counts as this many [1]."""
HEADS = {
    "frames": "frames of", "count": "count", "auc": "AUC", "left_out": "AUC, object left out",
    "bank": "AUC of score_bank", "refined": "AUC of score_refined",
    "identified": "targets found", "false_alarms": "others identified",
    "within_1": "within 1 `yaw_std`", "within_2": "within 2", "median": "yaw, median [°]", "astray": "beyond 30°",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""
    count: int = 480
    """Validation frames."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""
    false_alarms: float = 0.1
    """Largest share of other objects that may be identified [1]."""


@dataclass(frozen=True)
class Measured:
    """What a recognizer found in the frames; arrays (frame,)."""

    evidence: np.ndarray
    """Evidence (frame, number), in the order of `EVIDENCE`."""
    own: np.ndarray
    """Whether the target is shown."""
    error_deg: np.ndarray
    """Error of the refined yaw [deg]."""
    std_deg: np.ndarray
    """`refine_yaw`'s own standard deviation [deg]."""
    bank: np.ndarray
    """`score_bank`."""
    refined: np.ndarray
    """`score_refined`."""


def run(settings: Settings, job: Job) -> Report:
    """The rule, the error bars' two numbers, and what both reach."""
    cases = validation_cases(job.seed, settings.count, tilts_deg=settings.tilts_deg)
    found = job.map(lambda name: _measure(cases, name), (settings.segmenter,), "segmenter")[settings.segmenter]
    values = Measured(**{name: np.asarray(v) for name, v in found.items()})
    odds, weights, offset = fit_logistic(values.evidence, values.own)
    probability = 1 / (1 + np.exp(-odds(values.evidence)))
    threshold = threshold_for(probability[~values.own], settings.false_alarms)
    scale, beyond = fit_std(values)
    left_out = _left_out(values, np.array([case.sought for case in cases]))
    families = {"any device": np.ones(len(cases), bool), "odd devices": np.array([case.odd for case in cases])}
    families["the family"] = ~families["odd devices"]
    std = np.hypot(scale * values.std_deg, beyond)
    rows = [
        {"frames": name} | _row(values, probability, left_out, std, threshold, chosen)
        for name, chosen in families.items()
        if values.own[chosen].any() and not values.own[chosen].all()
    ]
    false = float((probability >= threshold)[~values.own].mean())
    rule = {"weights": dict(zip(EVIDENCE, weights, strict=True)), "offset": offset}
    rule |= {"threshold": threshold, "false_alarms": false}
    return {"rule": rule, "std_scale": scale, "unmodelled_yaw_deg": beyond, "rows": rows}


def _measure(cases: list[Case], segmenter: str) -> dict[str, Any]:
    loaded = sj.load_segmenter(segmenter)
    made = {name: recognizers(scene.target, segmenter=loaded) for name, scene in scenes().items()}
    found: dict[str, list[Any]] = {name: [] for name in Measured.__dataclass_fields__}
    for case in tqdm(cases, desc=segmenter, unit="frame", leave=False, disable=None):
        result = made[case.sought](case.tilt_deg)(case.image, threshold=0.5)
        assert result.evidence is not None and result.yaw_std is not None
        std = np.sqrt(max(result.yaw_std**2 - UNMODELLED_YAW**2, 0.0)) / STD_SCALE
        row = [[result.evidence[name] for name in EVIDENCE], case.is_target, yaw_error_deg(result.yaw, case.yaw)]
        row += [np.degrees(std), result.score_bank, result.score_refined]
        for name, value in zip(found, row, strict=True):
            found[name].append(value)
    return found


def fit_logistic(evidence: np.ndarray, own: np.ndarray) -> tuple[Callable[[Any], Any], list[float], float]:
    """Log-odds of the target as a function of evidence (..., number), their weights and their offset.

    Targets and others count alike, however many there are of each.
    """
    mean, std = evidence.mean(0), evidence.std(0) + 1e-9
    scaled = (evidence - mean) / std
    share = np.where(own, 0.5 / own.mean(), 0.5 / (~own).mean())

    def loss(beta: np.ndarray) -> float:
        odds = scaled @ beta[:-1] + beta[-1]
        return float((share * np.logaddexp(0, np.where(own, -odds, odds))).sum() + RIDGE * (beta[:-1] ** 2).sum() / 2)

    beta = minimize(loss, np.zeros(evidence.shape[1] + 1)).x
    weights = beta[:-1] / std
    offset = float(beta[-1] - weights @ mean)
    return lambda v: v @ weights + offset, [float(w) for w in weights], offset


def threshold_for(others: np.ndarray, share: float) -> float:
    """One half, or more where more than this share of the others (frame,) would reach it."""
    first_refused = np.sort(others)[::-1][int(share * len(others))]
    return float(max(np.nextafter(first_refused, 1.0), 0.5))


def fit_std(values: Measured) -> tuple[float, float]:
    """The scale of `yaw_std` and what joins it in quadrature [deg], so that the targets' errors are most likely."""
    near = values.own & (values.error_deg <= ASTRAY_DEG) & np.isfinite(values.std_deg)
    error, std = values.error_deg[near], values.std_deg[near]

    def loss(beta: np.ndarray) -> float:
        both = np.hypot(np.exp(beta[0]) * std, np.exp(beta[1]))
        return float((np.log(both) + np.minimum(error / both, TAIL) ** 2 / 2).sum())

    best = minimize(loss, np.log([2.0, 0.3]), method="Nelder-Mead").x
    return float(np.exp(best[0])), float(np.exp(best[1]))


def _left_out(values: Measured, sought: np.ndarray) -> np.ndarray:
    """Log-odds (frame,) by a rule that was fitted without the object that is sought."""
    odds = np.zeros(len(sought))
    for name in np.unique(sought):
        inside = sought == name
        if inside.all():
            return fit_logistic(values.evidence, values.own)[0](values.evidence)
        odds[inside] = fit_logistic(values.evidence[~inside], values.own[~inside])[0](values.evidence[inside])
    return odds


def _row(
    values: Measured, probability: np.ndarray, left_out: np.ndarray, std: np.ndarray, threshold: float,
    chosen: np.ndarray,
) -> dict[str, Any]:  # fmt: skip
    own = values.own[chosen]
    error, std = values.error_deg[chosen][own], std[chosen][own]
    near = error <= ASTRAY_DEG
    said = probability[chosen] >= threshold
    scores = {"auc": probability, "left_out": left_out, "bank": values.bank, "refined": values.refined}
    return {
        "count": len(own),
        **{name: area(score[chosen], own) for name, score in scores.items()},
        "identified": float(said[own].mean()),
        "false_alarms": float(said[~own].mean()),
        "within_1": float((error <= std)[near].mean()),
        "within_2": float((error <= 2 * std)[near].mean()),
        "median": float(np.median(error)),
        "astray": float((~near).mean()),
    }


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    rule = report["rule"]
    weights = ", ".join(f"{name} {value:.4g}" for name, value in rule["weights"].items())
    return (
        f"weights: {weights}\noffset {rule['offset']:.4g}, threshold {rule['threshold']:.4g}, false alarms "
        f"{rule['false_alarms']:.3f}\nSTD_SCALE {report['std_scale']:.3f}, UNMODELLED_YAW "
        f"{report['unmodelled_yaw_deg']:.3f}°\n\n{columns(report['rows'], HEADS)}"
    )


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 8, "segmenter": "none", "tilts_deg": (20.0,)})
