"""Which part of the sensor makes its frames hard?

python -m experiments.ablate_sensor [--preset smoke] [--help]

Frames of §4.1 of the nominal sensor model, and of the same with one of its parts switched off, all random draws of the
others unchanged; the last row has all of them off. Thresholds are those of the whole sensor on validation frames, and
scores rise without speckle, so the accuracy at the best threshold on these very frames stands beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from experiments.common.frames import TILTS_DEG, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.scores import recognize_all
from experiments.common.segmenters import Name
from experiments.evaluate_segmenters import row
from sonarjax.sensor import SensorModel

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
NOTHING, EVERYTHING = "nothing", "all of them"
HEADS = {
    "part": "switched off",
    "segmenter": "segmenter",
    "score_own": "NCC own",
    "score_other": "NCC other",
    "iou": "IoU",
    "psnr": "PSNR [dB]",
    "accuracy": "accuracy",
    "best_accuracy": "at the test-optimal threshold",
    "bin_right": "yaw bin right",
}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    parts: tuple[str, ...] = (NOTHING, *PARTS, EVERYTHING)
    """Parts of the sensor model to switch off, one at a time."""
    segmenters: tuple[Name, ...] = ("none", "pix2pix")
    """Segmenters to compare; with none, the correlation is the raw frame's."""
    step_deg: int = 30
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    yaw_offset_deg: float = 0.0
    """Uniform offset of each yaw within ± this [deg]; 0 as in the frames that the model was calibrated on."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""

    def __post_init__(self) -> None:
        """Raises ValueError for a part that there is not."""
        unknown = set(self.parts) - {NOTHING, *PARTS, EVERYTHING}
        if unknown:
            raise ValueError(f"--parts: unknown {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")


def without(part: str) -> SensorModel:
    """The nominal sensor model with one of its parts switched off, or nothing, or all of them."""
    changes = {name: value for one in PARTS.values() for name, value in one.items()} if part == EVERYTHING else {}
    return replace(SensorModel.nominal(), **changes, **PARTS.get(part, {}))


def run(settings: Settings, job: Job) -> Report:
    """One row for each part and segmenter."""
    measured = job.map(partial(_measure, settings, job.seed), settings.parts, "switched off")
    return {"rows": [{"part": part} | one for part, rows in measured.items() for one in rows]}


def _measure(settings: Settings, seed: int, part: str) -> Sequence[dict[str, str | float]]:
    step, offset, tilts = settings.step_deg, settings.yaw_offset_deg, settings.tilts_deg
    frames = paper_frames(seed, step_deg=step, yaw_offset_deg=offset, model=without(part), tilts_deg=tilts)
    return [{"segmenter": name} | row(recognize_all(frames, name), frames) for name in settings.segmenters]


def table(report: Report) -> str:
    """The rows as a table."""
    return columns(report["rows"], HEADS)


if __name__ == "__main__":
    small = {"parts": ("speckle",), "segmenters": ("none",), "step_deg": 180, "tilts_deg": (20.0,)}
    launch(run, Settings, table, smoke=small)
