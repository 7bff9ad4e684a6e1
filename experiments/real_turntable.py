"""Yaw of a real object: `recognize` over the 110 turntable frames of a pipe seen by an ARIS Explorer 3000.

python -m experiments.real_turntable [--frames 10] [--help]

Prints the yaw error of every method next to what a plain method reaches, and writes the table, the settings and a
contact sheet under runs/. The data are not part of the project: see shared/real/README.md beside it.

What is taken from that README and not from the truth: where the platform is, that the object lies on it (the mesh
holds its height), that beside it is open water (masked), and that a facet gives highlight only where
cos(incidence) > 0.5. The pipe looks the same after half a turn, so an error is taken modulo 180°; the truth's zero is
arbitrary, so one constant, the circular median of the differences, is taken out before.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import jax
import numpy as np
from skimage.filters import median as median_filter
from tqdm import tqdm

import sonarjax as sj
from sonarjax.io import write_text
from sonarjax.match import between_bins
from sonarjax.match.ncc import correlation_maps, prepare_bank
from sonarjax.plot import draw_outline, plot_polar, save_figure
from sonarjax.recognize import REFINEMENT
from sonarjax.render.bank import bank_place
from sonarjax.render.region import floor_point
from sonarjax.segment import semantic_map

PROJECT = Path(__file__).resolve().parents[1]
TIGHT_MARGIN, WIDE_MARGIN = (2, 1), (40, 8)  # (bins, beams) around the union of all views of a bank
BASELINES = {
    "none": {"tight crop": (2.3, 6.2), "fixed window": (1.8, 4.8)},
    "otsu": {"tight crop": (2.4, 6.9), "fixed window": (1.7, 4.8)},
}
"""Median and 90th percentile [deg] of the plain method in the data's README."""
AIM = (1.7, 4.5)
SEGMENTERS, SEARCHES = ("none", "otsu", "pix2pix"), ("recognize", "tight crop", "fixed window")


def _option(default: Any, text: str) -> Any:
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class Settings:
    """What is run; every field is a command line option."""

    data: str = _option(str(PROJECT.parent / "shared" / "real" / "pipe"), "folder with sonar.toml, pipe.stl, frames/")
    out: str = _option(str(PROJECT / "runs" / "real_turntable"), "folder that the results are written to")
    frames: int = _option(0, "number of frames, evenly spread over the turn; 0 for all")
    incidence: float = _option(60.0, "facets struck at a larger angle from their normal give no highlight [deg]")
    median: int = _option(3, "width of the median filter before matching without a segmenter [pixels]; 1 for none")
    platform_x: float = _option(1.784, "forward position of the platform's centre [m]")
    platform_y: float = _option(0.039, "position to port of the platform's centre [m]")
    mask_radius: float = _option(0.2, "floor farther from the platform's centre is masked [m]; 0 for the file's mask")
    step: float = _option(5.0, "yaw step of the banks at the platform's centre [deg]; must divide 180")
    reach: float = _option(
        0.08, "largest distance of the object from the platform's centre [m]: a 0.24 m pipe on 0.4 m"
    )
    segmenters: str = _option("none,otsu,pix2pix", "segmenters to run, separated by commas")
    searches: str = _option("recognize,tight crop,fixed window", "searches to run, separated by commas")
    refine: bool = _option(True, "refine the yaw, most of the time on a CPU")
    sheet: int = _option(40, "frames on the contact sheet, evenly spread; 0 for none")


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
    """`none`, `otsu` or `pix2pix`."""
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
    """Frames, masks, truth, sonar and mesh. Raises SonarjaxError naming what is missing."""
    folder = Path(settings.data)
    for needed in ("sonar.toml", "pipe.stl", "truth.csv", "frames"):
        if not (folder / needed).exists():
            raise sj.SonarjaxError(f"{folder / needed}: missing; --data must be the folder of the frames")
    with open(folder / "truth.csv", newline="") as file:
        rows = [(row["frame"], math.radians(float(row["pseudo_yaw_deg"]))) for row in csv.DictReader(file)]
    if 0 < settings.frames < len(rows):
        rows = [rows[round(k)] for k in np.linspace(0, len(rows) - 1, settings.frames)]
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
        return semantic_map(image, segmenter, mask)
    smooth = median_filter(image, np.ones((width, width))) if width > 1 else image
    return np.where(mask, smooth, 0.5).astype(np.float32)


def by_recognize(data: Data, settings: Settings, segmenter: str) -> Found:
    """`recognize` as a user calls it: neither distance nor bearing is given."""
    yaws: dict[str, list[float]] = {"bin": [], "bin, parabola": []} | ({"refined": []} if settings.refine else {})
    found = Found(segmenter, "recognize", yaws, [], [], [])
    for image, mask in tqdm(list(zip(data.images, data.masks, strict=True)), desc=f"recognize, {segmenter}"):
        start = time.perf_counter()
        if segmenter == "none":  # otsu has its own median, the network needs none
            image = matched_image(image, mask, segmenter, settings.median)
        result = sj.recognize(
            image, data.mesh, data.sonar, segmenter=segmenter, mask=mask, refine=settings.refine, threshold=-1.0
        )
        found.seconds.append(time.perf_counter() - start)
        best = int(np.argmax(result.scores_by_yaw))
        step = 2 * math.pi / len(result.scores_by_yaw)
        yaws["bin"].append(result.yaw_bin)
        yaws["bin, parabola"].append(result.yaw_bin + step * between_bins(result.scores_by_yaw, best))
        if settings.refine:
            yaws["refined"].append(result.yaw)
        found.poses.append(sj.Pose(result.x, result.y, result.yaw))
        others = [abs(_half_turn(h.yaw - result.yaw)) for h in result.hypotheses[1:]]
        apart = [abs(_turn(h.yaw - result.yaw)) > math.pi / 2 for h in result.hypotheses[1:]]
        found.partner.append(any(o < math.radians(15) and a for o, a in zip(others, apart, strict=True)))
    return found


def at_known_place(data: Data, settings: Settings, segmenter: str, search: str, margin: tuple[int, int]) -> Found:
    """One bank at the platform's centre, matched at all positions, then refined from where it matched best."""
    yaws: dict[str, list[float]] = {"bin": [], "bin, parabola": []} | ({"refined": []} if settings.refine else {})
    found = Found(segmenter, search, yaws, [], [], [])
    half = round(180 / settings.step)
    angles = np.arange(2 * half) * (math.pi / half)
    place = {"x": settings.platform_x, "y": settings.platform_y}
    bank = sj.template_bank(data.mesh, data.sonar, angles, **place, margin=margin, shape=data.sonar.shape)
    prepared = prepare_bank(bank, data.sonar.shape, masked=True)
    height, width = bank.templates.shape[1:]
    rows, columns = (np.arange(n - m + 1) for n, m in zip(data.sonar.shape, (height, width), strict=True))
    places = _moved(data.sonar, bank, rows[:, None] - bank.offset[0], columns[None, :] - bank.offset[1])
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
            refined = jax.tree.map(
                float, sj.refine_yaw(grey, data.mesh, data.sonar, pose, mask=mask, **REFINEMENT).pose
            )
            pose = sj.Pose(refined.x, refined.y, refined.yaw)
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


def _turn(angle: Any) -> Any:
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


def _half_turn(angle: Any) -> Any:
    return (np.asarray(angle) + math.pi / 2) % math.pi - math.pi / 2


def errors_deg(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, float]:
    """Error of each frame modulo 180° [deg] after one constant offset [deg], the circular median of the differences."""
    gaps = np.degrees(_half_turn(found - truth))
    wrapped = (gaps[:, None] - gaps[None, :] + 90) % 180 - 90
    around = gaps[int(np.abs(wrapped).sum(0).argmin())]
    offset = around + float(np.median((gaps - around + 90) % 180 - 90))
    return (gaps - offset + 90) % 180 - 90, float((offset + 90) % 180 - 90)


def run(settings: Settings) -> dict[str, Any]:
    """Recognize the frames, print nothing, write table.txt, results.json and the contact sheets; return the report."""
    data = load(settings)
    report: dict[str, Any] = {
        "settings": asdict(settings),
        "device": jax.devices()[0].device_kind,
        "frames": len(data.names),
        "rows": [],
        "failures": [],
        "per_frame": {"frame": data.names, "truth_deg": np.degrees(data.truth).tolist()},
    }
    out = Path(settings.out)
    out.mkdir(parents=True, exist_ok=True)
    for segmenter in settings.segmenters.split(","):
        for search, method in _methods(data, settings, segmenter).items():
            try:
                found = method()
            except sj.SonarjaxError as error:
                report["failures"].append(f"{search}, {segmenter}: {error}")
                continue
            _add_rows(report, found, data.truth, settings)
            if settings.sheet > 0 and search in ("recognize", "fixed window"):
                path = out / f"sheet_{search.replace(' ', '_')}_{segmenter}.png"
                _draw_sheet(path, data, settings, found)
                report.setdefault("sheets", []).append(str(path))
    if settings.sheet > 0 and "pix2pix" in settings.segmenters.split(","):
        report["sheets"].append(str(_draw_maps(out / "maps_pix2pix.png", data, settings)))
    write_text(out / "table.txt", table(report) + "\n")
    write_text(out / "results.json", json.dumps(report, indent=1))
    return report


def _methods(data: Data, settings: Settings, segmenter: str) -> dict[str, Callable[[], Found]]:
    def known(search: str, margin: tuple[int, int]) -> Callable[[], Found]:
        return lambda: at_known_place(data, settings, segmenter, search, margin)

    methods = {
        "recognize": lambda: by_recognize(data, settings, segmenter),
        "tight crop": known("tight crop", TIGHT_MARGIN),
        "fixed window": known("fixed window", WIDE_MARGIN),
    }
    return {name: methods[name] for name in settings.searches.split(",")}


def _add_rows(report: dict[str, Any], found: Found, truth: np.ndarray, settings: Settings) -> None:
    warm = found.seconds[min(5, len(found.seconds) // 2) :]
    places = np.array([[float(pose.x), float(pose.y)] for pose in found.poses])
    off = np.hypot(*(places - [settings.platform_x, settings.platform_y]).T) > settings.reach + 1e-3
    for reading, yaws in found.yaws.items():
        error, offset = errors_deg(np.array(yaws), truth)
        report["rows"].append(
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
        key = f"{found.segmenter}, {found.search}, {reading}"
        report["per_frame"][key] = {
            "hypotheses_deg": [[math.degrees(y) % 180, math.degrees(y) % 180 + 180] for y in yaws],
            "error_deg": error.tolist(),
            "place_m": places.tolist(),
        }


def table(report: dict[str, Any]) -> str:
    """The report as text: one line for each segmenter, search and reading of the yaw, then the baselines."""
    lines = [
        f"{report['frames']} frames, error of yaw modulo 180° after one constant offset [deg]   ({report['device']})",
        f"{'segmenter':<10}{'search':<14}{'yaw':<15}{'median':>7}{'90 %':>7}{'offset':>8}{'off place':>10}"
        f"{'both halves':>12}{'frames/s':>10}",
    ]
    for row in report["rows"]:
        lines.append(
            f"{row['segmenter']:<10}{row['search']:<14}{row['yaw']:<15}{row['median_deg']:>7.1f}{row['p90_deg']:>7.1f}"
            f"{row['offset_deg']:>8.1f}{row['off_platform']:>10.0%}"
            f"{row['two_hypotheses']:>12.0%}{row['frames_per_second']:>10.1f}"
        )
    for segmenter, windows in BASELINES.items():
        for window, (middle, high) in windows.items():
            lines.append(f"{segmenter:<10}{window:<14}{'plain method':<15}{middle:>7.1f}{high:>7.1f}   (data's README)")
    lines.append(f"{'aim':<39}{AIM[0]:>7.1f}{AIM[1]:>7.1f}")
    lines.append(
        "off place: frames whose target was found farther from the platform's centre than --reach. both halves:"
    )
    lines.append(
        "frames whose half-turned yaw is a hypothesis too (a bank at the known place is folded to half a turn, so"
    )
    lines.append("always). frames/s: refinement included where there is one, compilation not.")
    lines += [f"failed: {line}" for line in report["failures"]]
    lines += [f"picture: {path}" for path in report.get("sheets", [])]
    return "\n".join(lines)


def _draw_sheet(path: Path, data: Data, settings: Settings, found: Found) -> None:
    """Contact sheet: raw frames in polar view, the matched template's outline over them, the error above."""
    from matplotlib.figure import Figure

    reading = list(found.yaws)[-1]
    error, _ = errors_deg(np.array(found.yaws[reading]), data.truth)
    count = min(settings.sheet, len(data.names))
    chosen = [round(k) for k in np.linspace(0, len(data.names) - 1, count)]
    columns = min(10, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(2.0 * columns, 2.4 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, k in zip(axes, chosen, strict=False):
        image, mask = data.images[k], data.masks[k]
        plot_polar(ax, image, data.sonar, vmin=0, vmax=float(np.percentile(image[mask], 99.5)))
        template = np.asarray(sj.render(data.mesh, found.poses[k], data.sonar).semantic())
        draw_outline(ax, template, data.sonar, linewidth=0.9)
        ax.set_title(f"{data.names[k]}  {error[k]:+.1f}°", fontsize=8)
    figure.suptitle(
        f"{found.search}, segmenter {found.segmenter}: matched template's highlight (orange), shadow (blue, dashed); "
        f"error of the yaw ({reading})",
        fontsize=9,
    )
    save_figure(figure, path, dpi=110)


def _draw_maps(path: Path, data: Data, settings: Settings) -> Path:
    """Contact sheet: raw frames in polar view, and under each what the network makes of it."""
    from matplotlib.figure import Figure

    chosen = [round(k) for k in np.linspace(0, len(data.names) - 1, min(settings.sheet, 20, len(data.names)))]
    columns = min(10, len(chosen))
    rows = 2 * -(-len(chosen) // columns)
    figure = Figure(figsize=(2.0 * columns, 2.3 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.ravel():
        ax.set_axis_off()
    for place, k in enumerate(chosen):
        image, mask = data.images[k], data.masks[k]
        above, below = (axes[2 * (place // columns) + part, place % columns] for part in (0, 1))
        plot_polar(above, image, data.sonar, vmin=0, vmax=float(np.percentile(image[mask], 99.5)))
        plot_polar(below, semantic_map(image, "pix2pix", mask), data.sonar, vmin=0, vmax=1)
        above.set_title(data.names[k], fontsize=8)
    figure.suptitle("real frames, and under each the map that pix2pix makes of it: highlight white, shadow black")
    save_figure(figure, path, dpi=110)
    return path


def parse(arguments: list[str] | None = None) -> Settings:
    """Settings from the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    for option in fields(Settings):
        text = f"{option.metadata['help']} (default: {option.default})"
        name = "--" + option.name.replace("_", "-")
        if isinstance(option.default, bool):
            parser.add_argument(name, action=argparse.BooleanOptionalAction, default=option.default, help=text)
        else:
            parser.add_argument(name, type=type(option.default), default=option.default, help=text)
    settings = Settings(**vars(parser.parse_args(arguments)))
    for given, known in ((settings.segmenters, SEGMENTERS), (settings.searches, SEARCHES)):
        unknown = [name for name in given.split(",") if name not in known]
        if unknown:
            parser.error(f"expected some of {', '.join(known)}, got {unknown[0]!r}")
    if not settings.step > 0 or abs(180 / settings.step - round(180 / settings.step)) > 1e-9:
        parser.error(f"--step must divide 180, got {settings.step}")
    if settings.median < 1 or settings.median % 2 == 0:
        parser.error(f"--median must be an odd number of pixels, got {settings.median}")
    return settings


def main() -> None:
    """Run, print the table, say where the files are."""
    settings = parse()
    try:
        report = run(settings)
    except sj.SonarjaxError as error:
        raise SystemExit(f"error: {error}") from None
    print(table(report))
    print(f"results: {Path(settings.out) / 'results.json'}")


if __name__ == "__main__":
    main()
