"""`fit_surface`: all vertices of a smooth body from frames at known poses (beyond the paper).

Adam lowers 1 − NCC between the rendered echo and each frame, with the gradient by every vertex. Steps are smoothed by
(I + λL)⁻¹, where L is the mesh's Laplacian, so that neighbours move together (Nicolet, Jacobson and Jakob, Large Steps
in Inverse Rendering of Geometry, ACM Trans. Graph. 40, 2021). A prior keeps the displacement smooth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from sonarjax.calibrate.inputs import check_frames, check_kinds, check_not_blank, starts_of
from sonarjax.calibrate.solver import BOUNCE
from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, check_whole, is_number, positive_numbers, shown
from sonarjax.refine.objective import Problem, box_around, make_blur, misfit
from sonarjax.refine.solver import Search, best_template
from sonarjax.refine.template import VIEWS, EchoLaw, Subject, nominal_law, render_layers, semantic_template
from sonarjax.render import RenderQuality, WindowSize, place_window
from sonarjax.render.region import leaning_room, plan_window_at
from sonarjax.render.room import with_lean_room
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

MARGIN = (48, 12)
"""Range bins and beams around the first mesh's template that are compared, because the body may be found there."""
SLACK_M = 0.05
"""Room around the first mesh in its window [m]."""
ROOM = 2
"""Factor on the room for triangles in a slice, because slices cross a bent surface more often."""
MOST_VERTICES = 2000
"""Most vertices of a mesh: the smoothing is a dense matrix, so larger meshes must be made coarser first."""


@dataclass(frozen=True)
class SurfaceConfig:
    """How `fit_surface` searches."""

    blurs: tuple[float, ...] = (6.0, 3.0, 1.5)
    """Standard deviations of the blur [range bins], coarse to fine."""
    iterations: int = 40
    """Number of steps at each blur."""
    step_m: float = 1.5e-3
    """Largest first step of a vertex [m]; within each blur the steps fall to a fifth."""
    smoothing: float = 12.0
    """λ of the smoothed steps [1]: vertices within about √λ edges of each other move together."""
    prior: float = 20.0
    """Weight of the mean square of the displacement's Laplacian, measured in radii of the body [1]."""

    def __post_init__(self) -> None:
        """Turn lists into tuples. Raise a SonarjaxError for numbers that no search can have."""
        object.__setattr__(self, "blurs", positive_numbers(self.blurs, "positive numbers of range bins", "blurs"))
        check_whole(self.iterations, 1, "iterations")
        positive_numbers((self.step_m,), "a positive number of metres", "step_m")
        for name in ("smoothing", "prior"):
            value = getattr(self, name)
            if not (is_number(value) and 0 <= value < math.inf):
                raise SonarjaxError(f"{name}: expected a number of 0 or more, got {shown(value)}")


@dataclass(frozen=True, eq=False)
class SurfaceEstimate:
    """What `fit_surface` found."""

    mesh: Mesh
    """The same triangles, with fitted vertices."""
    score: np.ndarray
    """Mean NCC of template and frame over all frames (step + 1,), blurred as in that step; the first is that of
    the first mesh.
    """
    scores: np.ndarray
    """The last NCC of each frame (frame,)."""
    moved: np.ndarray
    """How far each vertex moved [m] (vertex,). No frame shows the underside, so only the prior decides there."""


class _Frame(NamedTuple):
    """A frame ready for comparison. It holds only numbers, so that all frames share compiled code."""

    image: Any
    mask: Any
    pose: Pose
    law: tuple[Any, ...]
    weight: Any


def fit_surface(
    frames: Any,
    mesh: Mesh,
    sonar: Sonar,
    poses: Pose,
    *,
    config: SurfaceConfig = SurfaceConfig(),
    masks: Any = None,
    engine: Engine = PLAIN,
    progress: Callable[[str], None] = lambda text: None,
) -> SurfaceEstimate:
    """Fit the surface of a smooth body to frames of it at known poses.

    This assumes a flat floor, a known sonar, and a body without sharp edges that stays above the floor: vertices that
    are below it in a frame are put onto it. Parts that no frame shows are bent smoothly along with the parts that
    frames show.

    Args:
        frames: Grey frames (frame, range, beam).
        mesh: A first guess whose triangles are bent, for example a ball of the body's size; 2,000 vertices or fewer.
        sonar: The sonar.
        poses: Known poses of the body (frame,).
        config: How to search.
        masks: True where pixels were measured (frame, range, beam); None, also for a single frame, means everywhere.
        engine: Runs the compiled functions.
        progress: Called with a text that says what is being done.

    Returns:
        The mesh with fitted vertices (vertex, 3) [m], how far each moved, and the correlation with the frames.

    Raises:
        SonarjaxError: There are no frames, their shapes do not fit the sonar, they are all the same or blank, values
            are not finite (also of poses), there is another number of poses or masks, the body is out of view, the mesh
            has too many vertices, or `config` is something else.
    """
    check_kinds(mesh, sonar, engine)
    check_kind(config, SurfaceConfig, "config")
    images, measured = check_frames(frames, masks, sonar)
    starts = starts_of(poses, len(images), sonar)
    check_not_blank(images, measured)
    vertices = np.asarray(mesh.vertices, np.float64)
    count = len(_touched(np.asarray(mesh.faces)))
    if count > MOST_VERTICES:
        raise SonarjaxError(f"mesh: expected {MOST_VERTICES} vertices or fewer, got {count}")
    sonar = sonar.replace(geometry_std=None)
    mesh = with_lean_room(mesh, poses, sonar)
    mesh = mesh.with_room(ROOM * mesh.crossings, mesh.n_faces)
    size = _window(mesh, sonar, starts)
    prepared = [
        _Frame(image, np.ones(sonar.shape, np.float32) if mask is None else mask.astype(np.float32), start, (), None)
        for image, mask, start in zip(images, measured, starts, strict=True)
    ]
    prepared = engine.map(partial(_begun, engine, mesh, sonar, size), prepared)

    def evaluate(positions: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
        given = positions.astype(np.float32)

        def one(frame: _Frame) -> Any:
            return engine.run(_by_vertices, *frame, mesh, sonar, given, np.float32(sigma), size=size)

        costs, slopes = zip(*engine.map(one, prepared), strict=True)
        return np.array([float(c) for c in costs]), np.sum([np.asarray(s, float) for s in slopes], axis=0)

    lifted = partial(above_floor, poses=poses)
    found, scores, last = _descend(evaluate, lifted, vertices, np.asarray(mesh.faces), config, progress)
    return SurfaceEstimate(
        mesh=mesh.with_vertices(jnp.asarray(found, jnp.float32)),
        score=scores,
        scores=last,
        moved=np.linalg.norm(found - vertices, axis=1),
    )


def _window(mesh: Mesh, sonar: Sonar, starts: Sequence[Pose]) -> WindowSize:
    """One window size for all frames, slightly larger than the first mesh needs at its poses."""
    shape = plan_window_at(mesh, sonar, starts, SLACK_M).shape
    return WindowSize(shape, shape[1])


def _touched(faces: np.ndarray) -> np.ndarray:
    """Numbers of the vertices that a triangle of `faces` (face, 3) touches: all but padding."""
    return np.unique(faces[faces[:, 0] != faces[:, 1]])


def above_floor(vertices: Float[np.ndarray, "vertex 3"], poses: Pose) -> Float[np.ndarray, "vertex 3"]:
    """The vertices of a mesh (vertex, 3) [m], those put onto the floor that are below it at any of the poses (frame,).

    Where poses lean in several ways, one pose after the other.
    """
    up, height = np.asarray(poses.rotation(), float)[:, 2], np.asarray(poses.z, float)
    for *normal, lift in np.unique(np.column_stack([up, height]), axis=0):
        below = np.maximum(-(vertices @ np.array(normal) + lift), 0.0)
        vertices = vertices + below[:, None] * np.array(normal)
    return vertices


def _descend(
    evaluate: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]], lifted: Callable[[np.ndarray], np.ndarray],
    begin: np.ndarray, faces: np.ndarray, config: SurfaceConfig, progress: Callable[[str], None],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Adam over smoothed displacements: the vertices (vertex, 3), each step's mean score, each frame's last score.

    `lifted` puts vertices above the floor.
    """
    laplacian = uniform_laplacian(faces, len(begin))
    smooth = np.linalg.inv(np.eye(len(begin)) + config.smoothing * laplacian)
    real = begin[_touched(faces)]
    radius = max(float(np.abs(real - real.mean(axis=0)).max()), 1e-6)
    point, scores, costs = begin.copy(), [], np.zeros(0)
    for sigma in config.blurs:
        schedule = optax.cosine_decay_schedule(config.step_m, config.iterations, alpha=0.2)
        adam = optax.scale_by_adam(b1=0.9, b2=0.98)
        state = adam.init(jnp.asarray(point, jnp.float32))
        for number in range(config.iterations):
            costs, slope = evaluate(point, sigma)
            scores.append(1 - costs.mean())
            bent = laplacian @ (point - begin)
            slope = slope / len(costs) + 2 * config.prior / radius**2 * laplacian.T @ bent / len(real)
            step, state = adam.update(jnp.asarray(smooth @ slope, jnp.float32), state)
            # Scale all vertices by one length. Scaled one by one, vertices that no frame shows would move as far.
            along = smooth @ np.asarray(step, np.float64)
            along *= float(schedule(number)) / max(np.linalg.norm(along, axis=1).max(), 1e-12)
            point = lifted(point - along)
        progress(f"fitted with a blur of {sigma:g} range bins: NCC {scores[-1]:.3f}")
    costs, _ = evaluate(point, config.blurs[-1])
    return point, np.array([*scores, 1 - costs.mean()]), 1 - costs


def uniform_laplacian(faces: np.ndarray, count: int) -> Float[np.ndarray, "vertex vertex"]:
    """The mesh's Laplacian (vertex, vertex) with equal weights: each vertex minus the mean of its neighbours.

    Vertices without a triangle, such as padding, have a row of zeros.
    """
    near = np.zeros((count, count))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        near[faces[:, a], faces[:, b]] = near[faces[:, b], faces[:, a]] = 1.0
    np.fill_diagonal(near, 0.0)
    neighbours = near.sum(axis=1, keepdims=True)
    return np.diag((neighbours[:, 0] > 0).astype(float)) - near / np.maximum(neighbours, 1.0)


def _begun(engine: Engine, mesh: Mesh, sonar: Sonar, size: WindowSize, frame: _Frame) -> _Frame:
    """The frame with the echo law that fits the first mesh best, and the weights of the pixels in its window."""
    *law, weight = engine.run(_chosen, frame.image, frame.mask, frame.pose, mesh, sonar, size=size)
    return frame._replace(law=tuple(np.asarray(v) for v in law), weight=np.asarray(weight))


def _problem(
    image: Array, mask: Array, pose: Pose, law: EchoLaw, mesh: Mesh, sonar: Sonar, first: Mesh, size: WindowSize
) -> Problem:
    """The comparison in the window around the `first` mesh."""
    around = leaning_room(first, pose.z, abs(pose.roll), abs(pose.pitch))
    window = place_window(size, around, sonar, pose.x, pose.y, SLACK_M)
    part, measured = (jax.lax.dynamic_slice(v, (window.row, window.column), size.shape) for v in (image, mask))
    echo, quality = jnp.int32(VIEWS["echo"]), RenderQuality(sub_beams=1)
    subject = Subject(mesh, sonar, pose, window, jnp.float32(0), echo, law, quality, ())
    return Problem(part, measured, subject, jnp.array(MARGIN))


@partial(jax.jit, static_argnames="size")
def _chosen(image: Array, mask: Array, pose: Pose, mesh: Mesh, sonar: Sonar, *, size: WindowSize) -> tuple[Array, ...]:
    """The numbers of the echo law that fits best, and the weight of each pixel of the window (range, beam), 1 or 0."""
    problem = _problem(image, mask, pose, nominal_law(), mesh, sonar, mesh, size)
    layers = render_layers(problem.subject, jnp.zeros(0))
    nothing = jnp.zeros(())
    search = Search(nothing, nothing, nothing, nothing, problem.margin)
    _, law = best_template(problem, layers, search)
    return law.gain, law.noise, law.exponent, problem.weight * box_around(semantic_template(layers), problem.margin)


@partial(jax.jit, static_argnames="size")
def _by_vertices(
    image: Array, mask: Array, pose: Pose, law: tuple[Array, ...], weight: Array, mesh: Mesh, sonar: Sonar,
    vertices: Array, sigma: Array, *, size: WindowSize,
) -> tuple[Array, Array]:  # fmt: skip
    """1 − NCC of the blurred template and frame, and its gradient by the vertices (vertex, 3)."""
    blur = make_blur((size.shape[0], size.shape[1]), sigma)
    bounces = jnp.array([0.0, BOUNCE])  # on one way, and on both; not fitted

    def cost(positions: Array) -> Array:
        bent = mesh.with_vertices(positions)
        problem = _problem(image, mask, pose, EchoLaw(*law), bent, sonar, mesh, size)
        return misfit(problem._replace(weight=weight), blur, bounces, reverse=True)

    value, slope = jax.value_and_grad(cost)(vertices)
    return value, jnp.nan_to_num(slope)
