"""Joint least squares over what all frames share and each frame's own pose: Levenberg–Marquardt by block elimination.

A frame's pose affects only its own residuals, so the poses are eliminated frame by frame (the Schur complement; Triggs
et al., Bundle Adjustment, 2000, sec. 6). The cost is linear in the number of frames.

A trust region shortens a step as a whole. Numbers that are clipped one by one would bend it off the direction in which
the cost falls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sonarjax.calibrate.linearise import OWN, Blocks
from sonarjax.calibrate.look import LOOK, LOOK_STD, LOOK_TRUST
from sonarjax.calibrate.parameters import PARAMETERS, SIZES
from sonarjax.io.errors import SonarjaxError
from sonarjax.refine.template import POSE

BOUNCE, BOUNCE_STD = 0.2, 0.2
"""Mean and standard deviation of the prior of the energy left after a bounce on the floor [1]."""
TRUST_OWN = (0.12, 0.03, 0.03, 0.2)
"""Largest step of a frame's own numbers in one iteration."""
NEGLIGIBLE = 0.05
"""The fit has settled when the undamped step is predicted to lower the cost by less: no number would change by more
than a third of its standard deviation.
"""
MOST_RADIUS, LEAST_RADIUS = 2.0, 1e-3
"""The longest step, and the one below which the search for a better one is given up, in units of trust."""
LOOKS = len(LOOK)


class Point(NamedTuple):
    """A value for every number."""

    shared: np.ndarray
    """Changes of the free numbers, then the look (shared,)."""
    own: np.ndarray
    """Each frame's own numbers (frame, 4), the pose as steps from its start."""


class Prior(NamedTuple):
    """What is known about the shared numbers beforehand."""

    mean: np.ndarray
    """Means (shared,); 0 for the changes of the sonar."""
    std: np.ndarray
    """Standard deviations (shared,)."""
    trust: np.ndarray
    """Scales (shared,) of their steps, see `Parameter.trust`."""
    fixed: np.ndarray
    """Which numbers (shared,) stay as they are."""
    overcounted: float = 1.0
    """Factor by which the residuals overcount what the frames say [1]; their weight is divided by it."""


def make_prior(free: Sequence[str], std: np.ndarray, fixed: Sequence[str] = ()) -> Prior:
    """The prior of the `free` numbers, with standard deviations `std` (free,), and of the look."""
    return Prior(
        mean=np.concatenate([np.zeros(len(free)), LOOK]),
        std=np.concatenate([std, LOOK_STD]),
        trust=np.concatenate([[(PARAMETERS | SIZES)[name].trust for name in free], LOOK_TRUST]),
        fixed=np.array([name in fixed for name in free] + [False] * LOOKS),
    )


@dataclass(frozen=True)
class Fit:
    """The result of a joint fit."""

    point: Point
    """The best values."""
    information: np.ndarray
    """The frames' information about the shared numbers, with the poses eliminated (shared, shared)."""
    scores: np.ndarray
    """Each frame's derivative of the cost by the shared numbers, with its own numbers eliminated (frame, shared)."""
    spread: np.ndarray
    """Standard deviation of the residuals of each row [grey]."""
    costs: np.ndarray
    """Each frame's cost (frame,)."""
    converged: bool
    """True if a further step is predicted to gain next to nothing, or if even the shortest gains nothing."""


class _Assembled(NamedTuple):
    """The blocks of all frames at one point."""

    own: np.ndarray  # (frame, 4, 4), with the bounce's prior
    across: np.ndarray  # (frame, 4, shared)
    own_gradient: np.ndarray  # (frame, 4)
    shared: np.ndarray  # (shared, shared), the data's alone
    shared_gradient: np.ndarray  # (frame, shared), the data's alone
    prior_gradient: np.ndarray  # (shared,)
    tight: np.ndarray  # (shared,) inverse variances of the prior
    costs: np.ndarray  # (frame,)
    cost: float  # with the priors
    square: np.ndarray  # (row,)
    sound: np.ndarray  # (frame,) whether all numbers of a frame are finite


def solve_jointly(evaluate: Callable[[Point], Sequence[Blocks]], begin: Point, prior: Prior, *, iterations: int) -> Fit:
    """Minimise the costs of frames and priors from `begin`; `evaluate` gives the `Blocks` of each frame at a point.

    A step to where a frame has no finite cost or derivative is taken back.

    Raises:
        SonarjaxError: A frame has none at `begin`.
    """
    point, radius, settled = begin, 1.0, False
    best = _assembled(evaluate(begin), begin, prior)
    if not best.sound.all():
        number = int(np.flatnonzero(~best.sound)[0])
        raise SonarjaxError(f"calibrate: frame {number} of those fitted has no finite derivatives where the fit begins")
    for _ in range(iterations):
        newton = _damped_step(best, prior, 0.0)
        step = newton if newton.length <= radius else _shorter_step(best, prior, radius)
        target = Point(point.shared + step.shared, _bounded(point.own + step.own))
        found = _assembled(evaluate(target), target, prior)
        gained = best.cost - found.cost
        if gained > 0:
            point, best = target, found
        radius = _next_radius(radius, step, gained)
        settled = abs(newton.predicted) < NEGLIGIBLE or radius < LEAST_RADIUS
        if settled:
            break
    information, scores = _eliminated(best)
    return Fit(point, information, scores, np.sqrt(best.square), best.costs, bool(settled))


def _next_radius(radius: float, step: _Step, gained: float) -> float:
    """The radius of the next step: smaller if the cost fell by much less than predicted, larger if by about as much."""
    if gained < 0.25 * step.predicted:
        return step.length / 4
    return max(radius, min(2 * step.length, MOST_RADIUS)) if gained > 0.75 * step.predicted else radius


_TRUST = np.array(TRUST_OWN)


def _assembled(parts: Sequence[Blocks], point: Point, prior: Prior) -> _Assembled:
    hessian, gradient, costs, square = (np.stack([np.asarray(v, float) for v in vs]) for vs in zip(*parts, strict=True))
    sound = np.isfinite(hessian).all((1, 2)) & np.isfinite(gradient).all(1) & np.isfinite(costs)
    hessian, gradient, costs = (v / prior.overcounted for v in (hessian, gradient, costs))
    hessian[:, POSE, POSE] += 1 / BOUNCE_STD**2
    off = point.own[:, POSE] - BOUNCE
    gradient[:, POSE] += off / BOUNCE_STD**2
    tight = 1 / prior.std**2
    away = point.shared - prior.mean
    cost = costs.sum() + (off**2).sum() / BOUNCE_STD**2 / 2 + (tight * away**2).sum() / 2
    return _Assembled(
        own=hessian[:, :OWN, :OWN], across=hessian[:, :OWN, OWN:], own_gradient=gradient[:, :OWN],
        shared=hessian[:, OWN:, OWN:].sum(0), shared_gradient=gradient[:, OWN:], prior_gradient=tight * away,
        tight=tight, costs=costs, cost=float(cost) if sound.all() else np.inf, square=_mean_square(square),
        sound=sound,
    )  # fmt: skip


def _mean_square(square: np.ndarray) -> np.ndarray:
    """Means (row,) of mean squares (frame, row) over the frames that measured a row: the others hold 0."""
    return square.sum(0) / np.maximum((square > 0).sum(0), 1)


def _eliminated(at: _Assembled, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Information on the shared numbers (shared, shared) and each frame's gradient (frame, shared), without poses."""
    inverse = np.linalg.inv(_damped(at.own, damping))
    information = at.shared - np.einsum("fps,fpq,fqt->st", at.across, inverse, at.across)
    return information, at.shared_gradient - np.einsum("fps,fpq,fq->fs", at.across, inverse, at.own_gradient)


def _damped(own: np.ndarray, damping: float) -> np.ndarray:
    return own + damping * np.diag(1 / _TRUST**2) + 1e-9 * np.eye(OWN)


class _Step(NamedTuple):
    """A step of all numbers."""

    shared: np.ndarray  # (shared,)
    own: np.ndarray  # (frame, 4)
    length: float  # largest change of a shared number, in units of its trust
    predicted: float  # by how much the cost falls according to its quadratic model


def _shorter_step(at: _Assembled, prior: Prior, radius: float) -> _Step:
    """The best step whose shared numbers change by at most `radius`, in units of their trust.

    The damping that makes it so short is found by bisection (Moré, Numerical Analysis, LNM 630, 1978).
    """
    low, high = -12.0, 12.0  # powers of ten
    while high - low > 0.05:
        middle = (low + high) / 2
        step = _damped_step(at, prior, 10**middle)
        low, high = (low, middle) if step.length <= radius else (middle, high)
    return _damped_step(at, prior, 10**high)


def _damped_step(at: _Assembled, prior: Prior, damping: float) -> _Step:
    """The Levenberg–Marquardt step."""
    information, gradients = _eliminated(at, damping)
    free = ~prior.fixed
    normal = (information + np.diag(at.tight + damping / prior.trust**2))[np.ix_(free, free)]
    shared = np.zeros(len(free))
    shared[free] = -np.linalg.solve(normal, (gradients.sum(0) + at.prior_gradient)[free])
    rest = at.own_gradient + np.einsum("fps,s->fp", at.across, shared)
    own = np.clip(-np.einsum("fpq,fq->fp", np.linalg.inv(_damped(at.own, damping)), rest), -_TRUST, _TRUST)
    length = float(np.abs(shared / prior.trust).max(initial=0.0))
    return _Step(shared, own, length, _predicted_decrease(at, shared, own))


def _predicted_decrease(at: _Assembled, shared: np.ndarray, own: np.ndarray) -> float:
    """By how much the quadratic model says that a step lowers the cost."""
    slope = (at.own_gradient * own).sum() + (at.shared_gradient.sum(0) + at.prior_gradient) @ shared
    bend = np.einsum("fp,fpq,fq->", own, at.own, own) + 2 * np.einsum("fp,fps,s->", own, at.across, shared)
    return float(-slope - (bend + shared @ (at.shared + np.diag(at.tight)) @ shared) / 2)


def _bounded(own: np.ndarray) -> np.ndarray:
    """The frames' own numbers, with the energy of a bounce limited to between 0 and 1."""
    return np.concatenate([own[:, :POSE], np.clip(own[:, POSE:], 0.0, 1.0)], axis=1)
