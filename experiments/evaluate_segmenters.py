"""What each segmenter is worth (§4.2 to 4.4): maps, correlations, accuracy and yaw on the simulated frames of §4.1.

python -m experiments.evaluate_segmenters [--smoke] [--help]: prints one table a set of frames, with the definition of
every column, and writes results.json under runs/. Objects and frames were never trained on; thresholds are fixed
beforehand on validation frames (experiments/fit_threshold.py), the test-optimal one stands beside for comparison.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import sonarjax as sj
from experiments.bench_render import parse
from experiments.common.frames import TestFrame, paper_frames, sonar_for
from experiments.common.segmenters import available, map_of, threshold_of
from sonarjax.data import Box, cut_box
from sonarjax.data.crops import MARGIN, MARGIN_OF_FRAME
from sonarjax.io import write_text
from sonarjax.segment import SEGMENTERS
from sonarjax.segment.classical import from_grey
from sonarjax.segment.metrics import confusion, iou, psnr

SETS = {
    "severity 1": {},
    "severity 1.5": {"severity": 1.5},
    "mirror image": {"mirror": True},
    "offset yaw": {"yaw_offset_deg": 5.0},
    "other devices": {"drawn": True},
}
"""Sets of frames: how each differs from the 288 of §4.1 at severity 1."""
REFINED = "offset yaw"
COLUMNS = {
    "accuracy": "target frames identified with the right yaw bin and others refused, at the threshold of validation",
    "best accuracy": "the same at the threshold that is best on this very set, as in the paper's 0.9201",
    "identified": "target frames whose score reaches the threshold",
    "refused": "other frames whose score does not",
    "bin": "target frames whose best template is the nearest of the 10° bins",
    "identification": "frames, of both objects, on the right side of the threshold, whatever their yaw",
    "NCC own": "mean correlation (eq. 4) of target frames with the template of their own yaw bin",
    "NCC other": "mean correlation of the other object's frames with the best of the target's templates",
    "largest": "the largest of those",
    "IoU": "intersection over union of the 128 × 128 crop's labels, all frames together, mean of highlight and shadow",
    "PSNR": "of the map on that crop against the true map [dB], mean over frames",
    "PSNR gain": "that, less the PSNR of the raw crop [dB]",
}
YAW_COLUMNS = {
    "yaw median": "refined yaw error of target frames [°]; of truth, tiles and discriminative on the map alone",
    "yaw 95 %": "its 95th percentile [°]",
}


@dataclass(frozen=True)
class Settings:
    """What is evaluated; every field is an option of the command line."""

    seed: int = 0
    """Root seed of the frames."""
    step_deg: int = 10
    """Yaw step of each set [deg]; 10 gives the 288 frames of §4.1."""
    segmenters: str = ",".join(available())
    """Segmenters to compare, separated by commas; `truth` is the true map, what no segmenter can pass."""
    sets: str = ",".join(SETS)
    """Sets of frames, separated by commas."""
    out: str = "runs/evaluate_segmenters"
    """Folder of the results."""
    smoke: bool = False
    """A run of seconds: yaw steps of 90°, one set, two segmenters."""


class Judged(NamedTuple):
    """One frame and what was made of it."""

    frame: TestFrame
    result: sj.Recognition
    counts: np.ndarray
    """Pixels of the crop (truth, predicted)."""
    psnr_db: tuple[float, float]
    """PSNR of the crop before and after segmentation [dB]."""


def mirrored(mesh: sj.Mesh) -> sj.Mesh:
    """The mirror image of a mesh: the hardest other object."""
    return sj.Mesh.from_arrays(np.asarray(mesh.vertices) * (1.0, -1.0, 1.0), np.asarray(mesh.faces)[:, ::-1], "mirror")


def frames_of(name: str, settings: Settings) -> list[TestFrame]:
    """The frames of one set."""
    options = dict(SETS[name])
    other = mirrored(sj.objects.target()) if options.pop("mirror", False) else None
    return paper_frames(settings.seed, step_deg=settings.step_deg, other=other, **options)


def judge(frame: TestFrame, name: str, refine: bool) -> Judged:
    """Segment, recognize and compare with the truth."""
    semantic, limit = map_of(name, frame), threshold_of(name)
    refine = refine and frame.is_target  # yaw is judged on the target alone
    # `recognize` knows its own segmenters only; what others make is matched as a frame that needs none.
    image, segmenter = (frame.image, name) if refine and name in SEGMENTERS else (semantic, "none")
    result = sj.recognize(
        image, _target(), sonar_for(frame.tilt_deg), segmenter=segmenter, threshold=limit, refine=refine
    )
    counts, *decibels = _compare(*(jnp.asarray(v) for v in (semantic, frame.image, frame.clean)), _crop(frame.clean))
    return Judged(frame, result, np.asarray(counts), (float(decibels[0]), float(decibels[1])))


_TARGET: list[sj.Mesh] = []


def _target() -> sj.Mesh:
    """One mesh for all frames, whose banks `recognize` keeps."""
    if not _TARGET:
        _TARGET.append(sj.objects.target())
    return _TARGET[0]


def _crop(clean: np.ndarray) -> Box:
    """The crop of a frame: object and shadow with the mean margins of training's crops."""
    spans = []
    for axis, size in enumerate(clean.shape):
        touched = np.flatnonzero((np.abs(clean - 0.5) > 0.25).any(axis=1 - axis))
        margin = np.mean(MARGIN) * (touched[-1] + 1 - touched[0]) + np.mean(MARGIN_OF_FRAME) * size
        first, last = max(touched[0] - margin, 0.0), min(touched[-1] + 1 + margin, size)
        spans.append((jnp.float32(first), jnp.float32(last - first)))
    (top, rows), (left, columns) = spans
    return Box(top, left, rows, columns)


@jax.jit
def _compare(semantic: jax.Array, image: jax.Array, clean: jax.Array, box: Box) -> tuple[jax.Array, ...]:
    """Pixels (truth, predicted) of the labels on the crop, and its PSNR before and after segmentation."""
    made, raw, true = (cut_box(layer, box) for layer in (semantic, image, clean))
    counts = confusion(from_grey(made), from_grey(true))
    return counts, psnr(raw, true), psnr(made, true)


def row(name: str, judged: list[Judged], refined: bool) -> dict[str, Any]:
    """The metrics of one segmenter on one set, as `COLUMNS` defines them."""
    is_target = np.array([j.frame.is_target for j in judged])
    score = np.array([j.result.score_bank for j in judged])
    right = np.array([_error_deg(j.result.yaw_bin, j.frame.yaw) <= 5.5 for j in judged])  # both bins at a tie
    shares = np.asarray(iou(jnp.asarray(sum(j.counts for j in judged))))
    raw, made = np.mean([j.psnr_db for j in judged], axis=0)
    limit = threshold_of(name)
    metrics: dict[str, Any] = {
        "segmenter": name,
        "threshold": limit,
        "accuracy": _accuracy(score, right, is_target, limit),
        "best accuracy": max(_accuracy(score, right, is_target, cut) for cut in (*score, 2.0)),
        "identified": float((score[is_target] >= limit).mean()),
        "refused": float((score[~is_target] < limit).mean()),
        "bin": float(right[is_target].mean()),
        "identification": float(((score >= limit) == is_target).mean()),
        "NCC own": float(np.mean([_own_score(j) for j in judged if j.frame.is_target])),
        "NCC other": float(score[~is_target].mean()),
        "largest": float(score[~is_target].max()),
        "IoU": float(shares[1:].mean()),
        "IoU highlight": float(shares[1]),
        "IoU shadow": float(shares[2]),
        "PSNR": float(made),
        "PSNR gain": float(made - raw),
    }
    if refined:
        errors = np.array([_error_deg(j.result.yaw, j.frame.yaw) for j in judged if j.frame.is_target])
        metrics |= {"yaw median": float(np.median(errors)), "yaw 95 %": float(np.percentile(errors, 95))}
    return metrics


def _accuracy(score: np.ndarray, right: np.ndarray, is_target: np.ndarray, limit: float) -> float:
    said = score >= limit
    return float(np.where(is_target, said & right, ~said).mean())


def _own_score(judged: Judged) -> float:
    scores = judged.result.scores_by_yaw
    return float(scores[round(judged.frame.yaw * len(scores) / (2 * np.pi)) % len(scores)])


def _error_deg(found: float, true: float) -> float:
    """Absolute circular difference [deg] of two yaws [rad]."""
    return float(np.degrees(abs((found - true + np.pi) % (2 * np.pi) - np.pi)))


def run(settings: Settings) -> dict[str, Any]:
    """Rows by set of frames."""
    if settings.smoke:
        settings = replace(settings, step_deg=90, sets="severity 1", segmenters="pix2pix,otsu")
    sets: dict[str, list[dict[str, Any]]] = {}
    for title in settings.sets.split(","):
        frames, refined = frames_of(title, settings), title == REFINED
        sets[title] = []
        for name in settings.segmenters.split(","):
            judged = [judge(frame, name, refined) for frame in tqdm(frames, desc=f"{title}, {name}", unit="frame")]
            sets[title].append(row(name, judged, refined))
    report = {"settings": dataclasses.asdict(settings), "versions": {"jax": jax.__version__}, "sets": sets}
    folder = Path(settings.out)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "results.json", json.dumps(report, indent=1))
    return report


def table(report: dict[str, Any]) -> str:
    """The rows as tables for the terminal and for README, and what the columns mean."""
    lines = []
    for title, rows in report["sets"].items():
        columns = [*COLUMNS, *(YAW_COLUMNS if title == REFINED else {})]
        lines += [f"\n{title}", "| segmenter | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
        for values in rows:
            cells = [f"{values[c]:.2f}" if "PSNR" in c else f"{values[c]:.3f}" for c in columns]
            lines.append(f"| {values['segmenter']} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", *(f"{name}: {what}" for name, what in (COLUMNS | YAW_COLUMNS).items())])


if __name__ == "__main__":
    print(table(run(parse(Settings, __doc__))))
