"""Before and after: the numbers of commit f99308b beside those of today, from docs/results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from experiments.common.metrics import columns
from sonarjax.io import SonarjaxError

NAME = "baseline"
COMMIT = "f99308b"
HEADS = {"what": "what", "before": f"commit {COMMIT}", "now": "now"}
COMPARED: dict[str, list[tuple[str, str]]] = {
    "reproduce_paper": [
        ("accuracy, pix2pix", "segmenters.pix2pix.accuracy"),
        ("accuracy, none", "segmenters.none.accuracy"),
        ("accuracy, otsu", "segmenters.otsu.accuracy"),
        ("score of the target, pix2pix", "segmenters.pix2pix.score_target"),
        ("yaw, median, pix2pix [°]", "offset.pix2pix.yaw_median"),
        ("yaw, 95 %, pix2pix [°]", "offset.pix2pix.yaw_p95"),
        ("yaw, median, none [°]", "offset.none.yaw_median"),
        ("yaw, 95 %, none [°]", "offset.none.yaw_p95"),
        ("yaw, median, otsu [°]", "offset.otsu.yaw_median"),
        ("yaw, 95 %, otsu [°]", "offset.otsu.yaw_p95"),
    ],
    "refine_accuracy": [
        ("RMS within 10°, clean labels [°]", "rows.0.rms"),
        ("RMS within 10°, 8 % replaced [°]", "rows.1.rms"),
        ("RMS within 20°, clean labels [°]", "rows.2.rms"),
    ],
    "gradient_check": [
        (
            f"{what} by {by}, {'default quality' if quality == '2' else 'one sub-beam'}",
            f"qualities.{quality}.{key}.0.{k}",
        )
        for quality in ("1", "2")
        for what, key in (("median error", "median"), ("95 % error", "p95"))
        for k, by in enumerate(("yaw", "x", "y"))
    ],
    "real_turntable": [
        (f"yaw, {what}, {who} [°]", f"rows.{row}.{key}")
        for who, row in (("none", 2), ("otsu", 13), ("pix2pix", 24))  # found by `recognize`, and refined
        for what, key in (("median", "median_deg"), ("90 %", "p90_deg"))
    ],
}
"""For each experiment what is compared: a name, and where it stands in the results (seed 0)."""
OF_THE_SAME = {"gradient_check": "gradient_check_of_three"}
"""Results of today on what the old commit was measured on, where the experiment has grown: its first three meshes."""


def table(kept: Path, compared: dict[str, list[tuple[str, str]]] = COMPARED) -> str:
    """A row for each number that is compared. Raises SonarjaxError where results are not kept, or lack one."""
    before = _read(kept / f"baseline_{COMMIT}.json")
    rows = []
    for experiment, numbers in compared.items():
        now = _read(kept / f"{OF_THE_SAME.get(experiment, experiment)}.json")[0]
        for what, place in numbers:
            sides = {side: _at(report, place) for side, report in (("before", before[experiment]), ("now", now))}
            rows.append({"what": f"{experiment}: {what}"} | sides)
    return str(columns(rows, HEADS))


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SonarjaxError(f"{path}: expected results: {error}") from error


def _at(report: Any, place: str) -> float:
    """A number by its place; in a list either by its index or by the name of a segmenter."""
    value = report
    for key in place.split("."):
        if isinstance(value, list):
            found = [one for one in value if isinstance(one, dict) and one.get("segmenter") == key]
            value = found[0] if found else value[int(key)]
        else:
            value = value[key]
    return float(value)
