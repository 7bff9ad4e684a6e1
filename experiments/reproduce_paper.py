"""What do we get for each number of the paper's §4? All of it at once, on simulated frames.

python -m experiments.reproduce_paper [--preset smoke] [--help]: the main job (`make reproduce`).

The 288 frames of §4.1 on the 10° grid give Tables 3 and 4, PSNR and IoU (§4.3) and accuracy (§4.4); the same frames
with random yaw offsets are where refinement is judged, half as many in the tank of Table 1 show what walls do.
Thresholds were fixed beforehand on validation frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from experiments.common import paper
from experiments.common.frames import TILTS_DEG, TestFrame, paper_frames
from experiments.common.launch import Report, launch
from experiments.common.maps import map_metrics
from experiments.common.metrics import columns
from experiments.common.runs import Job, load_arrays
from experiments.common.scores import Found, recognize_all, summary_of
from experiments.common.segmenters import BASELINES, Name
from experiments.common.tables import correlation_table, off_diagonal, receiver_curve
from sonarjax.io.safetensors import read_safetensors
from sonarjax.segment.training import find_recipe

HEADS = {
    "segmenter": "segmenter",
    "accuracy": "accuracy",
    "best_accuracy": "at the best threshold",
    "identified": "targets found",
    "refused": "others refused",
    "bin_right": "yaw bin right",
    "iou": "IoU",
    "bin_median": "bin error, median [°]",
    "yaw_median": "refined, median [°]",
    "yaw_p95": "refined, 95 % [°]",
    "decided": "accuracy of `recognize`",
}
FROM_OFFSETS = ("bin_median", "yaw_median", "yaw_p95", "decided")
BESIDE = {"item": "item", "what": "what", "paper": "paper", "ours": "ours", "note": "note"}
EXAMPLES = 4  # frames of each kind whose pictures are kept for Fig. 8: one a set, at different yaws


@dataclass(frozen=True)
class Settings:
    """What is computed."""

    segmenters: tuple[Name, ...] = ("pix2pix", "paper-cpu", "discriminative", "none", "otsu")
    """Segmenters to compare: ours first, then the paper's own recipes; `none` is what Table 4 shows."""
    step_deg: int = 10
    """Yaw step of each set [deg], a divisor of 90; 10 gives the 288 frames of §4.1."""
    yaw_offset_deg: float = 5.0
    """Largest offset of each yaw from the grid [deg], where refinement is judged."""
    tilts_deg: tuple[float, ...] = TILTS_DEG
    """Tilts of the sonar [deg], of those of §4.1."""
    tank_step_deg: int = 20
    """Yaw step of the frames in the tank [deg], a divisor of 360."""

    def __post_init__(self) -> None:
        """Raises ValueError for settings that give no table."""
        if self.step_deg < 1 or 90 % self.step_deg:
            raise ValueError(f"--step-deg: expected a divisor of 90, got {self.step_deg}")
        if "none" not in self.segmenters[1:]:
            raise ValueError("--segmenters: expected two or more, with `none` among them but not first")


def run(settings: Settings, job: Job) -> Report:
    """Measure both sets of frames with each segmenter, and put each number beside the paper's."""
    frames = partial(paper_frames, job.seed, step_deg=settings.step_deg, tilts_deg=settings.tilts_deg)
    grid, offset = frames(), frames(yaw_offset_deg=settings.yaw_offset_deg)
    on_grid = job.map(partial(_on_grid, job, grid), settings.segmenters, "grid")
    off_grid = job.map(partial(_off_grid, job, offset, "offset"), settings.segmenters, "offset")
    step = {"step_deg": settings.tank_step_deg, "yaw_offset_deg": settings.yaw_offset_deg}
    tank = paper_frames(job.seed, tilts_deg=settings.tilts_deg, tank=True, **step)
    in_tank = job.map(partial(_off_grid, job, tank, "tank"), settings.segmenters[:1], "tank")
    tables = {
        item: correlation_table(**_of(load_arrays(job.folder, f"grid_{name}"), "scores", "yaw_deg", "is_target"))
        for item, name in (("tab03", settings.segmenters[0]), ("tab04", "none"))
    }
    segmenters = [
        {"segmenter": name} | on_grid[name] | _of(off_grid[name], *FROM_OFFSETS) for name in settings.segmenters
    ]
    first = settings.segmenters[0]
    rows = (
        beside_the_paper(segmenters, tables, len(grid))
        + in_training()
        + beyond(off_grid[first], in_tank[first], len(tank))
    )
    return {"rows": rows, "segmenters": segmenters, "offset": off_grid, "tank": in_tank, "tables": tables}


def _on_grid(job: Job, frames: list[TestFrame], name: str) -> dict[str, Any]:
    """Recognition on the 10° grid, and the maps of the target's frames, as §4.3 has them."""
    found = recognize_all(frames, name)
    maps = [result.semantic for result in found.results]
    false, true, area = receiver_curve(found.score, found.is_target)
    job.arrays(f"grid_{name}", **_arrays(found, frames), false_positive=false, true_positive=true)
    shown = _examples(frames)
    pictures = {"image": [frames[k].image for k in shown], "truth": [frames[k].clean for k in shown]}
    facts = {"is_target": found.is_target[shown], "tilt_deg": [frames[k].tilt_deg for k in shown]}
    job.arrays(f"maps_{name}", semantic=[maps[k] for k in shown], **pictures, **facts)
    own = [k for k, frame in enumerate(frames) if frame.is_target]
    return summary_of(found) | map_metrics([maps[k] for k in own], [frames[k] for k in own]) | {"auc": area}


def _off_grid(job: Job, frames: list[TestFrame], title: str, name: str) -> dict[str, Any]:
    """Recognition and refinement at yaws off the grid."""
    found = recognize_all(frames, name, refine=True)
    job.arrays(f"{title}_{name}", **_arrays(found, frames))
    return summary_of(found)


def _arrays(found: Found, frames: list[TestFrame]) -> dict[str, Any]:
    """What figures draw of each frame (frame, ...)."""
    return {
        "scores": [result.scores_by_yaw for result in found.results],
        "yaw_deg": np.degrees([frame.yaw for frame in frames]),
        "tilt_deg": [frame.tilt_deg for frame in frames],
        **found.arrays(),
    }


def _examples(frames: list[TestFrame]) -> list[int]:
    """Frames whose pictures are kept: of each kind one in every set, a quarter turn and a bit apart."""
    kinds = [[k for k, frame in enumerate(frames) if frame.is_target == kind] for kind in (True, False)]
    picked = []
    for kind in kinds:
        size = len(kind) // EXAMPLES
        picked += [kind[number * size + (number * (size // 4 + 1)) % size] for number in range(EXAMPLES)]
    return picked


def _of(values: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: values[name] for name in names}


def beside_the_paper(segmenters: list[dict[str, Any]], tables: dict[str, Any], frames: int) -> list[dict[str, Any]]:
    """Every number that the paper's §4 prints in its text, or the mean of a table's, beside ours."""
    best, raw = segmenters[0], next(row for row in segmenters if row["segmenter"] == "none")
    tab03, tab04 = tables["tab03"], tables["tab04"]
    fixed = f"threshold {best['threshold']:.3f}, from validation frames"
    lines: list[tuple[str, str, float | None, float, str]] = [
        ("§4.1", "frames", 288.0, float(frames), "ours are simulated"),
        ("Table 3", "target with its own template", float(np.diag(paper.TABLE_3_TARGET).mean()),
         float(np.diag(tab03["target"]).mean()), "mean of four angles"),
        ("Table 3", "non-target, largest", float(paper.TABLE_3_OTHER.max()), float(tab03["other"].max()),
         "the piles share their bricks"),
        ("Table 4", "target with its own template", float(np.diag(paper.TABLE_4).mean()),
         float(np.diag(tab04["target"]).mean()), "the sensor model is calibrated to this"),
        ("Table 4", "other angles, largest", float(off_diagonal(paper.TABLE_4).max()),
         float(off_diagonal(tab04["target"]).max()), ""),
        ("§4.3", "PSNR before [dB]", paper.PSNR_RAW, best["psnr_raw"], "grey scale of the frames decides"),
        ("§4.3", "PSNR after [dB]", paper.PSNR_MAP, best["psnr"], "depends on the crop's margin"),
        ("§4.3", "PSNR gain [dB]", paper.PSNR_GAIN, best["psnr_gain"], "margin 0.3 of the object"),
        ("§4.3", "PSNR gain, wide crop [dB]", paper.PSNR_GAIN, best["psnr_gain_wide"], "margin 0.6"),
        ("§4.3", "IoU", paper.IOU, best["iou"], "mean of highlight and shadow"),
        ("§4.4", "accuracy, best threshold", paper.ACCURACY, best["best_accuracy"], "chosen on the test frames"),
        ("§4.4", "accuracy, fixed threshold", None, best["accuracy"], fixed),
        ("§4.4", "the same, not segmented", None, raw["accuracy"], "segmenter none"),
        ("§4.4", "accuracy of `recognize`", None, best["decided"], "rule from validation frames, yaw off the grid"),
        ("beyond", "area under the ROC", None, best["auc"], "identification alone"),
        ("beyond", "refined yaw, median [°]", None, best["yaw_median"], "yaw off the grid"),
        ("beyond", "refined yaw, 95 % [°]", None, best["yaw_p95"], "the best bin alone: up to 5"),
    ]  # fmt: skip
    return [dict(zip(BESIDE, line, strict=True)) for line in lines]


def beyond(offset: dict[str, Any], tank: dict[str, Any], frames: int) -> list[dict[str, Any]]:
    """The first segmenter off the 10° grid, and in the tank: what §4 does not print."""
    where = f"walls in view, {frames} frames, off the grid"
    lines: list[tuple[str, str, float | None, float, str]] = [
        ("off the grid", "accuracy, fixed threshold", None, offset["accuracy"], "yaws up to 5° beside the templates'"),
        ("Table 1", "accuracy of `recognize` in the tank", None, tank["decided"], where),
        ("Table 1", "accuracy in the tank, fixed threshold", None, tank["accuracy"], where),
        ("Table 1", "refined yaw in the tank, median [°]", None, tank["yaw_median"], ""),
        ("Table 1", "refined yaw in the tank, 95 % [°]", None, tank["yaw_p95"], ""),
    ]
    return [dict(zip(BESIDE, line, strict=True)) for line in lines]


def in_training() -> list[dict[str, Any]]:
    """§3.2: how long the paper's recipe took where it was trained to its end, and what that says of its full width.

    Nothing where no weights are. The work of a step grows as the square of the width.
    """
    lines: list[tuple[str, str, float | None, float, str]] = []
    narrow, wide = _cost("paper-cpu"), _cost("paper")
    width = find_recipe("paper").networks.width
    if narrow:
        lines.append(("§3.2", f"training at width {narrow['width']} [h]", None, narrow["hours"], _measured(narrow)))
    if wide:
        note = f"{_measured(wide)}; the paper's on a Titan V"
        lines.append(("§3.2", f"training at width {width} [h]", paper.TRAINING_HOURS, wide["hours"], note))
    elif narrow:
        note = f"projected for {narrow['device']}, not run; the paper's on a Titan V"
        projected = narrow["hours"] * (width / narrow["width"]) ** 2
        lines.append(("§3.2", f"training at width {width} [h]", paper.TRAINING_HOURS, projected, note))
    return [dict(zip(BESIDE, line, strict=True)) for line in lines]


def _cost(name: str) -> dict[str, Any] | None:
    """What the training of a network cost; None where its weights are not."""
    path = BASELINES[name]
    return read_safetensors(path)[1].get("cost") if path.exists() else None


def _measured(cost: dict[str, Any]) -> str:
    return f"measured on {cost['device']}, {cost['images_per_s']:.0f} images a second"


def table(report: Report) -> str:
    """Ours beside the paper's, then the segmenters side by side."""
    return f"{columns(report['rows'], BESIDE)}\n\n{columns(report['segmenters'], HEADS)}"


if __name__ == "__main__":
    launch(
        run,
        Settings,
        table,
        smoke={"step_deg": 90, "segmenters": ("otsu", "none"), "tilts_deg": (20.0,), "tank_step_deg": 180},
    )
