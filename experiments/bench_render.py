"""How fast is the renderer beside Embree (Open3D's RaycastingScene) with NumPy binning, in the same run?

python -m experiments.bench_render [--preset smoke] [--help]

The peer casts one ray per beam and elevation and fills the same range bins with the same three classes; it holds no
gradient and no shares of pixels. Open3D is of the extra `bench`; --no-peer does without it. Leaves triangles.png.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.bench_match import has, need, time_all
from experiments.common.engine import engine
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job
from sonarjax.render import TemplateBank, template_bank
from sonarjax.scene import Mesh
from sonarjax.scene.objects import ball, target
from sonarjax.sonar import Sonar

X_M = 2.3  # where the object stands
SAME_SURFACE_BINS = 8  # neighbouring rays whose ranges differ by less belong to one surface: bins between are filled
OURS, TURNED, REBUILT = "sonarjax", "Embree, rays turned", "Embree, scene rebuilt"
IN_BOX = "Embree, template's box only"
SMOKE = {"views": 12, "big_views": 2, "triangles": (100, 1_000), "repeats": 3, "peer": has("open3d")}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    views: int = 36
    """Yaws of the brick pile's bank, over the full circle."""
    elevations: int = 128
    """The peer's rays in each beam."""
    big_views: int = 6
    """Yaws of the banks of large meshes."""
    triangles: tuple[int, ...] = (100, 1_000, 10_000, 100_000)
    """About how many triangles the meshes of the cost curve have."""
    repeats: int = 9
    """Rounds; each times every contender once."""
    peer: bool = True
    """Time Embree too."""


def make_sonar() -> Sonar:
    """The DIDSON of §4.1 with a tilt of 20 degrees."""
    return Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9, range_min=1.5, range_max=4.0)


class Embree:
    """The peer: rays of a box of the frame, cast against a mesh that is turned, or turned themselves."""

    def __init__(self, mesh: Mesh, sonar: Sonar, elevations: int, box: tuple[int, int, int, int] | None = None) -> None:
        """`box` is (first row, first column, rows, columns) in pixels; by default the frame. Raises ImportError."""
        import open3d.core as o3c
        from open3d.t.geometry import RaycastingScene

        self._tensor, self._scene_type = o3c.Tensor, RaycastingScene
        faces = np.asarray(mesh.faces)
        self.faces = faces[faces[:, 0] != faces[:, 1]].astype(np.uint32)
        self.vertices = np.asarray(mesh.vertices, np.float32)
        self.scene = self._build(self.vertices)
        self.row, column, self.rows, columns = box or (0, 0, *sonar.shape)
        self.near, self.step = float(sonar.range_min), float(sonar.range_bin)
        azimuth = np.asarray(sonar.azimuth, np.float64)[column : column + columns, None]
        half = float(sonar.elevation_aperture) / 2
        bounds = np.linspace(-half, half, elevations + 1)
        self.head = np.array([0.0, 0.0, float(sonar.height)], np.float32)
        self.rays = _ground_rays(azimuth, (bounds[1:] + bounds[:-1]) / 2, float(sonar.tilt))
        self.floor = _floor_range(self.rays, self.head[2])
        ends = self._bin(_floor_range(_ground_rays(azimuth, bounds, float(sonar.tilt)), self.head[2]))
        self.floor_start, self.floor_stop = ends[:, :-1], ends[:, 1:]
        self.first = np.arange(self.rays.shape[0])[:, None] * (self.rows + 1)

    def _build(self, vertices: np.ndarray) -> Any:
        scene = self._scene_type()
        scene.add_triangles(self._tensor(vertices), self._tensor(self.faces))
        return scene

    def _bin(self, distance: np.ndarray) -> np.ndarray:
        bins = np.minimum((distance - self.near) * (1 / self.step), 1e6).astype(np.int32) - self.row
        return np.clip(bins, 0, self.rows)

    def turned_rays(self, x: float, yaws: np.ndarray) -> np.ndarray:
        """Semantic images (yaw, range, beam); the rays are turned into the object's frame, one cast for each view."""
        rays = np.empty((*self.rays.shape[:-1], 6), np.float32)
        images = []
        for yaw in yaws:
            turn = _rotation_z(yaw)  # row vectors times it: ground to object
            rays[..., :3] = (self.head - np.array([x, 0, 0], np.float32)) @ turn
            rays[..., 3:] = self.rays @ turn
            images.append(self._image(self.scene.cast_rays(self._tensor(rays))["t_hit"].numpy()))
        return np.stack(images)

    def rebuilt_scene(self, x: float, yaws: np.ndarray) -> np.ndarray:
        """Semantic images (yaw, range, beam); the mesh is turned and Embree's tree built anew for each view."""
        rays = np.empty((*self.rays.shape[:-1], 6), np.float32)
        rays[..., :3], rays[..., 3:] = self.head, self.rays
        images = []
        for yaw in yaws:
            scene = self._build(self.vertices @ _rotation_z(yaw).T + np.array([x, 0, 0], np.float32))
            images.append(self._image(scene.cast_rays(self._tensor(rays))["t_hit"].numpy()))
        return np.stack(images)

    def _image(self, distance: np.ndarray) -> np.ndarray:
        """Range bins and labels (range, beam) of first hits (beam, elevation) [m], as one grey image."""
        solid = distance < self.floor
        bins = self._bin(distance)
        after = np.concatenate([bins[:, 1:], bins[:, -1:]], axis=1)
        joined = solid & np.concatenate([solid[:, 1:], solid[:, -1:]], axis=1) & (abs(after - bins) < SAME_SURFACE_BINS)
        after = np.where(joined, after, bins)
        highlight = self._filled(np.minimum(bins, after), np.minimum(np.maximum(bins, after) + 1, self.rows), solid)
        shadow = self._filled(self.floor_start, self.floor_stop, solid)
        return np.where(highlight, np.float32(1), np.where(shadow, np.float32(0), np.float32(0.5))).T

    def _filled(self, start: np.ndarray, stop: np.ndarray, solid: np.ndarray) -> np.ndarray:
        size = len(start) * (self.rows + 1)
        begins = np.bincount((start + self.first)[solid], minlength=size)
        ends = np.bincount((stop + self.first)[solid], minlength=size)
        return np.cumsum((begins - ends).reshape(-1, self.rows + 1)[:, : self.rows], axis=1) > 0


def _rotation_z(yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)


def _ground_rays(azimuth: np.ndarray, elevation: np.ndarray, tilt: float) -> np.ndarray:
    """Unit rays (beam, elevation, 3) in the ground frame."""
    c, s = math.cos(tilt), math.sin(tilt)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    z = np.broadcast_to(np.sin(elevation), x.shape)
    return np.stack([c * x + s * z, y, c * z - s * x], -1).astype(np.float32)


def _floor_range(rays: np.ndarray, height: float) -> np.ndarray:
    return np.where(rays[..., 2] < -1e-6, height / np.maximum(-rays[..., 2], 1e-6), np.inf).astype(np.float32)


def compare(mesh: Mesh, sonar: Sonar, views: int, settings: Settings, variants: bool) -> dict[str, Any]:
    """Median seconds of one bank by each contender, and how far the labels agree with ours."""
    yaws = np.arange(views) * (2 * np.pi / views)
    render = partial(template_bank, mesh, sonar, yaws, x=X_M, engine=engine())
    bank = render()
    functions = {OURS: lambda: np.asarray(render().templates)}
    if settings.peer:
        frame = Embree(mesh, sonar, settings.elevations)
        functions[TURNED] = lambda: frame.turned_rays(X_M, yaws)
        if variants:
            row, column = np.asarray(bank.offset).tolist()
            part = Embree(mesh, sonar, settings.elevations, (row, column, *bank.templates.shape[1:]))
            functions[REBUILT] = lambda: frame.rebuilt_scene(X_M, yaws)
            functions[IN_BOX] = lambda: part.turned_rays(X_M, yaws)
    seconds, results = time_all(functions, settings.repeats)
    return {
        "triangles": int((np.asarray(mesh.faces)[:, 0] != np.asarray(mesh.faces)[:, 1]).sum()),
        "views": views,
        "seconds": seconds,
        "ratio": {name: value / seconds[OURS] for name, value in seconds.items()},
        "agree": {name: agreement(images, bank) for name, images in results.items()},
    }


def agreement(images: np.ndarray, bank: TemplateBank) -> float:
    """Share of the pixels in the bank's box that `images` or ours call highlight or shadow and both call the same."""
    (row, column), (rows, columns) = np.asarray(bank.offset), bank.templates.shape[1:]
    if images.shape != bank.templates.shape:
        images = images[:, row : row + rows, column : column + columns]
    ours, theirs = (np.digitize(v, [0.25, 0.75]) for v in (np.asarray(bank.templates), images))
    either = (ours != 1) | (theirs != 1)
    return float((ours == theirs)[either].mean())


def ball_of(triangles: int) -> Mesh:
    """A ball of about that many triangles."""
    rings = max(3, round((1 + math.sqrt(1 + triangles)) / 2))
    return ball(rings=rings, sectors=2 * rings)


def growth(rows: list[dict[str, Any]], name: str) -> dict[str, float]:
    """Exponent p of cost ~ triangles^p: the least-squares fit, and the steepest step between neighbours."""
    named = [row for row in rows if name in row["seconds"]]
    if len(named) < 2:
        return {}
    count = np.log([row["triangles"] for row in named])
    cost = np.log([row["seconds"][name] / row["views"] for row in named])
    return {"fit": float(np.polyfit(count, cost, 1)[0]), "steepest": float((np.diff(cost) / np.diff(count)).max())}


def draw(report: dict[str, Any], folder: Path) -> None:
    """Cost of a view against triangles, ours and the peer's, as a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(5.5, 4), layout="constrained")
    for name in (OURS, TURNED):
        rows = [row for row in report["curve"] if name in row["seconds"]]
        if rows:
            x, y = [r["triangles"] for r in rows], [1e3 * r["seconds"][name] / r["views"] for r in rows]
            axes.loglog(x, y, "o-", label=f"{name} (exponent {report['growth'][name].get('fit', math.nan):.2f})")
    axes.set(xlabel="triangles of the ball", ylabel="time of one view [ms]", title=f"one view, {report['platform']}")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(folder / "triangles.png", dpi=150)
    plt.close(figure)


def run(settings: Settings, job: Job) -> Report:
    """The bank of the brick pile, a mesh of 40,000 triangles and the cost curve: seconds, ratios, growth."""
    if settings.peer:
        need("open3d", "Open3D")
    sonar, views = make_sonar(), settings.big_views

    def measure(case: tuple[Callable[[], Mesh], int, bool]) -> dict[str, Any]:
        make, views, variants = case
        return compare(make(), sonar, views, settings, variants)

    cases = {"bank": (target, settings.views, True), "big": (partial(ball, rings=100, sectors=200), views, False)}
    cases |= {f"{count} triangles": (partial(ball_of, count), views, False) for count in settings.triangles}
    found = job.map(measure, cases, "render")
    report: Report = {"platform": jax.devices()[0].platform, "bank": found.pop("bank"), "big": found["big"]}
    report["curve"] = sorted(found.values(), key=lambda row: row["triangles"])
    report["growth"] = {name: growth(report["curve"], name) for name in (OURS, TURNED)}
    draw(report, job.folder)
    return report


def table(report: Report) -> str:
    """A line for each scene and contender; ratios above 1 say that ours is faster."""
    head = ("triangles", "views", "method", "ms a bank", f"ms a view ({report['platform']})", "× ours", "labels agree")
    rows = [
        [
            row["triangles"], row["views"], name, 1e3 * value, 1e3 * value / row["views"],
            row["ratio"][name], row["agree"][name],
        ]
        for row in [report["bank"], *report["curve"]]
        for name, value in row["seconds"].items()
    ]  # fmt: skip
    grown = [
        f"{name}: cost grows as triangles^{exponent['fit']:.2f}, steepest step {exponent['steepest']:.2f}"
        for name, exponent in report["growth"].items()
        if exponent
    ]
    return "\n".join([markdown(head, rows), "", *grown])


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
