"""Are the renderer's visibility gradients right? Against central differences of a converged render, over random scenes.

python -m experiments.gradient_check [--preset smoke] [--help]

Two losses of the semantic window to a fixed target (sum of squared differences, 1 - NCC) are differentiated by yaw, x
and y at each quality; an error is divided by the RMS of that derivative over all scenes, and again over those of each
mesh alone. Then value and gradient are searched for NaN and infinity over many poses, degenerate ones among them.
Leaves quality.png.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.bodies import bottle, deformed_sphere, stepped_cylinder
from experiments.common.frames import sonar_for
from experiments.common.launch import Report, launch
from experiments.common.metrics import markdown
from experiments.common.runs import Job
from sonarjax.refine import RefineConfig
from sonarjax.render import RenderQuality, Window, WindowSize, place_window, plan_window, render_window
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar

MESHES = {
    "target": objects.target,
    "non_target": objects.non_target,
    "cylinder": objects.concrete_cylinder,
    "stepped_cylinder": stepped_cylinder,
    "bottle": bottle,
    "deformed_sphere": deformed_sphere,
}
Name = Literal["target", "non_target", "cylinder", "stepped_cylinder", "bottle", "deformed_sphere"]
TILTS = (15.0, 20.0, 25.0)  # [deg]
NEAREST, FARTHEST, SIDE = 2.05, 2.4, 0.2  # where the objects stand [m]
PARAMETERS, LOSSES = ("yaw", "x", "y"), ("squares", "1 - NCC")
# Three steps of each, averaged: longer than the image's own roughness, shorter than its curvature.
STEPS = np.array([[4e-3, 6e-3, 9e-3], [0.6e-3, 1.0e-3, 1.5e-3], [0.6e-3, 1.0e-3, 1.5e-3]])  # [rad], [m], [m]
ELEVATIONS = 64
LAYERS = ("intensity", "highlight", "shadow")
BARS = {"median": 0.08, "p95": 0.25, "sign": 0.98, "forward": 0.03}
YAW_FLOOR = 0.25
"""Of one mesh alone, yaw is held to the bars where its RMS derivative [1/rad] is at least this share of that by x and y
[1/m] times the mesh's radius [m]: where a turn changes the picture at least so much as a shift of its outermost point
by the same length. A solid of revolution stays far below; its derivative by yaw is that of its tessellation."""
CHUNK = 2000
TILT = 20.0  # of the sonar where none of TILTS is drawn [deg]
SMALL = (96, 24)  # range bins and beams of a small frame of the same field of view, for the sweep over many poses
SUB_BEAMS = RefineConfig().quality.sub_beams


@dataclass(frozen=True)
class Settings:
    """What is checked."""

    scenes: int = 14
    """Random scenes of each mesh."""
    meshes: tuple[Name, ...] = tuple(MESHES)
    """Which objects."""
    qualities: tuple[int, ...] = (1, 2, 4)
    """Values of the quality knob `sub_beams`."""
    converged: int = 8
    """`sub_beams` of the render that is differenced."""
    forward: int = 8
    """The forward image is compared with one of that many times the sub-beams and elevations; 0 leaves this out."""
    poses: int = 100_000
    """Poses that are searched for NaN and infinity; 0 leaves this out."""


class Scene(NamedTuple):
    """A scene and the target that its picture is compared with."""

    mesh: Mesh
    sonar: Sonar
    at: np.ndarray
    """Where the object is: (yaw, x, y)."""
    off: np.ndarray
    """How far from there it is in the target."""
    shape: tuple[int, int]
    """Range bins and beams of the window."""


def load_meshes(names: tuple[str, ...]) -> dict[str, Mesh]:
    """The objects by name; those of the same array sizes get the same static bounds, and so share compiled code."""
    meshes = {name: MESHES[name]() for name in names}

    def sizes(mesh: Mesh) -> tuple:
        return mesh.vertices.shape, mesh.faces.shape, mesh.crease.shape, bool(mesh.closed)

    shared = {}
    for name, mesh in meshes.items():
        alike = [other for other in meshes.values() if sizes(other) == sizes(mesh)]
        bounds = {
            key: max(getattr(other, key) for other in alike)
            for key in ("crossings", "front", "intersecting", "radius", "top")
        }
        shared[name] = replace(mesh, **bounds)
    return shared


# ---------------------------------------------------------------- the two losses and their derivatives


def picture(mesh: Mesh, sonar: Sonar, p: Any, window: Window, sub_beams: int) -> jax.Array:
    """Semantic window (range, beam) at p = (yaw, x, y)."""
    quality = RenderQuality(sub_beams, ELEVATIONS)
    return render_window(mesh, Pose(p[1], p[2], p[0]), sonar, window, quality).semantic()


def losses(image: Any, aim: Any) -> jax.Array:
    """Sum of squared differences and 1 - NCC of two images (range, beam)."""
    a, b = image - image.mean(), aim - aim.mean()
    ncc = (a * b).sum() / jnp.sqrt((a * a).sum() * (b * b).sum())
    return jnp.stack([((image - aim) ** 2).sum(), 1 - ncc])


@partial(jax.jit, static_argnames=("shape", "sub_beams"))
def pictures(mesh: Mesh, sonar: Sonar, points: Any, row: Any, column: Any, shape: Any, sub_beams: int) -> jax.Array:
    """Semantic windows (point, range, beam) at points (point, 3), one after another: all perturbations of a scene."""
    return jax.lax.map(lambda p: picture(mesh, sonar, p, Window(row, column, shape), sub_beams), points)


@partial(jax.jit, static_argnames="sub_beams")
def derivatives(mesh: Mesh, sonar: Sonar, p: Any, row: Any, column: Any, aim: Any, sub_beams: int) -> jax.Array:
    """Derivatives (loss, parameter) of both losses at p by reverse mode."""

    def both(p: jax.Array) -> jax.Array:
        return losses(picture(mesh, sonar, p, Window(row, column, aim.shape), sub_beams), aim)

    return jax.jacrev(both)(p)


@partial(jax.jit, static_argnames=("shape", "sub_beams", "elevations"))
def layers(
    mesh: Mesh, sonar: Sonar, p: Any, row: Any, column: Any, shape: Any, sub_beams: int, elevations: int
) -> tuple[jax.Array, ...]:
    """Intensity, highlight and shadow (range, beam) of the window at p = (yaw, x, y)."""
    quality = RenderQuality(sub_beams, elevations)
    out = render_window(mesh, Pose(p[1], p[2], p[0]), sonar, Window(row, column, shape), quality)
    return out.intensity, out.highlight, out.shadow


def central(values: np.ndarray) -> np.ndarray:
    """Derivatives (loss, parameter), averaged over the steps, from losses (sign × parameter × step, loss)."""
    up, down = values.reshape(2, *STEPS.shape, len(LOSSES))
    return ((up - down) / (2 * STEPS[..., None])).mean(1).T


def check_scene(settings: Settings, scene: Scene) -> dict[str, Any]:
    """One scene: differences and, for each quality, derivatives, seconds and forward errors."""
    mesh, sonar, at, off, shape = scene
    window = place_window(WindowSize(shape), mesh, sonar, float(at[1]), float(at[2]))
    corner = (window.row, window.column)
    steps = np.eye(3)[:, None] * STEPS[..., None]  # (parameter, step, 3)
    points = np.concatenate([np.stack([at + steps, at - steps]).reshape(-1, 3), (at + off)[None]])
    drawn = np.asarray(
        pictures(mesh, sonar, jnp.asarray(points, jnp.float32), *corner, shape, settings.converged), np.float64
    )
    # In float64 on the host: the differences are a millionth of the loss.
    values = np.stack([host_losses(image, drawn[-1]) for image in drawn[:-1]])
    found: dict[str, Any] = {"truth": central(values), "ours": {}, "seconds": {}, "forward": {}}
    p, aim = jnp.asarray(at, jnp.float32), jnp.asarray(drawn[-1], jnp.float32)
    for quality in settings.qualities:
        found["ours"][str(quality)] = np.asarray(derivatives(mesh, sonar, p, *corner, aim, quality), np.float64)
        start = time.perf_counter()
        derivatives(mesh, sonar, p, *corner, aim, quality).block_until_ready()
        found["seconds"][str(quality)] = time.perf_counter() - start
    if settings.forward:
        best = settings.forward * max(settings.qualities)
        finer = layers(mesh, sonar, p, *corner, shape, best, settings.forward * ELEVATIONS)
        for quality in settings.qualities:
            rough = layers(mesh, sonar, p, *corner, shape, quality, ELEVATIONS)
            found["forward"][str(quality)] = [
                float(jnp.sqrt(((a - b) ** 2).sum() / (b**2).sum())) for a, b in zip(rough, finer, strict=True)
            ]
    return found


def host_losses(image: np.ndarray, aim: np.ndarray) -> np.ndarray:
    """`losses` (loss,) in NumPy's float64."""
    a, b = image - image.mean(), aim - aim.mean()
    return np.array([((image - aim) ** 2).sum(), 1 - (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())])


def draw_scenes(settings: Settings, seed: int) -> dict[str, Scene]:
    """All scenes of all meshes by name."""
    rng, found = np.random.default_rng(seed), {}
    for name, mesh in load_meshes(settings.meshes).items():
        grounds = NEAREST, math.hypot(FARTHEST, SIDE)
        shapes = [plan_window(mesh, sonar_for(TILT), ground, 0.03).shape for ground in grounds]
        shape = max(s[0] for s in shapes), max(s[1] for s in shapes)
        for k in range(settings.scenes):
            sonar = sonar_for(TILT).replace(tilt=jnp.float32(math.radians(TILTS[k % len(TILTS)])))
            at = rng.uniform([0.0, NEAREST, -SIDE], [2 * math.pi, FARTHEST, SIDE])
            turned = rng.choice([-1, 1]) * rng.uniform(0.05, 0.15)
            off = np.array([turned, *rng.uniform(-0.012, 0.012, 2)])
            found[f"{name} {k}"] = Scene(mesh, sonar, at, off, shape)
    return found


def over_scenes(scenes: list[dict[str, Any]], quality: str, radius: float | None = None) -> dict[str, Any]:
    """Error over RMS of each loss and parameter (median, 95th percentile, share of right signs), cost, forward RMS.

    A derivative that is zero by symmetry (yaw of a cylinder) counts as every other: its error is divided by the
    RMS over all meshes. Not so where `radius` [m] is that of the one mesh in all the scenes: then see YAW_FLOOR.
    """
    ours = np.stack([scene["ours"][quality] for scene in scenes])
    truth = np.stack([scene["truth"] for scene in scenes])
    rms = np.sqrt((truth**2).mean(0))
    error, clear = np.abs(ours - truth) / rms, np.abs(truth) > 0.2 * rms
    right = ((np.sign(ours) == np.sign(truth)) & clear).sum(0) / clear.sum(0)
    counts = [True] * len(PARAMETERS)
    if radius is not None:
        counts[0] = bool((rms[:, 0] >= YAW_FLOOR * radius * np.sqrt((rms[:, 1:] ** 2).mean(1))).all())
    forward = [scene["forward"][quality] for scene in scenes if scene["forward"]]
    return {
        "median": np.median(error, 0).tolist(), "p95": np.percentile(error, 95, axis=0).tolist(),
        "sign": right.tolist(), "clear": clear.sum(0).tolist(), "counts": counts,
        "finite": bool(np.isfinite(ours).all()),
        "seconds": float(np.median([scene["seconds"][quality] for scene in scenes])),
        "forward": np.sqrt(np.mean(np.square(forward), 0)).tolist() if forward else None,
        "forward_worst": np.max(forward, 0).tolist() if forward else None,
    }  # fmt: skip


# ---------------------------------------------------------------- finite everywhere


@jax.jit
def finite(mesh: Mesh, small: Sonar, poses: Any) -> tuple[jax.Array, jax.Array]:
    """Whether value and all gradients are finite (pose,), and the largest gradient by the pose (pose,).

    Poses (pose, 8) are (x, y, yaw, z, roll, pitch, tilt, height) [m, rad].
    """
    weight = jnp.cos(jnp.arange(math.prod(SMALL), dtype=jnp.float32)).reshape(SMALL)

    def value(q: jax.Array, vertices: jax.Array) -> jax.Array:
        sonar, quality = small.replace(tilt=q[6], height=q[7]), RenderQuality(1, 16)
        out = render_window(mesh.with_vertices(vertices), Pose(*q[:6]), sonar, Window(0, 0, SMALL), quality)
        return (weight * (100 * out.intensity + out.highlight + 0.5 * out.shadow)).sum()

    def one(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        found, (by_pose, by_shape) = jax.value_and_grad(value, (0, 1))(q, mesh.vertices)
        good = jnp.isfinite(found) & jnp.isfinite(by_pose).all() & jnp.isfinite(by_shape).all()
        return good, jnp.abs(by_pose).max()

    return jax.lax.map(one, poses)


def small_sonar() -> Sonar:
    """The sonar of small frames."""
    azimuth = np.radians((np.arange(SMALL[1]) + 0.5 - SMALL[1] / 2) * 29 / SMALL[1])
    return sonar_for(TILT).replace(azimuth=jnp.asarray(azimuth, jnp.float32), n_ranges=SMALL[0])


def random_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses (count, 8); nine of ten kinds are places at which something degenerates."""
    quarter, kind, q = math.pi / 2, np.arange(count) % 10, np.zeros((count, 8))
    q[:, :3] = rng.uniform([-1, -1, -7], [4.5, 1, 7], (count, 3))
    q[:, 6], q[:, 7] = rng.uniform(0.2, 0.5, count), 0.9
    q[kind == 0, 1] = q[kind == 0, 0] * math.tan(math.radians(14.5))  # half out of view
    q[kind == 1, 0] = -np.abs(q[kind == 1, 0]) - 0.1  # behind the sonar
    q[kind == 2, 3] = rng.uniform(-0.3, 0.0, (kind == 2).sum())  # in or below the floor
    q[kind == 3, 1], q[kind == 3, 2] = 0.0, rng.integers(-4, 5, (kind == 3).sum()) * quarter  # faces edge-on
    q[kind == 4, :2] = np.round(q[kind == 4, :2], 1)  # round numbers
    q[kind == 4, 2] = rng.integers(0, 8, (kind == 4).sum()) * quarter / 2
    q[kind == 5, 3:6] = rng.uniform(-math.pi, math.pi, ((kind == 5).sum(), 3)) * [0.1, 1, 1]  # tumbled
    q[kind == 6, 4:6] = rng.integers(-2, 3, ((kind == 6).sum(), 2)) * quarter  # on their heads, on their sides
    q[kind == 7, :2] *= 0.02  # at the foot of the sonar and around its head
    q[kind == 7, 3] = rng.uniform(0, 1, (kind == 7).sum())
    q[kind == 8, 6], q[kind == 8, 3] = 0.0, 0.9 - objects.BRICK_M[2]  # a level sonar in the plane of a top face
    return q


def check_poses(settings: Settings, job: Job) -> dict[str, Any]:
    """How many poses give NaN or infinity, the first of them, and the share of poses at which the object is seen."""
    mesh, poses = objects.target(), random_poses(np.random.default_rng(job.seed), settings.poses)
    chunk, sonar = min(CHUNK, settings.poses), small_sonar()

    def check(first: int) -> dict[str, Any]:
        part = np.resize(poses[first : first + chunk], (chunk, 8))  # the last chunk is filled up: one compilation
        fine, gradient = (np.asarray(v) for v in finite(mesh, sonar, jnp.asarray(part, jnp.float32)))
        fine, gradient = fine[: len(poses) - first], gradient[: len(poses) - first]
        return {
            "bad": poses[first : first + chunk][~fine],
            "seen": int((gradient > 0).sum()),
            "largest": float(np.max(gradient, where=np.isfinite(gradient), initial=0.0)),
        }

    parts = job.map(check, {f"from {first}": first for first in range(0, len(poses), chunk)}, "poses").values()
    bad = [pose for part in parts for pose in part["bad"]]
    return {
        "poses": len(poses),
        "bad": len(bad),
        "first": bad[:3],
        "seen": sum(part["seen"] for part in parts) / len(poses),
        "largest": max(part["largest"] for part in parts),
    }


# ---------------------------------------------------------------- report


def draw(report: dict[str, Any], folder: Path) -> Path:
    """Error against cost over the quality knob, as a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 4), layout="constrained", sharey=True)
    qualities = list(report["qualities"])
    for loss, axes in enumerate(panels):
        cost = [1e3 * report["qualities"][q]["seconds"] for q in qualities]
        for k, parameter in enumerate(PARAMETERS):
            for key, style in (("median", "o-"), ("p95", "s--")):
                error = [100 * report["qualities"][q][key][loss][k] for q in qualities]
                axes.loglog(cost, error, style, color=f"C{k}", label=f"{parameter}, {key}")
        for q, at in zip(qualities, cost, strict=True):
            axes.annotate(q, (at, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=8)
        for key in ("median", "p95"):
            axes.axhline(100 * BARS[key], color="grey", lw=0.8, ls=":")
        axes.set(xlabel="both gradients [ms]", title=f"{LOSSES[loss]} (sub_beams above the frame)\n")
        axes.grid(True, which="both", alpha=0.3)
    panels[0].set(ylabel="error / RMS derivative [%]")
    panels[0].legend(fontsize=7)
    figure.savefig(folder / "quality.png", dpi=150)
    plt.close(figure)
    return folder / "quality.png"


def run(settings: Settings, job: Job) -> Report:
    """Errors, costs and forward convergence for each quality, and the search for values that are not finite."""
    drawn = draw_scenes(settings, job.seed)
    found = job.map(partial(check_scene, settings), drawn, "scenes")
    scenes = list(found.values())

    def of_mesh(name: str, quality: str) -> dict[str, Any]:
        mine = [key for key in drawn if key.rsplit(" ", 1)[0] == name]
        return over_scenes([found[key] for key in mine], quality, radius=drawn[mine[0]].mesh.radius)

    report: Report = {
        "platform": jax.devices()[0].platform,
        "scenes": len(scenes),
        "meshes": settings.meshes,
        "converged": settings.converged,
        "finer": settings.forward * max(settings.qualities),
        "qualities": {str(quality): over_scenes(scenes, str(quality)) for quality in settings.qualities},
        "by_mesh": {
            name: {str(quality): of_mesh(name, str(quality)) for quality in settings.qualities}
            for name in settings.meshes
        },
        "poses": check_poses(settings, job) if settings.poses > 0 else None,
    }
    report["figure"] = draw(report, job.folder)
    return report


def verdict(row: dict[str, Any]) -> str:
    """`bars met`, or which are not."""
    counted = np.array(row["counts"])
    missed = [key for key in ("median", "p95") if np.max(np.array(row[key])[:, counted]) > BARS[key]]
    missed += ["sign"] if np.min(np.array(row["sign"])[:, counted]) < BARS["sign"] else []
    if row["forward_worst"] is not None and max(row["forward_worst"]) > BARS["forward"]:
        missed.append("forward")
    missed += [] if row["finite"] else ["finite"]
    return "MISSED: " + ", ".join(missed) if missed else "bars met"


def mesh_table(report: Report) -> str:
    """A row for each mesh and quality: the worse of both losses by each parameter, and which bars are missed."""
    head = ("mesh", "sub_beams", *(f"{parameter}: median, 95 %, sign" for parameter in PARAMETERS), "forward", "")
    rows = []
    for name, qualities in report["by_mesh"].items():
        for quality, row in qualities.items():
            worst = zip(np.max(row["median"], 0), np.max(row["p95"], 0), np.min(row["sign"], 0), strict=True)
            cells = [
                f"{median:.1%}, {p95:.1%}, {sign:.0%}" if counted else "below its floor"
                for (median, p95, sign), counted in zip(worst, row["counts"], strict=True)
            ]
            forward = f"{max(row['forward']):.1%}" if row["forward"] else "–"
            rows.append([name, quality, *cells, forward, verdict(row)])
    return markdown(head, rows)


def table(report: Report) -> str:
    """A row for each quality, loss and parameter, one for each mesh and quality, then forward convergence and poses."""
    head = ("sub_beams", f"ms ({report['platform']})", "loss", "by", "median", "95 %", "sign right", "of")
    rows, notes = [], []
    for quality, row in report["qualities"].items():
        for i, loss in enumerate(LOSSES):
            for k, parameter in enumerate(PARAMETERS):
                shares = [f"{row[key][i][k]:.1%}" for key in ("median", "p95", "sign")]
                rows.append([quality, f"{1e3 * row['seconds']:.2f}", loss, parameter, *shares, row["clear"][i][k]])
        default = " (refinement's default)" if quality == str(SUB_BEAMS) else ""
        notes.append(f"sub_beams {quality}{default}: {verdict(row)}{_forward(row, report['finer'])}")
    lines = [
        f"{report['scenes']} scenes of {', '.join(report['meshes'])}; central differences at sub_beams"
        f" {report['converged']}; bars: median 8 %, 95 % 25 %, sign 98 %, forward 3 %",
        markdown(head, rows), "", "Each mesh alone, errors over its own RMS:", mesh_table(report),
        "", *notes, *_poses(report["poses"]), f"figure: {report['figure']}",
    ]  # fmt: skip
    return "\n".join(lines)


def _forward(row: dict[str, Any], finer: int) -> str:
    if row["forward"] is None:
        return ""
    layers = zip(LAYERS, row["forward"], row["forward_worst"], strict=True)
    values = ", ".join(f"{name} {rms:.2%} (worst {worst:.2%})" for name, rms, worst in layers)
    return f"; forward RMS against sub_beams {finer}: {values}"


def _poses(poses: dict[str, Any] | None) -> list[str]:
    if poses is None:
        return []
    return [
        f"{poses['poses']} poses: {poses['bad']} not finite; seen at {poses['seen']:.0%},"
        f" largest gradient {poses['largest']:.3g}",
        *(f"  not finite at (x, y, yaw, z, roll, pitch, tilt, height) = {pose}" for pose in poses["first"]),
    ]


if __name__ == "__main__":
    small = {"scenes": 3, "meshes": ("target",), "qualities": (SUB_BEAMS,), "forward": 0, "poses": 200}
    launch(run, Settings, table, smoke=small)
