"""How fast is everything, beside its peers and beside what was asked of it? All benchmarks and one table of both.

python -m experiments.bench_all [--preset smoke] [--help], or `make bench`

Runs bench_render, bench_match, bench_refine and bench_train, prints their tables, then measured numbers beside floor
and aim. Ratios above 1 say that ours is faster than the peer. A peer that is not installed is left out with its rows.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

from experiments import bench_match, bench_refine, bench_render, bench_train
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job

Benchmark = Literal["render", "match", "refine", "train"]
PARTS: dict[str, ModuleType] = {
    "render": bench_render,
    "match": bench_match,
    "refine": bench_refine,
    "train": bench_train,
}
PEERS = {"render": "open3d", "match": "cv2", "train": "torch"}
"""The module that each benchmark's peer is imported from."""
HEADS = {"name": "bar", "value": "measured", "unit": "", "floor": "floor", "aim": "aim", "reached": "reached"}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    benchmarks: tuple[Benchmark, ...] = ("render", "match", "refine", "train")
    """Which benchmarks."""
    brief: bool = False
    """Each benchmark's run of seconds."""


def run(settings: Settings, job: Job) -> Report:
    """The benchmarks' reports, and the bars made of them; the machine's load before and after."""
    load = os.getloadavg()[0]
    reports = {name: _report(name, settings, job) for name in settings.benchmarks}
    found = [bar for name, report in reports.items() for bar in BARS[name](report)]
    return reports | {"bars": found, "load": [load, os.getloadavg()[0]], "cores": os.cpu_count()}


def _report(name: str, settings: Settings, job: Job) -> Report:
    module = PARTS[name]
    chosen = dict(module.SMOKE) if settings.brief else {}
    if name in PEERS:
        chosen["peer"] = bench_match.has(PEERS[name])
    return module.run(module.Settings(**chosen), job)


def bar(
    name: str, value: float | None, unit: str, floor: float, aim: float | None = None, *, higher: bool
) -> dict[str, Any]:
    """One number beside what it has to reach and what would be better; `higher` where larger is better."""
    limits = {"floor": floor, "aim": aim}
    good = [
        limit is not None and value is not None and (value >= limit if higher else value <= limit)
        for limit in limits.values()
    ]
    reached = "not measured" if value is None else "aim" if good[1] else "floor" if good[0] else "MISSED"
    return {"name": name, "value": value, "unit": unit} | limits | {"higher": higher, "reached": reached}


def render_bars(report: Report) -> list[dict[str, Any]]:
    """The renderer beside Embree, in the faster of two ways to give it the frame's rays."""
    embree = [v for name, v in report["bank"]["ratio"].items() if name in (bench_render.TURNED, bench_render.REBUILT)]
    big = report["big"]["ratio"].get(bench_render.TURNED)
    steepest = report["growth"][bench_render.OURS].get("steepest")
    return [
        bar("bank of 36 views: Embree's fastest / ours", min(embree, default=None), "×", 1.0, 3.0, higher=True),
        bar("40,000 triangles: ours / Embree", None if big is None else 1 / big, "×", 10.0, 3.0, higher=False),
        bar("cost ~ triangles^p, steepest step", steepest, "", 1.0, higher=False),
    ]


def match_bars(report: Report) -> list[dict[str, Any]]:
    """Eq. 4 beside OpenCV and scikit-image."""

    def ratio(count: int, name: str) -> float | None:
        rows = (row["ratio"] for row in report["rows"] if row["templates"] == count and name in row["name"])
        return next(rows, None)

    found = []
    for count, floor in ((36, 2.0), (360, 3.0)):
        found.append(bar(f"{count} templates: OpenCV / ours", ratio(count, "OpenCV"), "×", floor, 6.0, higher=True))
        found.append(bar(f"{count} templates: skimage / ours", ratio(count, "scikit"), "×", 20.0, higher=True))
    low_rank, peer = ratio(360, bench_match.LOW_RANK), ratio(360, bench_match.OPENCV)
    faster = None if low_rank is None or peer is None else peer / low_rank
    found.append(bar("360 templates: OpenCV / ours, low rank", faster, "×", 6.0, higher=True))
    return found


def refine_bars(report: Report) -> list[dict[str, Any]]:
    """Refinement of one frame and of a batch, the gradient's cost, recognition."""
    calls = [row for row in report["rows"] if row["name"].startswith("refine_yaw")]
    one, batch = calls[0], calls[-1]
    return [
        bar(one["name"], one["milliseconds"], "ms", 250.0, 50.0, higher=False),
        bar(f"{batch['name']}, a frame", batch["milliseconds"], "ms", 80.0, 20.0, higher=False),
        bar("value + gradient / forward render", report["gradient_ratio"], "×", 5.0, 3.0, higher=False),
        bar("recognize without refinement", report["recognize_rate"], "/s", 21.0, higher=True),
    ]


def train_bars(report: Report) -> list[dict[str, Any]]:
    """pix2pix: images/s over PyTorch's, a patch of the shipped width, and pairs made for each that is trained on."""
    rows = report["rows"]
    thinnest = {row["work"]: row for row in rows if row["width"] == rows[0]["width"]}
    patch, trained = thinnest["one patch"]["seconds"]["ours"], thinnest["training"]["images"]["ours"]
    pairs = None if report["pairs"] is None else report["pairs"] / trained
    return [
        *(
            bar(f"{row['work']}, width {row['width']}: ours / PyTorch", row["ratio"], "×", 1.0, 1.5, higher=True)
            for row in rows
            if row["work"] != "one patch"
        ),
        bar(f"one patch, width {rows[0]['width']}", 1e3 * patch, "ms", 5.0, higher=False),
        bar("pairs made / trained on", pairs, "×", 1.0, higher=True),
    ]


BARS = {"render": render_bars, "match": match_bars, "refine": refine_bars, "train": train_bars}


def table(report: Report) -> str:
    """The benchmarks' tables, then the bars."""
    before, after = report["load"]
    shown = [
        one | {key: f"{'≥' if one['higher'] else '≤'} {one[key]:g}" for key in ("floor", "aim") if one[key] is not None}
        for one in report["bars"]
    ]
    return "\n\n".join(
        [
            *(PARTS[name].table(report[name]) for name in PARTS if name in report),
            f"load {before:.1f} to {after:.1f} on {report['cores']} cores",
            columns(shown, HEADS),
        ]
    )


if __name__ == "__main__":
    launch(run, Settings, table, smoke={"benchmarks": ("match",), "brief": True})
