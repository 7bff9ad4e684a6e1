"""What does recognition depend on? One thing is varied at a time, all else as in §4.1.

python -m experiments.ablate --vary severity                     [--preset smoke] [--help]
python -m experiments.ablate --vary tilt --values -5 0 5         some of its values
python -m experiments.ablate --vary training --seeds 0 1 2       the full form: some 7 h on two cores
python -m experiments.ablate --vary training --seeds 0 1 2 --recipe paper   the same in larger batches, for a GPU

`SWEEPS` is the table of what can be varied, and how. Thresholds were fixed beforehand on validation frames of the whole
sensor at severity 1; the accuracy at the best threshold on these very frames stands beside, and alone where the banks
are rendered at the known place. What a training's variants are stands in `common/trainings.py`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, NamedTuple

import numpy as np

import sonarjax as sj
from experiments.common.at_place import bank_with, judged_at_place, only, scores_at_place
from experiments.common.frames import TILTS_DEG, TestFrame, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.maps import map_metrics
from experiments.common.metrics import WITHIN_BIN_DEG, columns, summary_deg, yaw_error_deg
from experiments.common.recognizers import recognizers, unrefined
from experiments.common.runs import Job, code_digest
from experiments.common.scores import Found, recognize_all, summary_of
from experiments.common.segmenters import Name, available, map_of, threshold_of
from experiments.common.sets import SETS, frames_of, target
from experiments.common.trainings import SIZES, VARIANTS, Trainings, share_pairs, train
from sonarjax.sensor import SensorModel

Measures = dict[str, dict[str, Any]]
"""What was measured by name, by what was matched."""
NOTHING, EVERYTHING = "nothing", "all of them"
PARTS: dict[str, dict[str, float]] = {
    "speckle": {"speckle": 0.0},
    "speckle's correlation": {"speckle_beams": 0.0, "speckle_bins": 0.0},
    "texture": {"texture": 0.0},
    "noise": {"noise": 0.0},
    "beam pattern": {"beam_widening": 0.05},  # no side lobes; two-way, the next beam is 36 dB down anyway
    "crosstalk": {"crosstalk": 0.0},
    "streaks": {"streak": 0.0},
    "beam gains": {"beam_gain_std": 0.0},
    "pulse": {"pulse_bins": 1.0},
    "floor bounce": {"floor_bounce": 0.0},
    "surface bounce": {"surface_bounce": 0.0},
    "vertical skirt": {"elevation_skirt": 1e3},  # the aperture ends sharply, as in a template
    "imperfect TVG": {"tvg_exponent": 4.0, "tvg_absorption": 1.0},  # a flat floor comes out level
    "automatic gain": {"automatic_gain": 0.0},
}
"""What is changed in the nominal sensor model to switch off each of its parts."""
RECOGNIZED = {
    "accuracy": "accuracy: target frames identified with the right yaw bin and others refused, threshold fixed",
    "best_accuracy": "best: the same at the threshold that is best on these very frames, as in the paper's 0.9201",
    "bin_right": "bin: target frames whose best template, turned to where it was found, is within 5.5° of the yaw",
    "identification": "identification: frames of both objects on the right side of the threshold",
    "score_own": "NCC own: mean correlation (eq. 4) of target frames with the template of their own yaw bin",
    "score_target": "NCC best: the same with the best of the templates",
    "score_other": "NCC other: mean correlation of the other object's frames with the best of the templates",
    "score_other_largest": "largest: the largest of those",
    "iou": "IoU: of the 128 × 128 crop's labels, all frames together, mean of highlight and shadow",
    "psnr": "PSNR: of the map on that crop against the true map [dB], mean over frames",
    "psnr_gain": "gain: that, less the PSNR of the raw crop [dB]",
    "psnr_gain_wide": "gain, wide: the gain on crops of twice the margin around the object [dB]",
}
REFINED = {
    "yaw_median": "yaw median: yaw error of targets [°]; of offset yaws refined, on the map first, then on the frame",
    "yaw_p95": "yaw 95 %: its 95th percentile [°]",
}
MATCHED = {
    "best_accuracy": "accuracy at the test-optimal threshold",
    "bin_right": "yaw bin right",
    "score_own": "NCC own",
    "score_wrong": "other yaws",
    "score_other": "other object",
}
BINNED = {
    "bin_right": "nearest bin found",
    "bin_astray": "over 20° off",
    "bin_median": "bin error, median [°]",
    "bin_mean": "mean",
    "bin_rms": "RMS",
    "bin_p95": "95 %",
    "floor_mean": "floor, median and mean",
    "floor_rms": "RMS",
    "floor_p95": "95 %",
    "yaw_astray": "refined, over 20° off",
    "yaw_median": "refined error, median [°]",
    "yaw_mean": "mean",
    "yaw_rms": "RMS",
    "yaw_p95": "95 %",
    "bin_ms": "time a frame [ms]",
    "yaw_ms": "with refinement",
}
TRAINED = {
    "iou_mean": "IoU",
    "iou_highlight": "of highlight",
    "iou_shadow": "of shadow",
    "psnr_db": "PSNR [dB]",
    "psnr_gain_db": "gain [dB]",
    "distance": "eq. 3's distance",
    "pairs": "pairs",
    "passes": "times seen",
}


class Sweep(NamedTuple):
    """One thing that can be varied."""

    varied: str
    """What it is, with its unit."""
    values: Sequence[Any]
    """Its values: numbers, any of which will do, or the names of all that there are."""
    measure: Callable[[Study, Any], Measures]
    """What is measured at one of them."""
    columns: Mapping[str, str]
    """What the table shows of that: its head, and behind a colon what it means."""
    maps: Sequence[Name]
    """What is matched: truth is the true map, none the raw frame, else a segmenter's map."""
    step_deg: int
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    anywhere: bool = False
    """Whether each frame's yaw is drawn anywhere in its step, so that no bin's middle is favoured."""


SWEEPS = {
    # What is each segmenter worth, in depth? Each set is like the first but for one thing (`common/sets.py`).
    "frames": Sweep(
        "frames", tuple(SETS), lambda study, name: recognized(study, study.of_set(name), refine=name == "offset yaw"),
        RECOGNIZED | REFINED, available(), 10,
    ),
    # How does recognition fall as the sonar gets worse? Severity 1 is calibrated to the paper's frames, training saw 0
    # to 2, and thresholds are those of 1: what a user meets whose sonar is worse or better.
    "severity": Sweep(
        "severity", (0.0, 0.5, 1.0, 1.5, 2.0, 3.0),
        lambda study, value: recognized(study, study.draw(SensorModel.nominal(value))),
        RECOGNIZED, ("pix2pix", "none", "otsu"), 20,
    ),
    # Which part of the sensor makes its frames hard? Each is switched off alone, all random draws of the others
    # unchanged, at last all of them. On the raw frames, the correlation is theirs.
    "sensor": Sweep(
        "switched off", (NOTHING, *PARTS, EVERYTHING), lambda study, part: recognized(study, study.draw(without(part))),
        RECOGNIZED, ("none", "pix2pix"), 30,
    ),
    # What carries the match? Of a map, the half that the templates lack is taken away; of a raw frame nothing can be.
    "template": Sweep(
        "template of", ("both", "highlight", "shadow"), lambda study, part: matched(study, part=part),
        MATCHED, ("truth", "pix2pix", "none"), 10, True,
    ),
    # How well must tilt and distance be known? The template may lie anywhere in the frame, so that a wrong distance
    # costs by what it does to the template's shape alone.
    "tilt": Sweep(
        "bank too steep by [°]", (-5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0),
        lambda study, off: matched(study, tilt_error_deg=off), MATCHED, ("truth", "pix2pix"), 10, True,
    ),
    "distance": Sweep(
        "bank too far by [m]", (-0.3, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.3),
        lambda study, off: matched(study, distance_error_m=off), MATCHED, ("truth", "pix2pix"), 10, True,
    ),
    # How wide may the bins of yaw be? The paper's are 10°. The true map is drawn by the renderer that refines: it shows
    # the bins alone. Refinement may go 10° from the best bin, or a bin's width where bins are wider.
    "yaw_bin": Sweep(
        "bin [°]", (2.0, 5.0, 10.0, 15.0, 30.0), lambda study, width: binned(study, width),
        BINNED, ("truth", "pix2pix", "none"), 20, True,
    ),
    # What of the paper's training matters?
    "training": Sweep(
        "variant", (*VARIANTS, *SIZES), lambda study, variant: trained(study, variant),
        TRAINED, ("pix2pix",), 10,
    ),
}  # fmt: skip
"""What can be varied: from which values, how each is measured and shown, and on which frames."""


@dataclass(frozen=True)
class Settings(Trainings):
    """What is varied, and on what."""

    vary: Literal["frames", "severity", "sensor", "template", "tilt", "distance", "yaw_bin", "training"] = "severity"
    """What is varied."""
    values: tuple[str, ...] = ()
    """Some of its values: numbers or names; without, those of the table, of training those with all the pairs."""
    most: int = 0
    """At most so many values, the first; 0 for all."""
    maps: tuple[Name, ...] = ()
    """What is matched: truth is the true map, none the raw frame, else a segmenter's map; without, as in the table."""
    step_deg: int = 0
    """Yaw step of each set [deg], 10 for the 288 frames of §4.1; 0: as in the table."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""

    def __post_init__(self) -> None:
        """Raises ValueError for a value that cannot be taken."""
        for value in self.chosen():
            if self.vary == "yaw_bin" and (value < 1 or 360 % value):
                raise ValueError(f"--values: expected divisors of 360, got {value:g}")

    def chosen(self) -> list[Any]:
        """The values, in order. Raises ValueError for one that there is not."""
        known = SWEEPS[self.vary].values
        usual = [value for value in known if value not in SIZES]
        return [_value(text, known) for text in self.values or map(str, usual)][: self.most or None]


def _value(text: str, known: Sequence[Any]) -> Any:
    """A number or one of the names. Raises ValueError that says what was expected."""
    if text in known:
        return text
    try:
        if isinstance(known[0], float):
            return float(text)
    except ValueError:
        raise ValueError(f"--values: expected numbers, got {text!r}") from None
    raise ValueError(f"--values: expected some of {', '.join(known)}, got {text!r}")


class Study:
    """A run's settings, and what its variations share, made when it is first asked for."""

    def __init__(self, settings: Settings, job: Job) -> None:
        """Of one seed."""
        self.sweep, self.settings, self.job = SWEEPS[settings.vary], settings, job
        self.names = settings.maps or self.sweep.maps
        self.pairs = job.folder / code_digest() / "pairs"  # a training that other code began must not go on
        if settings.vary == "training":
            share_pairs(self.pairs, settings, job.seed)

    @property
    def step_deg(self) -> int:
        """Yaw step of each set [deg]."""
        return self.settings.step_deg or self.sweep.step_deg

    def draw(self, model: SensorModel | None = None) -> list[TestFrame]:
        """The frames of §4.1, of the nominal sensor or of `model`."""
        step, tilts = self.step_deg, self.settings.tilts_deg
        offset = step / 2 if self.sweep.anywhere else 0.0
        return paper_frames(self.job.seed, step_deg=step, yaw_offset_deg=offset, model=model, tilts_deg=tilts)

    def of_set(self, name: str) -> list[TestFrame]:
        """The frames of a set."""
        return frames_of(name, self.job.seed, self.step_deg, self.settings.tilts_deg)

    @cached_property
    def frames(self) -> list[TestFrame]:
        """The frames of the nominal sensor."""
        return self.draw()

    @cached_property
    def maps(self) -> dict[str, list[np.ndarray]]:
        """What is matched of them, by name."""
        return {name: [map_of(name, frame) for frame in self.frames] for name in self.names}


def run(settings: Settings, job: Job) -> Report:
    """One row for each value and map: `value`, `map` and what was measured."""
    study = Study(settings, job)
    cases = {f"{value}": value for value in settings.chosen()}
    measured = job.map(partial(study.sweep.measure, study), cases, settings.vary)
    rows = [
        {"value": value, "map": name} | found for case, value in cases.items() for name, found in measured[case].items()
    ]
    return {"vary": settings.vary, "rows": rows}


# ---------------------------------------------------------------- other frames, another sensor


def without(part: str) -> SensorModel:
    """The nominal sensor model with one of its parts switched off, or nothing, or all of them."""
    changes = {name: value for one in PARTS.values() for name, value in one.items()} if part == EVERYTHING else {}
    return replace(SensorModel.nominal(), **changes, **PARTS.get(part, {}))


def recognized(study: Study, frames: list[TestFrame], refine: bool = False) -> Measures:
    """What is recognized in frames, and how good the maps are."""
    return {name: _row(recognize_all(frames, name, refine=refine), frames) for name in study.names}


def _row(found: Found, frames: list[TestFrame]) -> dict[str, float]:
    own = [_own_score(result, frame) for result, frame in zip(found.results, frames, strict=True) if frame.is_target]
    maps = map_metrics([result.semantic for result in found.results], frames)
    return summary_of(found) | maps | {"score_own": float(np.mean(own))}


def _own_score(result: sj.Recognition, frame: TestFrame) -> float:
    scores = result.scores_by_yaw
    return float(scores[round(frame.yaw * len(scores) / (2 * np.pi)) % len(scores)])


# ---------------------------------------------------------------- another bank, at the known place


def matched(
    study: Study, *, part: str = "both", tilt_error_deg: float = 0.0, distance_error_m: float = 0.0
) -> Measures:
    """Eq. 4 with templates that show a part of the object, or are rendered for a geometry with an error."""
    tilts = {frame.tilt_deg for frame in study.frames}
    banks = {tilt: bank_with(tilt, tilt_error_deg, distance_error_m) for tilt in tilts}
    cut = {tilt: replace(bank, templates=only(part, bank.templates)) for tilt, bank in banks.items()}
    return {
        name: judged_at_place(
            scores_at_place([image if name == "none" else only(part, image) for image in maps], study.frames, cut),
            study.frames,
        )
        for name, maps in study.maps.items()
    }


# ---------------------------------------------------------------- other bins of yaw

ASTRAY_DEG = 20.0  # farther off than any bin's half: another aspect of the object was taken for this one


def binned(study: Study, width_deg: float) -> Measures:
    """Errors of the best bin and of the refined yaw in the target's frames, and what the nearest bin would leave."""
    frames = [frame for frame in study.frames if frame.is_target]
    recognizer_of = recognizers(target(), search=sj.SearchConfig(yaw_bins=round(360 / width_deg)))
    floor = {f"floor_{name}": value for name, value in floor_deg(width_deg).items()}
    return {name: floor | _yaw_errors(recognizer_of, frames, name, width_deg) for name in study.names}


def _yaw_errors(
    recognizer_of: Callable[[float], sj.Recognizer], frames: Sequence[TestFrame], segmenter: str, width_deg: float
) -> dict[str, float]:
    true, limit, values = [frame.yaw for frame in frames], threshold_of(segmenter), {}
    for stage, refine in (("bin", False), ("yaw", True)):
        found, seconds = [], []
        for frame in frames:
            recognizer = recognizer_of(frame.tilt_deg)
            recognizer = recognizer if refine else unrefined(recognizer)
            started = time.perf_counter()
            found.append(recognizer(frame.image, semantic=map_of(segmenter, frame), threshold=limit).yaw)
            seconds.append(time.perf_counter() - started)
        error = yaw_error_deg(found, true)
        values |= {f"{stage}_{name}": value for name, value in summary_deg(error).items()}
        values[f"{stage}_right"] = float((error <= WITHIN_BIN_DEG * width_deg / 10).mean())
        values[f"{stage}_astray"] = float((error > ASTRAY_DEG).mean())
        # The median, since the first frames of a sonar render its banks, which are kept.
        values[f"{stage}_ms"] = 1e3 * float(np.median(seconds))
    return values


def floor_deg(width_deg: float) -> dict[str, float]:
    """Statistics [deg] of the error's size when the nearest bin of `width_deg` is always found: uniform in ± half."""
    return {
        "median": width_deg / 4,
        "mean": width_deg / 4,
        "rms": width_deg / math.sqrt(12),
        "p95": 0.95 * width_deg / 2,
    }


# ---------------------------------------------------------------- another training


def trained(study: Study, variant: str) -> Measures:
    """Validation metrics of a training at its end, and their curves."""
    return {"pix2pix": train(variant, study.settings, study.pairs, study.job.seed)}


def table(report: Report) -> str:
    """The rows as a table, and what its columns mean."""
    sweep = SWEEPS[report["vary"]]
    heads = {key: text.partition(": ")[0] for key, text in sweep.columns.items()}
    rows = columns(report["rows"], {"value": sweep.varied, "map": "matched on", **heads})
    return "\n".join([rows, "", *(text for text in sweep.columns.values() if ": " in text)]).rstrip()


if __name__ == "__main__":
    small = {"most": 1, "maps": ("none",), "step_deg": 180, "tilts_deg": (20.0,)}
    tiny = {"width": 4, "images": 16, "pairs": 8, "validation_pairs": 8}
    launch(run, Settings, table, smoke=small | tiny)
