"""All speed benchmarks and one table of what was asked of each: `make bench`.

python -m experiments.bench_all [--smoke]: runs bench_render, bench_match, bench_refine and bench_train, prints their
tables, then measured numbers beside floor and aim. Ratios above 1 say that ours is faster than the peer.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

from experiments import bench_match, bench_refine, bench_render, bench_train
from experiments.bench_render import parse


@dataclass(frozen=True)
class Settings:
    """What is run; every field is a command line option."""

    smoke: bool = False
    """Each benchmark's run of seconds."""


@dataclass(frozen=True)
class Bar:
    """One number beside what was asked of it."""

    name: str
    value: float
    unit: str
    floor: float
    """What it has to reach."""
    aim: float
    """What would be better; NaN where there is none."""
    higher: bool
    """True when larger is better."""

    def verdict(self) -> str:
        """`aim`, `floor` or `MISSED`; `not measured` without a number."""
        if math.isnan(self.value):
            return "not measured"

        def reaches(limit: float) -> bool:
            return self.value >= limit if self.higher else self.value <= limit

        if not math.isnan(self.aim) and reaches(self.aim):
            return "aim"
        return "floor" if reaches(self.floor) else "MISSED"


def bars(render: dict[str, Any], match: dict[str, Any], refine: dict[str, Any], train: dict[str, Any]) -> list[Bar]:
    """The issues' floors and aims, in their order."""
    none = math.nan
    embree = [v for name, v in render["bank"]["ratio"].items() if name in bench_peers()]
    big = render["big"]["ratio"].get("Embree, rays turned", none)
    steepest = render["growth"]["sonarjax"].get("steepest", none)
    found = [
        Bar("bank of 36 views: Embree's fastest / ours", min(embree, default=none), "x", 1.0, 3.0, True),
        Bar("40,000 triangles: ours / Embree", 1 / big, "x", 10.0, 3.0, False),
        Bar("cost ~ triangles^p, steepest step", steepest, "", 1.0, none, False),
    ]
    for count, floor in ((36, 2.0), (360, 3.0)):
        found.append(Bar(f"{count} templates: OpenCV / ours", _ratio(match, count, "OpenCV"), "x", floor, 6.0, True))
        found.append(Bar(f"{count} templates: skimage / ours", _ratio(match, count, "scikit"), "x", 20.0, none, True))
    one, batch = refine["rows"][0], refine["rows"][-1]
    return [
        *found,
        Bar(one["name"], 1e3 * one["seconds"], "ms", 250.0, 50.0, False),
        Bar(f"{batch['name']}, a frame", 1e3 * batch["seconds"], "ms", 80.0, 20.0, False),
        Bar("value + gradient / forward render", refine["gradient_ratio"], "x", 5.0, 3.0, False),
        Bar("recognize without refinement", refine["recognize_rate"], "/s", 21.0, none, True),
        *_train_bars(train),
    ]


def _train_bars(train: dict[str, Any]) -> list[Bar]:
    """pix2pix: images/s over PyTorch's, a patch of the shipped width, and pairs made for each that is trained on."""
    found, rows = [], train["rows"]
    for row in rows:
        if row["work"] != "one patch":
            name = f"{row['work']}, width {row['width']}: ours / PyTorch"
            found.append(Bar(name, bench_train.ratio(row), "x", 1.0, 1.5, True))
    thinnest = {row["work"]: row for row in rows if row["width"] == rows[0]["width"]}
    patch, trained = thinnest["one patch"]["seconds"]["ours"], thinnest["training"]["images"]["ours"]
    return [
        *found,
        Bar(f"one patch, width {rows[0]['width']}", 1e3 * patch, "ms", 5.0, math.nan, False),
        Bar("pairs made / trained on", train["pairs"] / trained, "x", 1.0, math.nan, True),
    ]


def bench_peers() -> tuple[str, ...]:
    """The two ways of giving Embree the frame's rays; the faster one counts."""
    return "Embree, rays turned", "Embree, scene rebuilt"


def _ratio(match: dict[str, Any], count: int, name: str) -> float:
    return next((r["ratio"] for r in match["rows"] if r["templates"] == count and name in r["name"]), math.nan)


def run(settings: Settings) -> dict[str, Any]:
    """The four reports, and the bars made of them; the machine's load before and after."""
    load = os.getloadavg()[0]
    parts = {
        "render": bench_render.run(bench_render.Settings(smoke=settings.smoke)),
        "match": bench_match.run(bench_match.Settings(smoke=settings.smoke)),
        "refine": bench_refine.run(bench_refine.Settings(smoke=settings.smoke)),
        "train": bench_train.run(bench_train.Settings(smoke=settings.smoke)),
    }
    return {**parts, "bars": bars(**parts), "load": (load, os.getloadavg()[0]), "cores": os.cpu_count()}


def table(report: dict[str, Any]) -> str:
    """The four tables and the bars as text."""
    before, after = report["load"]
    lines = [
        bench_render.table(report["render"]), "", bench_match.table(report["match"]), "",
        bench_refine.table(report["refine"]), "", bench_train.table(report["train"]), "",
        f"{'bar':<44} {'measured':>10}    {'floor':>7} {'aim':>6}  reached   "
        f"(load {before:.1f} to {after:.1f} on {report['cores']} cores)",
    ]  # fmt: skip
    for bar in report["bars"]:
        sign = ">=" if bar.higher else "<="
        aim = "" if math.isnan(bar.aim) else f"{bar.aim:g}"
        lines.append(f"{bar.name:<44} {bar.value:>10.2f} {bar.unit:<2} {sign}{bar.floor:>5g} {aim:>6}  {bar.verdict()}")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table(run(parse(Settings, __doc__))))
