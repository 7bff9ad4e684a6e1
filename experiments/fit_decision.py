"""How should a refined match be judged? A rule from validation frames.

python -m experiments.fit_decision [--segmenter FILE --into FILE] [--preset smoke] [--help]

A logistic regression weighs the evidence of `sonarjax.refine.evidence`, its AUC also given with each object left out of
the fit in turn; one half is its threshold. Symmetric targets have weights of their own. Another regression tells frames
with an object from frames without, on open floor and in tanks. Validation frames show other objects and other devices
than any test: see `experiments.common.validation`. `--piles` fits to more objects, and did not carry over
(docs/outside.md). What is found stands in the weights file's metadata and in `sonarjax.segment.rule`. The columns
`within 1` and `within 2` use the shipped error bars (`fit_error_bar` fits them) and the rule from before this fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

import sonarjax as sj
from experiments.common.drawn_piles import pile_scenes
from experiments.common.frames import TILTS_DEG
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns, yaw_error_deg
from experiments.common.recognizers import recognizers
from experiments.common.runs import Job
from experiments.common.scores import area
from experiments.common.validation import (
    Case,
    Scene,
    empty_cases,
    scenes,
    symmetric_cases,
    symmetric_scenes,
    validation_cases,
)
from experiments.common.walled import walled_cases
from sonarjax.io import SonarjaxError
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment import EVIDENCE, IdentificationRule
from sonarjax.segment.rule import RISES, Logistic

THRESHOLD = 0.5
"""Least probability of an identified target: both errors count alike [1]."""
RIDGE = 1.0
"""Weight of the squared coefficients of standardised evidence in the logistic loss [1]."""
ASTRAY_DEG = 30.0
"""Yaw errors beyond it are of another hypothesis: they are counted, and no error bar holds them."""
OPEN, SYMMETRIC, WALLED = "any device", "symmetric objects", "walls in view"
"""Frames of an object, on open floor and in a tank."""
FLOOR, TANKS = "bare floor", "tanks without an object"
"""Frames of neither."""
AGREE, DISAGREE = "map and frame agree", "they disagree"
"""Frames of `OPEN` by `Recognition.agree`."""
YAW_COLUMNS = ("within_1", "within_2", "median", "astray")
"""What is said of the errors of yaw."""
HEADS = {
    "frames": "frames of", "count": "count", "auc": "AUC", "left_out": "AUC, object left out",
    "bank": "AUC of score_bank", "refined": "AUC of score_refined",
    "identified": "targets found", "false_alarms": "others identified", "left_out_alarms": "object left out",
    "within_1": "within 1 `yaw_std`", "within_2": "within 2", "median": "yaw, median [°]", "astray": "beyond 30°",
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is fitted."""

    segmenter: str = "pix2pix"
    """A segmenter's name, or a weights file."""
    count: int = 480
    """Validation frames."""
    symmetric: int = 160
    """Further frames, of objects that look the same at several yaws."""
    piles: bool = False
    """Show ten drawn piles too, beside the five objects."""
    empty: int = 120
    """Frames of bare floor."""
    walled: int = 120
    """Further frames, with the walls of a drawn tank in view. Only the rule for empty frames is fitted to them."""
    empty_walled: int = 40
    """Frames of such tanks without an object."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""
    into: str = ""
    """A weights file that is given the rule; empty for none."""


@dataclass(frozen=True)
class Measured:
    """What a recognizer found in the frames; arrays (frame,)."""

    evidence: np.ndarray
    """Evidence (frame, number), in the order of `EVIDENCE`."""
    own_rise: np.ndarray
    """How far the target's best yaw can stand out [NCC]."""
    own: np.ndarray
    """Whether the target is shown."""
    error_deg: np.ndarray
    """Error of the refined yaw [deg]."""
    std_deg: np.ndarray
    """`yaw_std` [deg]."""
    bank: np.ndarray
    """`score_bank`."""
    refined: np.ndarray
    """`score_refined`."""
    agree: np.ndarray
    """Whether map and frame agree: 1 or 0, NaN where only one of them is matched."""

    def only(self, chosen: np.ndarray) -> Measured:
        """The same of the `chosen` (frame,) frames."""
        return Measured(**{name: values[chosen] for name, values in vars(self).items()})


def run(settings: Settings, job: Job) -> Report:
    """The rule, and what it reaches.

    Raises SonarjaxError for settings that leave nothing to fit to.
    """
    if settings.count < 2 or settings.empty < 1:
        raise SonarjaxError("--count, --empty: expected frames with an object (2 or more) and without (1 or more)")
    open_floor = scenes() | pile_scenes() if settings.piles else scenes()
    groups, of = _draw(settings, job.seed, open_floor), open_floor | symmetric_scenes()
    cases = [case for group in groups.values() for case in group]
    shown = np.repeat(list(groups), [len(group) for group in groups.values()])
    found = job.map(lambda name: _measure(cases, of, name), (settings.segmenter,), "segmenter")[settings.segmenter]
    values = Measured(**{name: np.asarray(v, bool if name == "own" else float) for name, v in found.items()})
    sought, odd = np.array([case.sought for case in cases]), np.array([case.odd for case in cases])
    job.arrays("measured", **vars(values), sought=sought, shown=[case.shown for case in cases], odd=odd)
    plain, judged, filled = shown == OPEN, np.isin(shown, (OPEN, SYMMETRIC)), np.isin(shown, (OPEN, SYMMETRIC, WALLED))
    rule = fit_rule(values, plain, judged, filled)
    probability = score(rule, values)
    left_out = _left_out(values, plain, judged, filled, sought)
    families = {OPEN: plain, "odd devices": plain & odd, "the family": plain & ~odd}
    families |= {AGREE: plain & (values.agree == 1), DISAGREE: plain & (values.agree == 0)}
    families |= {name: shown == name for name in (SYMMETRIC, WALLED)}
    rows = [
        {"frames": name} | _row(values, probability, left_out, chosen)
        for name, chosen in families.items()
        if values.own[chosen].any() and not values.own[chosen].all()
    ]
    for row in rows:
        if row["frames"] == SYMMETRIC:  # `yaw_error_deg` does not know their symmetry
            row.update(dict.fromkeys(YAW_COLUMNS))
    for name in (FLOOR, TANKS):
        if (chosen := shown == name).any():
            alarms = {"false_alarms": _alarms(probability[chosen]), "left_out_alarms": _alarms(left_out[chosen])}
            rows.append({"frames": name, "count": int(chosen.sum()), **alarms})
    rule = replace(rule, false_alarms=_alarms(probability[judged & ~values.own]))
    if settings.into:
        arrays, about = read_safetensors(settings.into)
        write_safetensors(settings.into, arrays, about | {"rule": rule.as_json()})
    return {"rule": rule.as_json(), "rows": rows}


def _draw(settings: Settings, seed: int, of: dict[str, Scene]) -> dict[str, list[Case]]:
    """The frames, by what they show."""
    tilts = settings.tilts_deg
    return {
        OPEN: validation_cases(seed, settings.count, tilts_deg=tilts, of=of),
        SYMMETRIC: symmetric_cases(seed, settings.symmetric, tilts_deg=tilts),
        WALLED: walled_cases(seed, settings.walled),
        FLOOR: empty_cases(seed, settings.empty, tilts_deg=tilts),
        TANKS: walled_cases(seed, settings.empty_walled, empty=True),
    }


def _measure(cases: list[Case], of: dict[str, Scene], segmenter: str) -> dict[str, Any]:
    loaded = sj.load_segmenter(segmenter)
    made = {name: recognizers(scene.target, segmenter=loaded) for name, scene in of.items()}
    found: dict[str, list[Any]] = {name: [] for name in Measured.__dataclass_fields__}
    for case in tqdm(cases, desc=segmenter, unit="frame", leave=False, disable=None):
        result = made[case.sought](case.tilt_deg)(case.image, threshold=0.5)
        assert result.evidence is not None
        row = [[result.evidence[name] for name in EVIDENCE]]
        row += [result.evidence["own_rise"], case.is_target]
        row += [yaw_error_deg(result.yaw, case.yaw)]  # NaN where nothing is shown
        row += [np.degrees(result.yaw_std), result.score_bank, result.score_refined, result.agree]
        for name, value in zip(found, row, strict=True):
            found[name].append(value)
    return found


def fit_rule(values: Measured, plain: np.ndarray, judged: np.ndarray, filled: np.ndarray) -> IdentificationRule:
    """The rule that is fitted to frames (frame,); its false alarms are not known yet.

    The rule for targets is fitted to the `plain` frames, that for targets without a distinct yaw, which leaves out the
    rises, to the `judged` frames, and that for empty frames to all; `filled` frames show an object.
    """
    kept = [k for k, name in enumerate(EVIDENCE) if name not in RISES]
    target = fit_logistic(values.evidence[plain], values.own[plain])
    few, offset = fit_logistic(values.evidence[judged][:, kept], values.own[judged])
    weights = dict.fromkeys(EVIDENCE, 0.0) | dict(zip((EVIDENCE[k] for k in kept), few, strict=True))
    flat = Logistic(tuple(weights.values()), offset)
    return IdentificationRule(*target, THRESHOLD, math.nan, Logistic(*fit_logistic(values.evidence, filled)), flat)


def fit_logistic(evidence: np.ndarray, own: np.ndarray) -> tuple[tuple[float, ...], float]:
    """The weights and the offset of the log-odds of the target in evidence (frame, number).

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
    return tuple(float(w) for w in weights), float(beta[-1] - weights @ mean)


def score(rule: IdentificationRule, values: Measured) -> np.ndarray:
    """The rule's probability (frame,) that the target is shown."""
    rows = zip(values.evidence, values.own_rise, strict=True)
    return np.array([rule.probability(dict(zip(EVIDENCE, row, strict=True)) | {"own_rise": own}) for row, own in rows])


def _alarms(probability: np.ndarray) -> float:
    return float((probability >= THRESHOLD).mean())


def _left_out(
    values: Measured, plain: np.ndarray, judged: np.ndarray, filled: np.ndarray, sought: np.ndarray
) -> np.ndarray:
    """Scores (frame,) by a rule that was fitted without the object that is sought, otherwise as in `fit_rule`."""
    scores, names = np.zeros(len(sought)), np.unique(sought)
    for name in names:
        inside = sought == name
        known = ~inside if len(names) > 1 else inside
        rule = fit_rule(values.only(known), plain[known], judged[known], filled[known])
        scores[inside] = score(rule, values.only(inside))
    return scores


def _row(values: Measured, probability: np.ndarray, left_out: np.ndarray, chosen: np.ndarray) -> dict[str, Any]:
    """What rule and error bars reach in the `chosen` (frame,) frames."""
    own = values.own[chosen]
    error, std = values.error_deg[chosen][own], values.std_deg[chosen][own]
    near = error <= ASTRAY_DEG
    said = probability[chosen] >= THRESHOLD
    scores = {"auc": probability, "left_out": left_out, "bank": values.bank, "refined": values.refined}
    return {
        "count": len(own),
        **{name: area(value[chosen], own) for name, value in scores.items()},
        "identified": float(said[own].mean()),
        "false_alarms": float(said[~own].mean()),
        "left_out_alarms": _alarms(left_out[chosen][~own]),
        "within_1": float((error <= std)[near].mean()),
        "within_2": float((error <= 2 * std)[near].mean()),
        "median": float(np.median(error)),
        "astray": float((~near).mean()),
    }


def table(report: Report) -> str:
    """What is to be copied, and what it reaches."""
    rule = report["rule"]
    parts = {"weights": rule} | {name: rule[name] for name in ("flat", "presence")}
    said = [
        f"{name}: {', '.join(f'{item} {value:.4g}' for item, value in part['weights'].items())}; offset "
        f"{part['offset']:.4g}"
        for name, part in parts.items()
    ]
    said += [f"threshold {rule['threshold']:.4g}, false alarms {rule['false_alarms']:.3f}"]
    return "\n".join(said) + f"\n\n{columns(report['rows'], HEADS)}"


if __name__ == "__main__":
    small = {"count": 10, "symmetric": 8, "empty": 2, "walled": 1, "empty_walled": 1}  # each object and another
    launch(run, Settings, table, smoke=small | {"segmenter": "none", "tilts_deg": (20.0,)})
