"""How large are the errors of the refined yaw? Error bars from validation frames.

python -m experiments.fit_error_bar [--count N] [--segmenter FILE] [--preset smoke] [--help]

The error bar is the one under which the errors of the targets' yaws are most likely, scaled to hold 68 % of them. It is
fitted to the frames of two seeds; the first is that of `fit_decision`. The first table says how many errors lie within
the bars. The second says how likely the errors are: under bars from the curvature and `frame_drop` alone, and
under bars from the rule's score too; as fitted, and with each object or each seed left out of the fit in turn. What is
found stands in `sonarjax.refine.errorbar`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

import sonarjax as sj
from experiments.common.frames import TILTS_DEG
from experiments.common.launch import Report, launch
from experiments.common.likelihood import scale_to_68, unlikeliness
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.validation import Case, scenes, validation_cases
from sonarjax.io import SonarjaxError
from sonarjax.refine import ErrorBar
from sonarjax.refine.errorbar import SHARPEST, log_drop, relative_odds

ASTRAY_DEG = 30.0
"""Yaw errors beyond it are of another hypothesis: no error bar is fitted to them."""
RIDGE = 2.0
"""Weight of the squared coefficients of what error bars are made of, standardised [1]."""
SURE = 0.99
"""Score of frames that surely show the target [1]."""
SEEDS = (0, 1)
"""Validation seeds of a run; added to twice its own, so that no two runs share frames."""
HEADS = {
    "frames": "targets in frames of", "count": "count", "median": "yaw, median [°]", "std": "`yaw_std`, median [°]",
    "within_1": "within 1 `yaw_std`", "within_2": "within 2", "astray": "beyond 30°",
}  # fmt: skip
LIKELY_HEADS = {
    "bars": "error bars from", "fitted": "log-likelihood of an error, as fitted", "object": "object left out",
    "seed": "seed left out",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file. It must have a rule."""
    count: int = 720
    """Validation frames of each seed, half of which show the target."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""


@dataclass(frozen=True)
class Measured:
    """What a recognizer found in frames of its target; arrays (frame,)."""

    curvature_deg: np.ndarray
    """`refine_yaw`'s own standard deviation [deg]."""
    frame_drop: np.ndarray
    """How far the frame's scores fall beside the best yaw [NCC]."""
    probability: np.ndarray
    """The rule's probability that the target is shown [1]."""
    error_deg: np.ndarray
    """Error of the refined yaw [deg]."""

    def only(self, chosen: np.ndarray) -> Measured:
        """The same of the `chosen` (frame,) frames."""
        return Measured(**{name: values[chosen] for name, values in vars(self).items()})


def run(settings: Settings, job: Job) -> Report:
    """The error bar, and what it reaches.

    Raises SonarjaxError where there are no frames to fit to, or the segmenter has no rule.
    """
    if settings.count < 2:
        raise SonarjaxError("--count: expected 2 or more")
    if sj.load_segmenter(settings.segmenter).rule is None:
        raise SonarjaxError(f"--segmenter: expected one with a rule, {settings.segmenter} has none")
    cases = {k: _targets(len(SEEDS) * job.seed + k, settings) for k in SEEDS}
    names = {f"seed {k}": k for k in SEEDS}
    found = job.map(lambda k: _measure(cases[k], settings.segmenter), names, "seeds")
    values = Measured(**{
        name: np.concatenate([np.asarray(found[one][name], float) for one in names])
        for name in Measured.__dataclass_fields__
    })  # fmt: skip
    every = [case for k in SEEDS for case in cases[k]]
    sought, odd = np.array([case.sought for case in every]), np.array([case.odd for case in every])
    seed = np.repeat(SEEDS, [len(cases[k]) for k in SEEDS])
    job.arrays("measured", **vars(values), sought=sought, odd=odd, seed=seed)
    near = _near(values)
    if not near.any():
        raise SonarjaxError(f"--count: no yaw is within {ASTRAY_DEG:g}°, so there is nothing to fit to: expected more")
    bar = fit_error_bar(values.only(near))
    sure = values.probability >= SURE
    families = {"any device": seed >= 0, "odd devices": odd, "the family": ~odd, f"score {SURE:g} or more": sure}
    families |= {name: seed == k for name, k in names.items()}
    likely = [_likeliness(values.only(near), sought[near], seed[near], with_score) for with_score in (False, True)]
    return {
        "error_bar": bar._asdict(),
        "rows": [{"frames": name} | _row(values, bar, one) for name, one in families.items() if (one & near).any()],
        "likely": likely,
    }


def _targets(seed: int, settings: Settings) -> list[Case]:
    return [case for case in validation_cases(seed, settings.count, tilts_deg=settings.tilts_deg) if case.is_target]


def _measure(cases: list[Case], segmenter: str) -> dict[str, list[float]]:
    loaded = sj.load_segmenter(segmenter)
    made = {name: recognizers(scene.target, segmenter=loaded) for name, scene in scenes().items()}
    found: dict[str, list[float]] = {name: [] for name in Measured.__dataclass_fields__}
    for case in tqdm(cases, desc=segmenter, unit="frame", leave=False, disable=None):
        result = made[case.sought](case.tilt_deg)(case.image)
        assert result.evidence is not None
        row = (
            float(np.degrees(result.evidence["curvature_std"])), result.evidence["frame_drop"], result.score,
            yaw_error_deg(result.yaw, case.yaw),
        )  # fmt: skip
        for name, value in zip(found, row, strict=True):
            found[name].append(float(value))
    return found


def fit_error_bar(values: Measured, with_score: bool = True) -> ErrorBar:
    """The error bar under which the errors are most likely, scaled to hold 68 % of them.

    `odds` is 0 without the score.
    """
    error, known = np.radians(values.error_deg), _known(values)[:, : 3 if with_score else 2]
    mean, spread = known.mean(0), known.std(0) + 1e-9
    scaled = (known - mean) / spread

    def std(beta: np.ndarray) -> np.ndarray:
        return np.exp(beta[0] + scaled @ beta[1:])

    def loss(beta: np.ndarray) -> float:
        return unlikeliness(error, std(beta)) + RIDGE * float((beta[1:] ** 2).sum()) / 2

    # Errors beyond TAIL have no gradient, so a method that uses it may stop far from the best fit.
    start = [np.log(np.median(error)), *np.zeros(known.shape[1])]
    beta = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-6, "maxiter": 8000}).x
    weights = beta[1:] / spread
    offset = beta[0] - weights @ mean + np.log(scale_to_68(error, std(beta)))
    return ErrorBar(float(offset), *(float(w) for w in weights), *([] if with_score else [0.0]))


def _known(values: Measured) -> np.ndarray:
    """What error bars are made of (frame, number): the fields of `ErrorBar` after its offset."""
    curvature = np.log(np.radians(values.curvature_deg) + SHARPEST)
    return np.stack([curvature, log_drop(values.frame_drop), relative_odds(values.probability)], axis=-1)


def std_of(bar: ErrorBar, values: Measured) -> np.ndarray:
    """Standard deviations (frame,) [rad]."""
    return bar.std(np.radians(values.curvature_deg), values.frame_drop, values.probability)


def _near(values: Measured) -> np.ndarray:
    """Which frames (frame,) an error bar is fitted to: neither astray nor without a curvature."""
    return (values.error_deg <= ASTRAY_DEG) & np.isfinite(values.curvature_deg)


def _row(values: Measured, bar: ErrorBar, chosen: np.ndarray) -> dict[str, Any]:
    near = values.only(chosen & _near(values))
    std = np.degrees(std_of(bar, near))
    return {
        "count": int(chosen.sum()),
        "median": float(np.median(values.error_deg[chosen])),
        "std": float(np.median(std)),
        "within_1": float((near.error_deg <= std).mean()),
        "within_2": float((near.error_deg <= 2 * std).mean()),
        "astray": float((values.error_deg[chosen] > ASTRAY_DEG).mean()),
    }


def _likeliness(values: Measured, sought: np.ndarray, seed: np.ndarray, with_score: bool) -> dict[str, Any]:
    """Mean log-likelihood of an error, up to a constant: under a fit to all, and to those of other objects or seeds."""
    error = np.radians(values.error_deg)

    def mean(groups: np.ndarray) -> float:
        std = np.zeros(len(error))
        for one in np.unique(groups):
            inside = groups == one
            others = ~inside if not inside.all() else inside
            std[inside] = std_of(fit_error_bar(values.only(others), with_score), values.only(inside))
        return -unlikeliness(error, std) / len(error)

    name = "curvature, drop and score" if with_score else "curvature and drop"
    return {"bars": name, "fitted": mean(np.zeros(len(error))), "object": mean(sought), "seed": mean(seed)}


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    bar = ", ".join(f"{name} {value:.4g}" for name, value in report["error_bar"].items())
    return f"error bar: {bar}\n\n{columns(report['rows'], HEADS)}\n\n{columns(report['likely'], LIKELY_HEADS)}"


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"count": 10, "segmenter": "none", "tilts_deg": (20.0,)})
