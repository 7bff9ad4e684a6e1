"""`refine_pose`: any of a pose's six numbers, by differentiating the rendered template (beyond the paper)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.engine import PLAIN, Engine
from sonarjax.exact import full_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, image_array, number_array
from sonarjax.records import record, static
from sonarjax.refine.config import SLACK_M, RefineConfig
from sonarjax.refine.free import BOUNCES, ON_FLOOR, check_free, displacements, pose_at, trusts, wrapped
from sonarjax.refine.implicit import attach, hessian, is_minimum, without_gradient
from sonarjax.refine.objective import Problem, crop_score, levelled, make_blur
from sonarjax.refine.solver import INSIDE, SETTLED_SHARE, STATIONARY_SHARE, Search, Solution, begun, coarse_to_fine
from sonarjax.refine.template import BOUNCE_BOUNDS, VIEWS, Drawn, Subject, nominal_law
from sonarjax.refine.uncertainty import Observability, error_covariance, normal_equations, observability, prior_std
from sonarjax.refine.views import Job, check_views, in_view, refine_jointly
from sonarjax.render import RenderQuality, WindowSize, place_window, plan_window
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS, leaning_room
from sonarjax.render.room import with_lean_room
from sonarjax.render.simulate import one_by_one
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.limits import check_pose
from sonarjax.sonar import Sonar
from sonarjax.sonar.image import check_finite


@record
class PoseEstimate:
    """A refined pose. Every field has the batch shape of the starts, and none is ever NaN if the start is finite."""

    pose: Pose
    """All six numbers [m, rad]; yaw in [0, 2π). Numbers that are not free, or not observable, are those of the
    start.
    """
    covariance: Float[Array, "*batch free free"]
    """Covariance of the free numbers' errors [m, rad], in the order of `free`, given the right basin.

    It comes from the curvature and the residuals of each beam. On labels of a render the standard deviations are as
    large as the errors; on a sonar's frames they are too small, and `PoseFinder` widens them. A number that is not
    observable has the covariance of its bounds, which also adds to the errors of the others. Infinite if nothing could
    be compared.
    """
    score: Float[Array, "*batch"]
    """NCC (eq. 4) of the refined template, over its own box with the bank's margin; 0 if there is no template."""
    start_score: Float[Array, "*batch"]
    """NCC of the start's template, over its own box with the same margin."""
    converged: Bool[Array, "*batch"]
    """True if the last step was small and the result lies inside its bounds; False where the frame is constant."""
    determined: Bool[Array, "*batch"]
    """True if the result was polished to an interior minimum, and so has a derivative; always False without
    polishing.
    """
    observable: Bool[Array, "*batch free"]
    """For each free number, whether the frame determines it: at most half of its prior's standard deviation is
    left, the prior being that it lies anywhere within its bounds. `refine_pose` puts the others back to their
    start.
    """
    singular_values: Float[Array, "*batch free"]
    """Singular values of what the frame says about the free numbers, in units of these priors, largest first."""
    free: tuple[str, ...] = static(default=ON_FLOOR)
    """The free numbers, in the order yaw, x, y, z, roll, pitch."""

    @property
    def std(self) -> Float[Array, "*batch free"]:
        """Standard deviations (free) of the free numbers [m, rad], for each pose of the batch."""
        return jnp.sqrt(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))


def refine_pose(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    start: Pose,
    *,
    free: Sequence[str] = ON_FLOOR,
    mask: Any = None,
    config: RefineConfig = RefineConfig(),
    window: WindowSize | None = None,
    sonar_poses: Pose | None = None,
    engine: Engine = PLAIN,
) -> PoseEstimate:
    """Refine the free numbers of a pose by Levenberg–Marquardt on 1 − NCC of the rendered template.

    A free number that the frame does not determine (`observable`) is put back to its start, and the others are refined
    once more without it. Provided that `config.polish` is not 0, the pose has reverse-mode derivatives by image, mesh
    vertices and sonar (see `implicit`); they are zero where `determined` is False.

    Args:
        image: Semantic map (range, beam), or any grey image in which highlight is brighter than shadow. It may have a
            leading batch axis; with `sonar_poses` it is (view, range, beam).
        mesh: The object.
        sonar: The sonar.
        start: Where to start [m, rad]: one pose for each frame of the batch. With one more axis it holds several
            hypotheses for each frame, and the estimate keeps that axis.
        free: Any of yaw, x, y, z, roll and pitch. The others stay as in the start.
        mask: True where a pixel was measured, in the image's shape; None means everywhere.
        config: How to search.
        window: Size of the window to render. By default it is planned if nothing is traced; a traced call renders the
            complete frame, so plan it beforehand with `plan_refinement`. In a traced call of an object that leans,
            the mesh must have room for all triangles that a slice meets (`Mesh.with_room`).
        sonar_poses: Makes the frames views of one object at rest: x, y [m] and yaw [rad] of each sonar (view,) in a
            common ground frame. `start`, a single pose or an axis of hypotheses, and the estimate are in that frame.
            The views are refined jointly on the host: nothing may be traced, and nothing is `determined`.
        engine: Runs the compiled functions.

    Returns:
        The estimate, in the batch shape of `start`.

    Raises:
        SonarjaxError: An argument is of another kind, the shapes do not fit the sonar, a measured pixel is not finite,
            or `free` is empty or has an unknown or repeated name. For views also if there is not one of `sonar_poses`
            for each, one of them leans, or something is traced.
    """
    names = check_free(free)
    if sonar_poses is not None:
        return _refine_views(image, mesh, sonar, start, names, mask, config, window, sonar_poses, engine)
    return search_pose(image, mesh, sonar, start, mask, config, window, engine, free=names, hold=True)[0]


def _refine_views(
    images: Any, mesh: Mesh, sonar: Sonar, start: Pose, free: tuple[str, ...], mask: Any, config: RefineConfig,
    window: WindowSize | None, sonar_poses: Pose, engine: Engine,
) -> PoseEstimate:  # fmt: skip
    """`refine_pose` for several views."""
    if is_traced(images, mask, mesh, sonar, start, sonar_poses):
        raise SonarjaxError("sonar_poses: expected no traced values, because views are refined on the host")
    _check_given(mesh, sonar, start, config)
    check_kind(engine, Engine, "engine")
    images = np.asarray(image_array(images, "image"), np.float32)
    sonars = check_views(images, sonar_poses, start, sonar)
    weights = np.asarray(np.ones(images.shape) if mask is None else number_array(mask, "mask"), np.float32)
    if weights.shape != images.shape:
        raise SonarjaxError(f"mask: expected the images' shape {images.shape}, got {weights.shape}")
    check_finite(images, weights, "image")
    images = images if mask is None else levelled(images, weights, np)
    starts = jax.tree.map(lambda v: np.atleast_1d(np.asarray(v)), start)
    places = [in_view(starts, one) for one in sonars]
    around = jax.tree.map(lambda *v: np.concatenate(v), *places)
    size = _window_within(sonar, window) or plan_refinement(mesh, sonar, around, config, free)
    roomy = with_lean_room(mesh, around, sonar)
    job = Job(images, weights, roomy, sonar, sonars, free, config, size, engine)
    found = [refine_jointly(job, Pose(**{n: v[k] for n, v in vars(starts).items()})) for k in range(len(starts.x))]

    def stacked(values: Sequence[Any]) -> Any:
        joined = np.stack([np.asarray(v) for v in values])
        return jax.device_put(joined.reshape(start.shape + joined.shape[1:]))

    pose = jax.tree.map(lambda *v: stacked(v), *(one.pose for one in found))
    fields = ("covariance", "score", "start_score", "converged", "observable", "singular_values")
    numbers = {name: stacked([getattr(one, name) for one in found]) for name in fields}
    turned = replace(pose, yaw=jax.device_put(wrapped(np.asarray(pose.yaw))))
    nothing = stacked([np.bool_(False)] * len(found))
    return PoseEstimate(turned, determined=nothing, free=free, **numbers)


def search_pose(
    image: Any, mesh: Mesh, sonar: Sonar, start: Pose, mask: Any, config: RefineConfig, window: WindowSize | None,
    engine: Engine, *, free: tuple[str, ...], hold: bool,
) -> tuple[PoseEstimate, Drawn]:  # fmt: skip
    """As `refine_pose`, together with the templates at the solutions.

    `hold` puts back numbers that the frame does not determine. Without it this is not checked, and nothing counts as
    observable.
    """
    _check_given(mesh, sonar, start, config)
    check_kind(engine, Engine, "engine")
    traced = is_traced(image, mask, mesh, sonar, start)
    array = jnp if traced else np  # NumPy slices and joins on the host without compiling anything
    image = array.asarray(image if traced else image_array(image, "image"), np.float32)
    if image.ndim not in (2, 3) or image.shape[-2:] != sonar.shape:
        raise SonarjaxError(f"image: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    given = array.ones(image.shape, np.float32) if mask is None else mask
    weight = array.asarray(given if traced else number_array(given, "mask"), np.float32)
    if weight.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {weight.shape}")
    check_finite(image, weight, "image")
    image = image if mask is None else levelled(image, weight, array)
    frames, axes = image.ndim - 2, start.shape
    if len(axes) not in (frames, frames + 1) or axes[:frames] != image.shape[:frames]:
        raise SonarjaxError(f"start: expected one pose (or one axis of poses) for each image, got shape {axes}")
    size = _window_within(sonar, window) or plan_refinement(mesh, sonar, start, config, free)
    mesh = mesh if traced else with_lean_room(mesh, start, sonar)
    # Flatten frames and starts to one list.
    starts = jax.tree.map(lambda v: array.asarray(v).reshape(-1), start)
    count = math.prod(axes)
    which = np.arange(count) // max(count // max(math.prod(axes[:frames]), 1), 1)
    images, weights = (v.reshape(-1, *sonar.shape) for v in (image, weight))
    settings = _settings(config, free)
    static = _static(config, size, free, hold)
    if traced or (axes and jax.default_backend() != "cpu"):  # an accelerator refines all starts at once
        found = engine.run(_refine_all, images[which], weights[which], mesh, sonar, starts, *settings, **static)
        return jax.tree.map(lambda v: v.reshape((*axes, *v.shape[1:])), found)

    def job(k: int) -> tuple[PoseEstimate, Drawn]:
        begin = jax.tree.map(lambda v: v[k], starts)
        return engine.run(_refine, images[which[k]], weights[which[k]], mesh, sonar, begin, *settings, **static)

    if not axes:  # nothing to stack, which takes milliseconds
        return job(0)
    found = engine.map(lambda k: jax.tree.map(np.asarray, job(k)), range(count))
    return jax.tree.map(lambda *v: jax.device_put(np.stack(v).reshape((*axes, *v[0].shape))), *found)


def _check_given(mesh: Any, sonar: Any, start: Any, config: Any) -> None:
    """Raise a SonarjaxError where one of them is something else, where the start is none or not finite, and where mesh
    or sonar are several.
    """
    check_kind(mesh, Mesh, "mesh")
    check_kind(sonar, Sonar, "sonar")
    check_kind(start, Pose, "start")
    check_kind(config, RefineConfig, "config")
    check_pose(start)
    if 0 in start.shape:
        raise SonarjaxError(f"start: expected at least one pose, got shape {start.shape}")
    for name, number in (("mesh", mesh.radius), ("sonar", sonar.tilt)):
        if np.ndim(number):
            raise SonarjaxError(f"{name}: expected a single one, got a batch of shape {np.shape(number)}: use jax.vmap")


def _window_within(sonar: Sonar, window: WindowSize | None) -> WindowSize | None:
    """The window. Raises a SonarjaxError if it is no `WindowSize`, or larger than the frame."""
    if window is not None:
        check_kind(window, WindowSize, "window")
    if window is not None and any(n > most for n, most in zip(window.shape, sonar.shape, strict=True)):
        raise SonarjaxError(f"window: expected at most the frame's {sonar.shape} pixels, got {window.shape}")
    return window


def prepare_refinement(
    mesh: Mesh, sonar: Sonar, start: Pose, config: RefineConfig, engine: Engine, window: WindowSize | None = None,
    free: tuple[str, ...] = ON_FLOOR,
) -> None:  # fmt: skip
    """Let an engine compile the refinement of one start in frames of a sonar, before there is a frame.

    The compiled code serves `refine_yaw`, `refine_starts` and `quick_evidence`. It does not serve `refine_pose`, which
    also puts back the numbers that a frame does not determine.

    Args:
        mesh: The object.
        sonar: The sonar.
        start: One start [m, rad]. Its numbers matter only where the window is planned for it.
        config: How refinement will search.
        engine: Compiles, and later runs the compiled functions.
        window: Size of the window to render; None plans it for this start.
        free: The free numbers of the pose, in the order yaw, x, y, z, roll, pitch.
    """
    image = np.zeros(sonar.shape, np.float32)
    begin = jax.tree.map(np.asarray, start)
    size = window or plan_refinement(mesh, sonar, start, config, free)
    settings = _settings(config, free)
    engine.prepare(_refine, image, image, mesh, sonar, begin, *settings, **_static(config, size, free, False))


def is_traced(*trees: Any) -> bool:
    """True if a leaf of these pytrees is traced: a function around this one is being compiled or differentiated."""
    return any(isinstance(v, jax.core.Tracer) for v in jax.tree.leaves(trees))


def plan_refinement(
    mesh: Mesh, sonar: Sonar, start: Pose, config: RefineConfig, free: Sequence[str] = ON_FLOOR
) -> WindowSize:
    """Plan the size of the window that refinement renders; runs on the host.

    The window holds the object and its shadow at each start and any yaw, with `SLACK_M` around. It has room for the
    lift and lean of the starts, and for as much more as the bounds of `free` z, roll and pitch allow. The object itself
    touches no more than the planned beams as long as x and y stay within their bounds.

    Args:
        mesh: The object.
        sonar: The sonar.
        start: One start or several [m, rad], of any shape.
        config: Its bounds limit how far refinement moves the object.
        free: The free numbers of the pose.

    Returns:
        Size of the window. It is the complete frame if the starts, the mesh or the sonar are traced.

    Raises:
        SonarjaxError: An argument is of another kind.
    """
    _check_given(mesh, sonar, start, config)
    if is_traced(start, sonar, mesh):
        return WindowSize(sonar.shape, sonar.n_beams)
    bounds = [config.bound(name) if name in free else 0.0 for name in ("z", "roll", "pitch")]
    room = _room(mesh, jax.tree.map(np.asarray, start), *bounds)
    ground = np.hypot(np.asarray(start.x), np.asarray(start.y))
    nearest = max(float(ground.min()) - max(config.bounds[1:]), 0.0)
    shapes = [plan_window(room, sonar, float(g), SLACK_M).shape for g in (ground.min(), ground.max())]
    rows, columns = max(s[0] for s in shapes), max(s[1] for s in shapes)
    # Sizes grow in coarse steps, because compiling the solver for another size costs far more than a few empty pixels.
    shape = min(-(-rows // 128) * 128, sonar.n_ranges), min(-(-columns // 32) * 32, sonar.n_beams)
    beams = plan_window(room, sonar, nearest).object_columns
    assert beams is not None
    return WindowSize(shape, min(-(-beams // 16) * 16, sonar.n_beams))


def _room(mesh: Mesh, start: Pose, lift: Any, roll: Any, pitch: Any) -> Mesh:
    """The mesh with the extent that it has at `start`, changed by at most this much in z [m], roll and pitch [rad]."""
    return leaning_room(mesh, start.z.max() + lift, (abs(start.roll) + roll).max(), (abs(start.pitch) + pitch).max())


def _static(config: RefineConfig, size: WindowSize, free: tuple[str, ...], hold: bool) -> dict[str, Any]:
    return {"size": size, "quality": config.quality, "polished": config.polish > 0, "free": free, "hold": hold}


def _settings(config: RefineConfig, free: tuple[str, ...]) -> tuple[Any, ...]:
    """A config's numbers as traced values, so that searches of all kinds share compiled code."""
    bounces = [BOUNCE_BOUNDS[config.template]] * len(BOUNCES)
    bounds = [*((-config.bound(name), config.bound(name)) for name in free), *bounces]
    search = Search(
        bounds=np.asarray(bounds, np.float32).T,
        blurs=np.asarray(config.blurs, np.float32),
        iterations=np.int32(config.iterations),
        polish=np.int32(config.polish),
        score_margin=np.array([MARGIN_BINS, MARGIN_BEAMS], np.int32),
    )
    return search, np.float32(config.sharpness), np.int32(VIEWS[config.template]), config.box_margin


@partial(jax.jit, static_argnames=("size", "quality", "polished", "free", "hold"))
def _refine_all(
    images: Array, weights: Array, mesh: Mesh, sonar: Sonar, starts: Pose, *settings: Any, **static: Any
) -> tuple[PoseEstimate, Drawn]:
    """`_refine` of each start (start,) in its image (start, range, beam)."""
    jobs = images, weights, starts
    return one_by_one(lambda job: _refine(*job[:2], mesh, sonar, job[2], *settings, **static), jobs)


@partial(jax.jit, static_argnames=("size", "quality", "polished", "free", "hold"))
@full_precision  # jaxopt's products too
def _refine(
    image: Array, weight: Array, mesh: Mesh, sonar: Sonar, start: Pose, search: Search, sharpness: Array, views: Array,
    margin: Array, *, size: WindowSize, quality: RenderQuality, polished: bool, free: tuple[str, ...],
    hold: bool,
) -> tuple[PoseEstimate, Drawn]:  # fmt: skip
    """Refine one start in one image: cut out the window, search, and attach the derivative."""
    count, away = len(free), jnp.asarray(trusts(free))
    most = [search.bounds[1][free.index(name)] if name in free else 0.0 for name in ("z", "roll", "pitch")]
    window = without_gradient(place_window(size, _room(mesh, start, *most), sonar, start.x, start.y, SLACK_M))
    part, measured = (jax.lax.dynamic_slice(v, (window.row, window.column), size.shape) for v in (image, weight))
    start = without_gradient(start)  # a minimum does not depend on it
    subject = Subject(mesh, sonar, start, window, sharpness, views, nominal_law(), quality, free)
    problem = Problem(part, measured, subject, margin)
    fixed = without_gradient(problem)
    solution, covariance, told, held = _searched(fixed, search, hold)
    best, bounds = solution.best, jnp.where(held, 0.0, search.bounds)
    score = crop_score(fixed.image, best.template, solution.weight, search.score_margin)
    # The last step of a settled search is small, so it is taken without another render.
    left = jnp.abs(best.remaining)
    last = jnp.where(left.max() < SETTLED_SHARE, best.remaining * away, 0.0)
    step = jnp.clip(best.step + last, *bounds)
    inside = jnp.abs(step) < INSIDE * bounds[1]
    converged = (inside | held)[:count].all() & (left[:count].max() < SETTLED_SHARE) & jnp.isfinite(best.cost)
    converged &= score != 0  # that of a constant frame
    determined = jnp.zeros((), bool)
    if polished:
        fitted = _as_solved(problem, solution)
        blur = make_blur(size.shape, search.blurs[-1])
        movable = inside & (bounds[1] > 0) & (step > bounds[0])
        curvature = hessian(without_gradient(fitted), blur, step)
        settled = converged & (left[:count].max() < STATIONARY_SHARE)
        determined = settled & is_minimum(curvature, movable, jnp.asarray(displacements(free)))
        step = attach(step, fitted, blur, curvature, movable, determined)
    pose = pose_at(start, step, free)
    estimate = PoseEstimate(
        pose=replace(pose, yaw=wrapped(pose.yaw)),
        covariance=covariance[:count, :count],
        score=jnp.nan_to_num(score),
        start_score=jnp.nan_to_num(solution.start_score),
        converged=converged,
        determined=determined,
        observable=told.observable[:count],
        singular_values=told.singular_values,
        free=free,
    )
    row, column = jnp.asarray(window.row), jnp.asarray(window.column)
    drawn = Drawn(best.template, best.labels, row, column, solution.views, solution.law, best.step[count:])
    return estimate, without_gradient(drawn)


class _Pass(NamedTuple):
    """What one search hands to the next."""

    number: Int[Array, ""]
    held: Bool[Array, "step"]  # numbers that stay at their start
    solution: Solution
    covariance: Float[Array, "step step"]
    told: Observability


def _searched(
    problem: Problem, search: Search, hold: bool
) -> tuple[Solution, Float[Array, "step step"], Observability, Bool[Array, "step"]]:
    """The search's solution, its covariance, what is observable, and which numbers were held at their start.

    With `hold`, the search is repeated without numbers that turn out not to be observable. It is written as a loop, so
    that the renderer is compiled once.
    """
    prior, count = prior_std(jnp.asarray(search.bounds)), len(problem.subject.free)
    nothing = Observability(jnp.zeros(len(prior), bool), jnp.zeros(count))

    def once(state: _Pass) -> _Pass:
        solution = coarse_to_fine(problem, search._replace(bounds=jnp.where(state.held, 0.0, search.bounds)))
        normal, known = (
            normal_equations(problem.image, solution.weight, solution.best),
            jnp.isfinite(solution.best.cost),
        )
        covariance = error_covariance(normal, prior, state.held, known)
        if not hold:
            return state._replace(solution=solution, covariance=covariance)
        # Observability is judged in the first search, in which nothing is held.
        first, here = state.number == 0, observability(normal, prior, known, count)
        told = jax.tree.map(lambda new, old: jnp.where(first, new, old), here, state.told)
        lost = first & ~told.observable & (jnp.arange(len(prior)) < count)
        return _Pass(state.number + 1, state.held | lost, solution, covariance, told)

    def goes_on(state: _Pass) -> Bool[Array, ""]:
        return (state.number == 0) | ((state.number == 1) & state.held.any())

    size, held = len(prior), jnp.zeros(len(prior), bool)
    first = _Pass(jnp.zeros((), jnp.int32), held, begun(problem, search), jnp.zeros((size, size)), nothing)
    last = jax.lax.while_loop(goes_on, once, first) if hold else once(first)
    return last.solution, last.covariance, last.told, last.held


def _as_solved(problem: Problem, solution: Solution) -> Problem:
    """The problem with pixels and template as the search chose them; its objective no longer depends on the start."""
    return problem._replace(
        weight=solution.weight, subject=replace(problem.subject, views=solution.views, law=solution.law)
    )
