"""One pose from several views: joint Levenberg–Marquardt over frames of one object at rest from known sonar poses.

Each view's normal equations are computed in its own sonar's frame and transformed to the common frame, which for planar
sonar poses is a constant matrix. Each view has its own bounce energies. Everything except the renders is small and
stays on the host.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.engine import Engine
from sonarjax.exact import full_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, image_array
from sonarjax.refine.config import SLACK_M, RefineConfig
from sonarjax.refine.free import ALL, BOUNCES, trusts
from sonarjax.refine.objective import ROW_STRIDE, Problem, box_around, crop_score, make_blur, normalised
from sonarjax.refine.solver import INSIDE, SETTLED_SHARE, Found, Search, best_template
from sonarjax.refine.template import (
    BOUNCE_BOUNDS,
    VIEWS,
    EchoLaw,
    Subject,
    layers_with_slope,
    nominal_law,
    paint_with_slope,
    semantic_template,
    with_slopes,
)
from sonarjax.refine.uncertainty import Normal, error_covariance, normal_equations, observability, prior_std
from sonarjax.render import RenderQuality, WindowSize, place_window
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS, leaning_room
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

LEAST_GAIN = 2e-4
"""A step that lowers the cost by a smaller share is the last."""
MOST_DAMPING = 1e3
"""At this damping the search for a better step is given up."""
FARTHEST_SONAR_M = 1e4
"""Largest coordinate of a sonar's pose [m]. Poses are kept in float32, which resolves 1 mm there."""


class Fixed(NamedTuple):
    """What a search keeps of a view after its first render."""

    weight: Any
    """1 where a pixel counts, in the window (range, beam)."""
    views: Any
    """Which template is fitted, see `VIEWS`."""
    law: Any
    """How the echo is stored: gain, noise and exponent."""


class View(NamedTuple):
    """One view's contribution at a point."""

    hessian: Any
    """JᵀJ for the six numbers in the view's frame and the energies of the bounces (8, 8)."""
    gradient: Any
    """Jᵀ·residual (8,)."""
    cost: Any
    """1 − NCC of the blurred images."""
    score: Any
    """NCC (eq. 4) of the template, over its own box with the bank's margin."""
    information: Any
    """As in `Normal`, without blur (8, 8)."""
    noise: Any
    """As in `Normal` (8, 8)."""


class Joint(NamedTuple):
    """The result of a joint search."""

    pose: Pose
    """The pose in the common frame."""
    covariance: np.ndarray
    """Covariance of the free numbers' errors (free, free)."""
    score: float
    """Mean NCC of the views."""
    start_score: float
    """The same at the start."""
    converged: bool
    """True if the last step was small and inside the bounds."""
    observable: np.ndarray
    """Whether the frames determine each free number (free,)."""
    singular_values: np.ndarray
    """Singular values of what they say (free,), largest first."""


@partial(jax.jit, static_argnames=("size", "quality"))
@full_precision
def linearise(
    image: Array, weight: Array, mesh: Mesh, sonar: Sonar, place: Pose, room: tuple[Array, Array, Array], pose: Pose,
    bounces: Array, sigma: Array, sharpness: Array, margin: Array, fixed: tuple[Any, ...], fresh: Array, *,
    size: WindowSize, quality: RenderQuality,
) -> tuple[tuple[Array, ...], tuple[Any, ...]]:  # fmt: skip
    """The fields of a `View` at `pose` in the view's frame, and those of its `Fixed`, chosen anew if `fresh`.

    The window lies around `place`, and has room for the lift [m], roll and pitch [rad] in `room`.
    """
    roomy = leaning_room(mesh, *room)
    window = place_window(size, roomy, sonar, place.x, place.y, SLACK_M)
    part, measured = (jax.lax.dynamic_slice(v, (window.row, window.column), size.shape) for v in (image, weight))
    kept = Fixed(fixed[0], fixed[1], EchoLaw(*fixed[2]))
    painted = jnp.where(fresh & (kept.views != VIEWS["semantic"]), VIEWS["echo"], kept.views)
    subject = Subject(mesh, sonar, pose, window, sharpness, painted, kept.law, quality, ALL)
    layers, slopes = layers_with_slope(subject, jnp.zeros(len(ALL) + len(BOUNCES)))
    score_margin = jnp.array([MARGIN_BINS, MARGIN_BEAMS])
    nothing = jnp.zeros(())
    problem = Problem(part, measured, replace(subject, views=kept.views), margin)
    search = Search(nothing, nothing, nothing, nothing, score_margin)
    choose = fresh & (kept.views != VIEWS["semantic"])
    views, law = jax.lax.cond(
        choose, partial(best_template, problem, layers, search), lambda: (jnp.asarray(kept.views), kept.law)
    )
    drawn, slope = paint_with_slope(replace(subject, views=views, law=law), layers, slopes, bounces)
    inside = jnp.where(fresh, measured * box_around(semantic_template(layers), margin), kept.weight)
    rows, blur = inside[::ROW_STRIDE], make_blur((size.shape[0], size.shape[1]), sigma)
    seen = normalised(blur(part * inside), rows)
    blurred, *changes = blur(jnp.concatenate([drawn[None], slope]) * inside)
    fitted, jacobian = with_slopes(lambda drawn: normalised(drawn, rows), (blurred,), (jnp.stack(changes),))
    off = fitted - seen
    cost = (off**2).sum() / 2
    comparable = jnp.any(drawn * inside != 0) & jnp.isfinite(cost)
    cost = jnp.where(comparable, cost, jnp.inf)
    found = Found(cost, jnp.zeros(()), drawn, drawn, slope, jnp.zeros(()))
    normal = normal_equations(part, inside, found)
    numbers = (
        jnp.einsum("irb,jrb->ij", jacobian, jacobian), jnp.einsum("irb,rb->i", jacobian, off), cost,
        crop_score(part, drawn, measured, score_margin), *normal,
    )  # fmt: skip
    # Plain tuples, because `CpuEngine` stores compiled code in files and does not know the types of this file.
    return tuple(jnp.nan_to_num(v, posinf=jnp.inf) for v in numbers), (
        inside,
        views,
        (law.gain, law.noise, law.exponent),
    )


class Job(NamedTuple):
    """What stays the same during a joint search; the window lies around the start."""

    images: np.ndarray
    """Frames (view, range, beam)."""
    weights: np.ndarray
    """1 where a pixel was measured (view, range, beam)."""
    mesh: Mesh
    """The object."""
    sonar: Sonar
    """The sonar, the same in all views."""
    sonar_poses: np.ndarray
    """x, y [m] and heading [rad] of each sonar in the common frame (view, 3)."""
    free: tuple[str, ...]
    """The free numbers."""
    config: RefineConfig
    """How to search."""
    size: WindowSize
    """The window that is rendered."""
    engine: Engine
    """Runs the compiled functions."""


class _Sum(NamedTuple):
    """The normal equations of all views in the common frame: the free numbers, then each view's bounces."""

    hessian: np.ndarray
    gradient: np.ndarray
    cost: float
    score: float
    normal: Normal


def refine_jointly(job: Job, start: Pose) -> Joint:
    """The pose in the common frame that fits all views best, from one `start`; numbers that are not observable
    stay there.
    """
    held = np.zeros(len(job.free), bool)
    found, told = _search(job, start, held)
    if not told[0].all():
        return _search(job, start, ~told[0])[0]._replace(observable=told[0], singular_values=told[1])
    return found


def _search(job: Job, start: Pose, held: np.ndarray) -> tuple[Joint, tuple[np.ndarray, np.ndarray]]:
    """One search with some numbers held: its result, and which numbers are observable, with singular values."""
    config, count, energies = job.config, len(job.free), len(BOUNCES) * len(job.images)
    bounds = np.array([config.bound(name) for name in job.free])
    low, high = BOUNCE_BOUNDS[config.template]
    most = np.concatenate([np.where(held, 0.0, bounds), np.full(energies, high)])
    least = np.concatenate([-most[:count], np.full(energies, low)])
    trust = np.array([*trusts(job.free)[:count], *[bounce.trust for bounce in BOUNCES] * len(job.images)])
    evaluate = _evaluator(job, start)
    point, begun, settled = np.clip(np.zeros(count + energies), least, most), None, False
    for sigma in config.blurs:
        here, damping = evaluate(point, sigma), 1e-3
        begun = here.score if begun is None else begun
        for _ in range(config.iterations + (config.polish if sigma == config.blurs[-1] else 0)):
            step = _step(here, most > least, trust, damping)
            target = np.clip(point + step, least, most)
            there = evaluate(target, sigma)
            moved, gain = float(np.abs((target - point) / trust).max()), here.cost - there.cost
            if gain > 0:
                point, here, damping = target, there, max(damping / 5, 1e-6)
                settled = moved < SETTLED_SHARE or gain < LEAST_GAIN * here.cost
            else:
                damping = max(damping * 10, 1e-2)
                settled = moved < SETTLED_SHARE or damping > MOST_DAMPING
            if settled:
                break
    prior = jnp.asarray(prior_std(jnp.asarray(_box(bounds, low, high, energies))), jnp.float32)
    known, all_held = jnp.isfinite(here.cost), jnp.asarray(np.concatenate([held, np.zeros(energies, bool)]))
    told = observability(here.normal, prior, known, count)
    covariance = np.asarray(error_covariance(here.normal, prior, all_held, known))[:count, :count]
    inside = np.abs(point[:count]) < INSIDE * bounds
    found = Joint(
        _moved(start, job.free, point), covariance, here.score, float(begun or 0.0),
        bool((inside | held).all() and settled and np.isfinite(here.cost)),
        np.asarray(told.observable)[:count], np.asarray(told.singular_values),
    )  # fmt: skip
    return found, (found.observable, found.singular_values)


def _box(bounds: np.ndarray, low: float, high: float, energies: int) -> np.ndarray:
    return np.stack([np.concatenate([-bounds, [low] * energies]), np.concatenate([bounds, [high] * energies])])


def _step(here: _Sum, movable: np.ndarray, trust: np.ndarray, damping: float) -> np.ndarray:
    """The damped Gauss–Newton step of the movable numbers, in units of the trust region and shortened to it."""
    scaled = (here.hessian * trust[:, None] * trust)[np.ix_(movable, movable)]
    ridge = damping * np.diag(np.diag(scaled)) + 1e-7 * (1 + np.trace(scaled)) * np.eye(len(scaled))
    share = np.zeros(len(trust))
    if np.isfinite(scaled).all() and np.isfinite(here.gradient).all():
        share[movable] = -np.linalg.solve(scaled + ridge, (here.gradient * trust)[movable])
    return trust * share / max(1.0, np.abs(share).max(initial=0.0))


def _evaluator(job: Job, start: Pose) -> Callable[[np.ndarray, float], _Sum]:
    """A function of a point (free numbers, bounces) and a blur [range bins] that gives the sum over all views."""
    config, count = job.config, len(job.free)
    places = [in_view(start, sonar) for sonar in job.sonar_poses]
    at = {"z": float(start.z), "roll": abs(float(start.roll)), "pitch": abs(float(start.pitch))}
    space = tuple(np.float32(v + (config.bound(name) if name in job.free else 0.0)) for name, v in at.items())
    law = tuple(np.asarray(v) for v in jax.tree.leaves(nominal_law()))
    fixed: list[Any] = [(np.zeros(job.size.shape, np.float32), np.int32(VIEWS[config.template]), law)] * len(places)
    fresh = [True] * len(places)
    shows = [True] * len(places)  # a view in which the start is out of sight says nothing

    def evaluate(point: np.ndarray, sigma: float) -> _Sum:
        pose = _moved(start, job.free, point)

        def one(k: int) -> View:
            numbers, kept = job.engine.run(
                linearise, job.images[k], job.weights[k], job.mesh, job.sonar, places[k], space,
                in_view(pose, job.sonar_poses[k]), _bounces_of(point, count, k), np.float32(sigma),
                np.float32(config.sharpness), config.box_margin, fixed[k], np.bool_(fresh[k]), size=job.size,
                quality=config.quality,
            )  # fmt: skip
            view = View(*(np.asarray(v, float) for v in numbers))
            if fresh[k]:
                fixed[k], fresh[k] = jax.tree.map(np.asarray, kept), False
                shows[k] = bool(np.isfinite(view.cost))
            return view

        parts = job.engine.map(one, range(len(places)))
        return _summed(parts, job.free, job.sonar_poses, shows if any(shows) else [True] * len(shows))

    return evaluate


def _summed(parts: Sequence[View], free: tuple[str, ...], sonar_poses: np.ndarray, shows: Sequence[bool]) -> _Sum:
    """The sum over the views that show something; the others still have bounces of their own."""
    count, views = len(free), len(parts)
    size = count + len(BOUNCES) * views
    hessian, information, noise = (np.zeros((size, size)) for _ in range(3))
    gradient = np.zeros(size)
    for k in np.flatnonzero(shows).tolist():
        part = parts[k]
        across = np.zeros((len(ALL) + len(BOUNCES), size))
        across[: len(ALL), :count] = turned(sonar_poses[k, 2])[:, [ALL.index(name) for name in free]]
        across[len(ALL) :, count + len(BOUNCES) * k : count + len(BOUNCES) * (k + 1)] = np.eye(len(BOUNCES))
        gradient += across.T @ part.gradient
        for total, mine in ((hessian, part.hessian), (information, part.information), (noise, part.noise)):
            total += across.T @ mine @ across
    normal = Normal(jnp.asarray(information, jnp.float32), jnp.asarray(noise, jnp.float32))
    seen = [part for part, used in zip(parts, shows, strict=True) if used]
    cost, score = float(sum(part.cost for part in seen)), float(np.mean([part.score for part in seen]))
    return _Sum(hessian, gradient, cost if np.isfinite(cost) else np.inf, score, normal)


def _bounces_of(point: np.ndarray, count: int, view: int) -> np.ndarray:
    """The energies of a view's bounces, which follow the `count` free numbers of a point."""
    first = count + len(BOUNCES) * view
    return point[first : first + len(BOUNCES)].astype(np.float32)


def turned(heading: float) -> Float[np.ndarray, "number number"]:
    """Derivatives (number, number) of the six numbers in the frame of a sonar at `heading` [rad] by those in
    the common frame.
    """
    matrix, x, y = np.eye(len(ALL)), ALL.index("x"), ALL.index("y")
    c, s = np.cos(heading), np.sin(heading)
    matrix[np.ix_([x, y], [x, y])] = [[c, s], [-s, c]]
    return matrix


def in_view(pose: Pose, sonar: np.ndarray) -> Pose:
    """Transform a pose from the common frame to the ground frame of a sonar.

    Args:
        pose: Poses in the common frame [m, rad], of any shape.
        sonar: x, y [m] and heading [rad] of the sonar in the common frame (3,).

    Returns:
        The poses in the sonar's ground frame [m, rad]; z, roll and pitch stay the same.
    """
    x, y = np.asarray(pose.x) - sonar[0], np.asarray(pose.y) - sonar[1]
    c, s = np.cos(sonar[2]), np.sin(sonar[2])
    return replace(pose, **_fields(x=c * x + s * y, y=c * y - s * x, yaw=np.asarray(pose.yaw) - sonar[2]))


def in_common(pose: Pose, sonar: np.ndarray) -> Pose:
    """Transform a pose from the ground frame of a sonar to the common frame.

    Args:
        pose: Poses in the sonar's ground frame [m, rad], of any shape.
        sonar: x, y [m] and heading [rad] of the sonar in the common frame (3,).

    Returns:
        The poses in the common frame [m, rad]; z, roll and pitch stay the same.
    """
    x, y = np.asarray(pose.x), np.asarray(pose.y)
    c, s = np.cos(sonar[2]), np.sin(sonar[2])
    return replace(
        pose, **_fields(x=c * x - s * y + sonar[0], y=c * y + s * x + sonar[1], yaw=np.asarray(pose.yaw) + sonar[2])
    )


def _moved(start: Pose, free: tuple[str, ...], point: np.ndarray) -> Pose:
    return replace(
        start, **_fields(**{name: np.asarray(getattr(start, name)) + point[k] for k, name in enumerate(free)})
    )


def _fields(**values: Any) -> dict[str, Any]:
    """Fields of a pose as device arrays; nothing is compiled."""
    return {name: jax.device_put(np.asarray(value, np.float32)) for name, value in values.items()}


def check_views(images: Any, sonar_poses: Pose, start: Pose, sonar: Sonar) -> np.ndarray:
    """x, y [m] and heading [rad] (view, 3) of the sonars; `images` are (view, range, beam).

    Raises:
        SonarjaxError: Images, poses or start do not fit together.
    """
    check_kind(sonar_poses, Pose, "sonar_poses")
    images = image_array(images, "image")
    if np.ndim(images) != 3 or np.shape(images)[-2:] != sonar.shape:
        raise SonarjaxError(f"image: expected shape (view, {sonar.n_ranges}, {sonar.n_beams}), got {np.shape(images)}")
    if sonar_poses.shape != np.shape(images)[:1]:
        raise SonarjaxError(f"sonar_poses: expected one pose for each of {len(images)} views, got {sonar_poses.shape}")
    check_sonar_poses(sonar_poses, "sonar_poses")
    if len(start.shape) > 1:
        raise SonarjaxError(f"start: expected one pose or one axis of poses for all views, got shape {start.shape}")
    return np.stack([np.asarray(v, float) for v in (sonar_poses.x, sonar_poses.y, sonar_poses.yaw)], axis=1)


def check_sonar_poses(sonar_poses: Pose, name: str) -> None:
    """Raise a SonarjaxError if a sonar's pose is lifted or leans, is not finite, or is far from its frame's origin."""
    farthest = np.abs(np.stack([np.asarray(v, float) for v in (sonar_poses.x, sonar_poses.y)])).max(initial=0.0)
    if not farthest <= FARTHEST_SONAR_M:  # NaN fails this as well
        raise SonarjaxError(
            f"{name}: expected x and y from {-FARTHEST_SONAR_M:g} to {FARTHEST_SONAR_M:g} m, got {farthest:g}: poses "
            "are kept in float32, which rounds larger ones; give them relative to a point nearby"
        )
    if any(np.asarray(getattr(sonar_poses, number)).any() for number in ("z", "roll", "pitch")):
        raise SonarjaxError(f"{name}: expected z, roll and pitch of 0: the sonar itself has height, tilt and roll")
