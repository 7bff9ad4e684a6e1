"""How well is the yaw of a real object found? The 110 turntable frames of a pipe seen by an ARIS Explorer 3000.

python -m experiments.real_turntable [--preset smoke] [--frames 10] [--help]

The yaw error of every method next to what a plain method reaches; leaves contact sheets. The data are not part of the
project: --data names their folder, the README beside them says what they are.

What is taken from that README and not from the truth: where the platform is, that the object lies on it (the mesh
holds its height), that beside it is open water (masked), and that a facet gives highlight only where
cos(incidence) > 0.5. The pipe looks the same after half a turn, so an error is taken modulo 180°; the truth's zero is
arbitrary, so one constant, the circular median of the differences, is taken out before.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from skimage.filters import median as median_filter
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns, formatted, percentile_gap, yaw_error_deg
from experiments.common.runs import Job
from experiments.common.segmenters import loaded
from experiments.common.sheets import COLUMNS, Panel, draw_sheet
from sonarjax.match import between_bins
from sonarjax.match.ncc import correlation_maps, prepare_bank
from sonarjax.recognize import refine_on_frame
from sonarjax.refine import MAP_REFINEMENT
from sonarjax.render.bank import bank_place
from sonarjax.render.region import floor_point

MARGINS = {"tight crop": (2, 1), "fixed window": (40, 8)}
"""(bins, beams) around the union of all views of a bank."""
BASELINES = {
    "none": {"tight crop": (2.3, 6.2), "fixed window": (1.8, 4.8)},
    "otsu": {"tight crop": (2.4, 6.9), "fixed window": (1.7, 4.8)},
}
"""Median and 90th percentile [deg] of the plain method in the data's README."""
AIM = {"segmenter": "aim", "median_deg": 1.7, "p90_deg": 4.5}
Segmenter = Literal["none", "otsu", "pix2pix"]
Search = Literal["recognize", "tight crop", "fixed window"]
HEADS = {
    "segmenter": "segmenter",
    "search": "search",
    "yaw": "yaw",
    "median_deg": "median [°]",
    "p90_deg": "90 % [°]",
    "offset_deg": "offset [°]",
    "off_platform": "off place",
    "two_hypotheses": "both halves",
    "frames_per_second": "frames/s",
}

SUMMARY = {
    "segmenter": "segmenter",
    "search": "search",
    "median_deg": "refined, median [°]",
    "p90_deg": "90 % [°]",
    "plain": "plain method [°]",
    "p50": "median of pix2pix less this one's [°]",
    "p90": "90 % of pix2pix less this one's [°]",
}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    data: str = ""
    """Folder with sonar.toml, pipe.stl, truth.csv and frames/; empty for `pipe` in that of SONARJAX_REAL_DATA."""
    frames: int = 0
    """Number of frames, evenly spread over the turn; 0 for all."""
    incidence: float = 60.0
    """Facets struck at a larger angle from their normal give no highlight [deg]."""
    median: int = 3
    """Width of the median filter before matching without a segmenter [pixels]; 1 for none."""
    platform_x: float = 1.784
    """Forward position of the platform's centre [m]."""
    platform_y: float = 0.039
    """Position to port of the platform's centre [m]."""
    mask_radius: float = 0.2
    """Floor farther from the platform's centre is masked [m]; 0 for the file's mask."""
    step: float = 5.0
    """Yaw step of the banks at the platform's centre [deg]; must divide 180."""
    reach: float = 0.08
    """Largest distance of the object from the platform's centre [m]: a 0.24 m pipe on 0.4 m."""
    segmenters: tuple[Segmenter, ...] = get_args(Segmenter)
    """Segmenters to run."""
    searches: tuple[Search, ...] = get_args(Search)
    """Searches to run."""
    refine: bool = True
    """Refine the yaw, most of the time on a CPU."""
    sheet: int = 40
    """Frames on the contact sheet, evenly spread; 0 for none."""

    def __post_init__(self) -> None:
        """Raises ValueError for values that cannot be used."""
        if not self.step > 0 or abs(180 / self.step - round(180 / self.step)) > 1e-9:
            raise ValueError(f"--step must divide 180, got {self.step}")
        if self.median < 1 or self.median % 2 == 0:
            raise ValueError(f"--median must be an odd number of pixels, got {self.median}")


@dataclass(frozen=True)
class Data:
    """The frames and what belongs to them."""

    names: list[str]
    """File name of each frame, without its ending."""
    images: np.ndarray
    """Raw frames (frame, range, beam), 0 to 1."""
    masks: np.ndarray
    """True (frame, range, beam) where a pixel was measured and used."""
    truth: np.ndarray
    """Pseudo-yaw (frame,) modulo π [rad], its zero arbitrary."""
    sonar: sj.Sonar
    """The fitted sonar."""
    mesh: sj.Mesh
    """The pipe, at its height above the floor."""


@dataclass
class Found:
    """What one segmenter and one search made of every frame."""

    segmenter: str
    """What made the map."""
    search: str
    """`recognize`, or which bank at the known place."""
    yaws: dict[str, list[float]]
    """Yaw [rad] of each frame, for each way to read it: bin, parabola, refined."""
    poses: list[sj.Pose]
    """Where the target was found, for the contact sheet."""
    seconds: list[float]
    """Time of each frame [s]; the first frames compile and render the banks."""
    partner: list[bool]
    """Whether the half-turned yaw was among the hypotheses."""


def load(settings: Settings) -> Data:
    """Frames, masks, truth, sonar and mesh. Raises Skipped naming what is missing."""
    folder = Path(settings.data or Path(os.environ.get("SONARJAX_REAL_DATA", "")) / "pipe")
    for needed in ("sonar.toml", "pipe.stl", "truth.csv", "frames"):
        if not (folder / needed).exists():
            raise Skipped(f"{folder / needed} is missing: --data or SONARJAX_REAL_DATA must name the real frames")
    with open(folder / "truth.csv", newline="") as file:
        rows = [(row["frame"], math.radians(float(row["pseudo_yaw_deg"]))) for row in csv.DictReader(file)]
    if settings.frames > 0:
        rows = [rows[k] for k in _spread_over(len(rows), settings.frames)]
    images, masks = [], []
    for name, _ in rows:
        with np.load(folder / "frames" / f"{name}.npz") as frame:
            images.append(frame["image"].astype(np.float32))
            masks.append(frame["mask"].astype(bool))
    sonar = sj.Sonar.from_toml(folder / "sonar.toml").replace(highlight_max_incidence=settings.incidence)
    used = np.stack(masks) & _on_platform(sonar, settings)
    truth = np.array([yaw for _, yaw in rows])
    return Data([name for name, _ in rows], np.stack(images), used, truth, sonar, sj.Mesh.load(folder / "pipe.stl"))


def _on_platform(sonar: sj.Sonar, settings: Settings) -> np.ndarray:
    """Pixels (range, beam) whose floor is on the platform however it is turned."""
    if settings.mask_radius <= 0:
        return np.ones(sonar.shape, bool)
    edges = np.asarray(sonar.range_edges)
    slant = (edges[1:] + edges[:-1])[:, None] / 2
    x, y = floor_point(slant, np.asarray(sonar.azimuth)[None, :], sonar)
    return np.hypot(np.asarray(x) - settings.platform_x, np.asarray(y) - settings.platform_y) <= settings.mask_radius


def matched_image(image: np.ndarray, mask: np.ndarray, segmenter: str, width: int) -> np.ndarray:
    """The grey image (range, beam) that is matched: the median of the raw frame, or its segmentation."""
    if segmenter != "none":
        return loaded(segmenter).semantic(image, mask, engine())
    smooth = median_filter(image, np.ones((width, width))) if width > 1 else image
    return np.where(mask, smooth, 0.5).astype(np.float32)


def by_recognize(data: Data, settings: Settings, segmenter: str) -> Found:
    """`recognize` as a user calls it: neither distance nor bearing is given. `none` gets the median of the frame."""
    yaws: dict[str, list[float]] = {"bin": [], "bin, parabola": []} | ({"refined": []} if settings.refine else {})
    found = Found(segmenter, "recognize", yaws, [], [], [])
    refine = MAP_REFINEMENT if settings.refine else None
    recognizer = sj.Recognizer(data.mesh, data.sonar, segmenter=loaded(segmenter), refine=refine, engine=engine())
    for image, mask in tqdm(list(zip(data.images, data.masks, strict=True)), desc=f"recognize, {segmenter}"):
        start = time.perf_counter()
        if segmenter == "none":  # otsu has its own median, the network needs none
            image = matched_image(image, mask, segmenter, settings.median)
        result = recognizer(image, mask, threshold=-1.0)
        found.seconds.append(time.perf_counter() - start)
        best = int(np.argmax(result.scores_by_yaw))
        step = 2 * math.pi / len(result.scores_by_yaw)
        yaws["bin"].append(result.yaw_bin)
        yaws["bin, parabola"].append(result.yaw_bin + step * between_bins(result.scores_by_yaw, best))
        if settings.refine:
            yaws["refined"].append(result.yaw)
        found.poses.append(sj.Pose(result.x, result.y, result.yaw))
        others = [h.yaw for h in result.hypotheses[1:]]
        halves = yaw_error_deg(others, result.yaw, 180.0) < 15
        found.partner.append(bool((halves & (yaw_error_deg(others, result.yaw) > 90)).any()))
    return found


def at_known_place(data: Data, settings: Settings, segmenter: str, search: str) -> Found:
    """One bank at the platform's centre, matched at all positions, then refined from where it matched best."""
    yaws: dict[str, list[float]] = {"bin": [], "bin, parabola": []}
    if settings.refine:
        yaws |= {"refined, map alone": [], "refined": []}
    found = Found(segmenter, search, yaws, [], [], [])
    half = round(180 / settings.step)
    angles = np.arange(2 * half) * (math.pi / half)
    place = {"x": settings.platform_x, "y": settings.platform_y}
    how: dict[str, Any] = {"margin": MARGINS[search], "size": sj.WindowSize(data.sonar.shape), "engine": engine()}
    bank = sj.template_bank(data.mesh, data.sonar, angles, **place, **how)
    prepared = prepare_bank(bank, data.sonar.shape, masked=True)
    height, width = bank.templates.shape[1:]
    rows, columns = (np.arange(n - m + 1) for n, m in zip(data.sonar.shape, (height, width), strict=True))
    top, left = np.asarray(bank.offset)
    places = _moved(data.sonar, bank, rows[:, None] - top, columns[None, :] - left)
    allowed = np.hypot(places[0] - settings.platform_x, places[1] - settings.platform_y) <= settings.reach
    for image, mask in tqdm(list(zip(data.images, data.masks, strict=True)), desc=f"{search}, {segmenter}"):
        start = time.perf_counter()
        grey = matched_image(image, mask, segmenter, settings.median)
        maps = np.where(allowed, np.asarray(correlation_maps(grey, prepared, mask)), -np.inf)
        flat = maps.reshape(len(maps), -1)
        scores = flat.max(1).reshape(2, half).mean(0)  # the two half turns show the same pipe
        best = int(scores.argmax())
        yaw = angles[best] + math.pi / half * between_bins(scores, best)
        # The template moved by whole pixels is where refining starts.
        row, column = np.unravel_index(int(flat[best].argmax()), maps.shape[1:])
        x, y = float(places[0][row, column]), float(places[1][row, column])
        pose = sj.Pose(x, y, yaw)
        if settings.refine:
            how = {"config": MAP_REFINEMENT, "engine": engine()}
            on_map = sj.refine_yaw(grey, data.mesh, data.sonar, pose, mask=mask, **how).pose
            frame = grey if segmenter == "none" else np.where(mask, image, 0.5).astype(np.float32)
            pose = refine_on_frame(frame, data.mesh, data.sonar, on_map, mask, **how).pose
            yaws["refined, map alone"].append(float(on_map.yaw))
            yaws["refined"].append(float(pose.yaw))
        found.seconds.append(time.perf_counter() - start)
        yaws["bin"].append(float(angles[best]))
        yaws["bin, parabola"].append(yaw)
        found.poses.append(pose)
        found.partner.append(True)  # by construction: the curve is folded to half a turn
    return found


def _moved(sonar: sj.Sonar, bank: sj.TemplateBank, rows: np.ndarray, columns: np.ndarray) -> tuple[Any, Any]:
    """Floor positions (row, column) [m] of a bank's object moved by `rows` and `columns` pixels."""
    centers = np.asarray(sonar.azimuth, np.float64)
    slant, azimuth = bank_place(bank, sonar)
    beam = np.interp(azimuth, centers, np.arange(len(centers))) + columns
    moved = np.interp(beam, np.arange(len(centers)), centers)
    x, y = floor_point(slant + rows * float(sonar.range_bin), moved, sonar)
    return np.asarray(x), np.asarray(y)


def _half_turn(angle: Any) -> Any:
    return (np.asarray(angle) + math.pi / 2) % math.pi - math.pi / 2


def errors_deg(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, float]:
    """Error of each frame modulo 180° [deg] after one constant offset [deg], the circular median of the differences."""
    gaps = np.degrees(_half_turn(found - truth))
    wrapped = (gaps[:, None] - gaps[None, :] + 90) % 180 - 90
    around = gaps[int(np.abs(wrapped).sum(0).argmin())]
    offset = around + float(np.median((gaps - around + 90) % 180 - 90))
    return (gaps - offset + 90) % 180 - 90, float((offset + 90) % 180 - 90)


def run(settings: Settings, job: Job) -> Report:
    """A row for each segmenter, search and reading of the yaw; what was found in each frame; contact sheets."""
    data = load(settings)
    cases = {f"{search}, {name}": (name, search) for name in settings.segmenters for search in settings.searches}
    found = job.map(partial(_measure, data, settings, job.folder), cases, "segmenters")
    per_frame = {key: value for part in found.values() for key, value in part["per_frame"].items()}
    sheets = [part["sheet"] for part in found.values() if part.get("sheet")]
    if settings.sheet > 0 and "pix2pix" in settings.segmenters:
        sheets.append(_draw_maps(job.folder / "maps_pix2pix.png", data, settings))
    return {
        "frames": len(data.names),
        "rows": [row for part in found.values() for row in part["rows"]],
        "failures": [f"{name}: {part['failure']}" for name, part in found.items() if part["failure"]],
        "compared": compared(per_frame, settings, job.seed),
        "per_frame": {"frame": data.names, "truth_deg": np.degrees(data.truth), **per_frame},
        "sheets": sheets,
    }


def _measure(data: Data, settings: Settings, folder: Path, case: tuple[str, str]) -> dict[str, Any]:
    """Rows and frames of one segmenter and search, and its contact sheet; or why there are none."""
    segmenter, search = case
    try:
        if search == "recognize":
            found = by_recognize(data, settings, segmenter)
        else:
            found = at_known_place(data, settings, segmenter, search)
    except sj.SonarjaxError as error:
        return {"rows": [], "per_frame": {}, "failure": str(error)}
    part = _rows(found, data.truth, settings) | {"failure": None}
    if settings.sheet > 0 and search in ("recognize", "fixed window"):
        path = folder / f"sheet_{search.replace(' ', '_')}_{segmenter}.png"
        part["sheet"] = _draw_found(path, data, settings, found)
    return part


def _rows(found: Found, truth: np.ndarray, settings: Settings) -> dict[str, Any]:
    """A row for each reading of the yaw, and what each of them says of each frame."""
    warm = found.seconds[min(5, len(found.seconds) // 2) :]
    places = np.array([[float(pose.x), float(pose.y)] for pose in found.poses])
    off = np.hypot(*(places - [settings.platform_x, settings.platform_y]).T) > settings.reach + 1e-3
    rows, frames = [], {}
    for reading, yaws in found.yaws.items():
        error, offset = errors_deg(np.array(yaws), truth)
        rows.append(
            {
                "segmenter": found.segmenter,
                "search": found.search,
                "yaw": reading,
                "median_deg": float(np.median(np.abs(error))),
                "p90_deg": float(np.percentile(np.abs(error), 90)),
                "offset_deg": offset,
                "off_platform": float(off.mean()),
                "two_hypotheses": float(np.mean(found.partner)),
                "frames_per_second": 1.0 / float(np.median(warm)),
                "seconds_in_all": float(np.sum(found.seconds)),
            }
        )
        frames[f"{found.segmenter}, {found.search}, {reading}"] = {
            "hypotheses_deg": [[math.degrees(y) % 180, math.degrees(y) % 180 + 180] for y in yaws],
            "error_deg": error,
            "place_m": places,
        }
    return {"rows": rows, "per_frame": frames}


def compared(per_frame: dict[str, Any], settings: Settings, seed: int) -> list[dict[str, Any]]:
    """How much more pix2pix's refined yaw errs than each baseline's (less than 0 is better), see `percentile_gap`."""
    rows = []
    for search, other in itertools.product(settings.searches, settings.segmenters):
        names = f"pix2pix, {search}, refined", f"{other}, {search}, refined"
        if other != "pix2pix" and all(name in per_frame for name in names):
            pair = [np.abs(per_frame[name]["error_deg"]) for name in names]
            gaps = {f"p{k}": percentile_gap(*pair, k, seed) for k in (50, 90)}
            rows.append({"search": search, "other": other} | gaps)
    return rows


def summary(report: Report) -> str:
    """One row for each segmenter and search, for README: the refined yaw, what it is compared with, and by how much."""
    less = {(row["search"], row["other"]): row for row in report["compared"]}
    rows = []
    for row in (row for row in report["rows"] if row["yaw"] == "refined"):
        segmenter, search = row["segmenter"], row["search"]
        plain = BASELINES.get(segmenter, {}).get(search)
        shown = row | {"plain": plain and "{:.1f} / {:.1f}".format(*plain)}
        for name in ("p50", "p90") if (search, segmenter) in less else ():
            shown[name] = "{} ({} to {})".format(*(formatted(v, "+.2f") for v in less[search, segmenter][name]))
        rows.append(shown)
    return columns(rows, SUMMARY)


def table(report: Report) -> str:
    """A row for each segmenter, search and reading of the yaw, then the summary."""
    return "\n".join(
        [
            f"{report['frames']} frames; error of yaw modulo 180° after one constant offset",
            "",
            columns([*report["rows"], AIM], HEADS),
            "",
            "off place: frames whose target was found farther from the platform's centre than --reach. both halves:",
            "frames whose half-turned yaw is a hypothesis too (a bank at the known place is folded to half a turn, so",
            "always). frames/s: refinement included where there is one, compilation not. refined: as `recognize` does,",
            "on the map first and then on the frame. none: the frame after a median filter of --median pixels.",
            "",
            "pix2pix's refined error less the others', and in brackets the middle 95 % of a bootstrap over frames (the",
            "truth is good to 1-2 degrees). Plain method: median / 90 % in the data's README.",
            "",
            summary(report),
            "",
            *(f"failed: {line}" for line in report["failures"]),
            *(f"picture: {path}" for path in report["sheets"]),
        ]
    )


def _panel(data: Data, k: int, title: str = "", template: np.ndarray | None = None) -> Panel:
    image = data.images[k]
    return Panel(image, float(np.percentile(image[data.masks[k]], 99.5)), f"{data.names[k]}{title}", template)


def _draw_found(path: Path, data: Data, settings: Settings, found: Found) -> Path:
    """Contact sheet: raw frames, the matched template's outline over them, the error above."""
    reading = list(found.yaws)[-1]
    error, _ = errors_deg(np.array(found.yaws[reading]), data.truth)
    panels = [
        _panel(data, k, f"  {error[k]:+.1f}°", np.asarray(sj.render(data.mesh, found.poses[k], data.sonar).semantic()))
        for k in _spread_over(len(data.names), settings.sheet)
    ]
    title = "matched template's highlight (orange), shadow (blue, dashed)"
    about = f"{found.search}, segmenter {found.segmenter}: {title}; error of the yaw ({reading})"
    return draw_sheet(path, panels, data.sonar, about)


def _draw_maps(path: Path, data: Data, settings: Settings) -> Path:
    """Contact sheet: raw frames, and under each what the network makes of it."""
    chosen = _spread_over(len(data.names), min(settings.sheet, 2 * COLUMNS))
    panels: list[Panel | None] = []
    network = loaded("pix2pix")
    for first in range(0, len(chosen), COLUMNS):
        line = chosen[first : first + COLUMNS]
        empty = [None] * (min(COLUMNS, len(chosen)) - len(line))
        maps = [Panel(network.semantic(data.images[k], data.masks[k], engine()), 1.0) for k in line]
        panels += [*(_panel(data, k) for k in line), *empty, *maps, *empty]
    about = "real frames, and under each the map that pix2pix makes of it: highlight white, shadow black"
    return draw_sheet(path, panels, data.sonar, about)


def _spread_over(count: int, most: int) -> list[int]:
    """Numbers of `most` frames of `count`, or of all if there are fewer, evenly spread."""
    return [round(k) for k in np.linspace(0, count - 1, min(most, count))]


if __name__ == "__main__":
    small = {"frames": 2, "segmenters": ("none",), "searches": ("recognize",), "sheet": 2}
    launch(run, Settings, table, smoke=small)
