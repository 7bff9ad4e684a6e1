"""The joint fit to frames at roughly known poses: several starts, coarse to fine, undetermined numbers kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.covariance import Certainty, certainty, error_covariance, overcounted
from sonarjax.calibrate.detect import Prepared
from sonarjax.calibrate.linearise import OWN, Blocks, Observation, linearise
from sonarjax.calibrate.look import LOOK
from sonarjax.calibrate.parameters import INCIDENCE, INCIDENCE_DEG, PARAMETERS, changed_sonar
from sonarjax.calibrate.picture import make_sampling, measured_mean
from sonarjax.calibrate.solver import BOUNCE, Fit, Point, Prior, make_prior, solve_jointly
from sonarjax.engine import Engine
from sonarjax.refine.template import POSE
from sonarjax.render import WindowSize
from sonarjax.render.region import image_azimuth, plan_window_at
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


class Stage(NamedTuple):
    """One stage of a fit."""

    blur: float
    """Blur of the comparison [range bins]."""
    iterations: int
    """Most iterations."""


COARSE, FINE = Stage(8.0, 6), Stage(2.0, 14)
"""Where the sonar may be far off, and where it is nearly right."""
ROUGH_ITERATIONS = 4
"""Most iterations of a stage's first fit, which only finds how large the residuals of each row are."""
TILTS = (0.0, -1.2, -0.6, 0.6, 1.2)
"""Tilts that are tried first, as multiples of the prior's standard deviation. The edge of the lit floor may be far from
where the nominal tilt puts it, too far for the fit to find it.
"""
LIMITS = (90.0, 75.0, 60.0, 45.0)
"""Incidence limits that are tried first, beside the nominal one [deg]. A limit only shows on facets that are seen at
about this angle: from 90°, which darkens none, no fit can start.
"""
TRIED_FRAMES, TRIED_ITERATIONS = 3, 6
"""Most frames, and most iterations, with which a start is tried."""
SLACK_M = 0.12
"""Room around the object in its window [m]."""


class Job(NamedTuple):
    """What stays the same during a calibration."""

    frames: list[Prepared]
    """All frames."""
    mesh: Mesh
    """The target."""
    sonar: Sonar
    """The nominal sonar."""
    free: tuple[str, ...]
    """Names of the free numbers."""
    std: np.ndarray
    """Standard deviations (free,) of their priors."""
    engine: Engine
    """Runs the compiled functions."""
    progress: Callable[[str], None]
    """Called with a text that says what is being done."""
    widening: float = 1.0
    """Factor on the standard deviations that the frames imply [1], see `certainty`."""


def with_nominal_look(change: np.ndarray) -> np.ndarray:
    """Where a fit begins (free + look,): at a `change` (free,) of the free numbers, with the nominal device's look."""
    return np.concatenate([change, LOOK])


def fit_frames(
    job: Job, frames: Sequence[Prepared], starts: Sequence[Pose], begin: np.ndarray,
    stages: Sequence[Stage] = (COARSE, FINE),
) -> tuple[Fit, Certainty]:  # fmt: skip
    """Fit `frames` jointly in `stages`, from their poses and `begin` (free + look,); say how well all is known.

    `begin` holds the changes of the free numbers, then the look. A number that the frames do not determine is put back
    to its nominal value, see `_put_back`, and the others are fitted again. The covariance is that of the last fit;
    everything else about certainty is from the first, in which no number was held.
    """
    change = begin[: len(job.free)]
    size = _window(job, starts, change)
    observations = [_observation(job, frame, at, size, change) for frame, at in zip(frames, starts, strict=True)]
    point = Point(begin, np.tile(np.eye(OWN)[POSE] * BOUNCE, (len(observations), 1)))
    fit = _fitted(job, observations, size, point, (), stages)
    known = certainty(fit.information, fit.scores, job.std, job.free, job.widening)
    loose = tuple(name for name, told in known.determined.items() if not told)
    if loose:
        count = len(job.free)
        back = _put_back(job, fit.point.shared[:count], loose)
        again = fit.point._replace(shared=np.concatenate([back, fit.point.shared[count:]]))
        fit = _fitted(job, observations, size, again, loose, stages[-1:])
        # Also an incidence limit that stays at 90° has the error of its prior: facets that were not seen may still show
        # a limit. It passes none on, because there the picture does not change with the limit.
        put_back = np.isin(job.free, loose)
        covariance = error_covariance(fit.information, fit.scores, job.std, job.widening, put_back)
        known = known._replace(covariance=covariance)
    return fit, known


def _window(job: Job, starts: Sequence[Pose], change: np.ndarray) -> WindowSize:
    """One window size for all frames: all ranges, and the beams that the target may touch."""
    sonar = changed_sonar(job.sonar, job.free, jnp.asarray(change))
    planned = plan_window_at(job.mesh, sonar, starts, SLACK_M)
    return WindowSize((job.sonar.n_ranges, planned.shape[1]), planned.object_columns)


def _observation(job: Job, frame: Prepared, start: Pose, size: WindowSize, change: np.ndarray) -> Observation:
    sonar = changed_sonar(job.sonar, job.free, jnp.asarray(change))
    bearing = float(image_azimuth(start.x, start.y, sonar))
    column = int(np.searchsorted(np.asarray(sonar.azimuth), bearing)) - size.shape[1] // 2
    mask = np.ones(job.sonar.shape, np.float32) if frame.mask is None else frame.mask.astype(np.float32)
    return Observation(frame.image, mask, start, np.int32(np.clip(column, 0, job.sonar.n_beams - size.shape[1])))


def _fitted(
    job: Job, observations: Sequence[Observation], size: WindowSize, point: Point, fixed: tuple[str, ...],
    stages: Sequence[Stage],
) -> Fit:  # fmt: skip
    """The joint fit from `point`, one stage after the other; `fixed` numbers stay as they are."""
    prior = make_prior(job.free, job.std, fixed)
    reference = np.float32((float(job.sonar.range_min) + float(job.sonar.range_max)) / 2)
    for stage in stages:
        blur, iterations = stage
        sampling = make_sampling(job.sonar.shape, blur)
        spread = _row_spread(observations, sampling)
        for last in (False, True):

            def evaluate(
                at: Point, count: int = len(observations), spread: np.ndarray = spread, sampling: Any = sampling
            ) -> list[Blocks]:
                shared = at.shared.astype(np.float32)

                def one(k: int) -> Blocks:
                    own = at.own[k].astype(np.float32)
                    args = observations[k], job.mesh, job.sonar, shared, own, sampling, spread, reference
                    return Blocks(*jax.device_get(job.engine.run(linearise, *args, free=job.free, size=size)))

                return job.engine.map(one, range(count))

            if stage is COARSE and not last:
                for name in ("tilt", INCIDENCE):
                    point = _best_start(job, evaluate, point, prior, name)
            most = iterations if last else ROUGH_ITERATIONS
            fit = solve_jointly(evaluate, point, prior, iterations=most)
            job.progress(f"fitted with a blur of {blur:g} range bins: cost {fit.costs.sum():.0f}")
            point, spread = fit.point, _smooth(fit.spread)
            if stage is stages[-1] and not last:
                prior = prior._replace(overcounted=overcounted(fit.information, fit.scores, job.std))
    return fit


def _best_start(
    job: Job, evaluate: Callable[[Point, int], list[Blocks]], point: Point, prior: Prior, name: str
) -> Point:
    """The point with the best of several starts of this number: the one whose fit explains a few frames best."""
    if name not in job.free or prior.fixed[job.free.index(name)]:
        return point
    some, by_number = min(TRIED_FRAMES, len(point.own)), np.eye(len(point.shared))[job.free.index(name)]
    tried = []
    for change in _starts(job, name):
        job.progress(f"trying {name} changed by {change:+.3g} {PARAMETERS[name].unit}")
        begin = Point(point.shared + by_number * change, point.own[:some])
        tried.append(solve_jointly(lambda at: evaluate(at, some), begin, prior, iterations=TRIED_ITERATIONS))
    best = min(tried, key=lambda fit: fit.costs.sum())
    return Point(best.point.shared, point.own)


def _starts(job: Job, name: str) -> list[float]:
    """Changes of a number from which to start."""
    if name == INCIDENCE:
        nominal = float(job.sonar.highlight_max_incidence)
        return [0.0, *(limit - nominal for limit in LIMITS if limit != nominal)]
    return [float(job.std[job.free.index(name)]) * away for away in TILTS]


def _put_back(job: Job, change: np.ndarray, loose: Sequence[str]) -> np.ndarray:
    """`change` (free,) with `loose` numbers at their nominal values; only an incidence limit beyond 90° stays there."""
    back = np.where([name in loose for name in job.free], 0.0, change)
    if INCIDENCE in loose:
        at, none = job.free.index(INCIDENCE), INCIDENCE_DEG[1] - float(job.sonar.highlight_max_incidence)
        back[at] = none if change[at] >= none else 0.0
    return back


def _row_spread(observations: Sequence[Observation], sampling: Any) -> np.ndarray:
    """First guess of the standard deviation of residuals (row,): how much neighbouring beams differ."""
    differences = np.array([_beam_difference(seen, sampling) for seen in observations])
    return _smooth(np.ma.median(np.ma.masked_equal(differences, 0.0), axis=0).filled(0.0))


def _beam_difference(seen: Observation, sampling: Any) -> np.ndarray:
    """Standard deviation (row,) of the differences between neighbouring columns, where both were measured; else 0."""
    both = np.minimum(*(np.asarray(sampling(seen.mask))[:, part] for part in (slice(1, None), slice(None, -1))))
    weight = both / np.maximum(both.sum(axis=1, keepdims=True), 1e-6)
    differs = np.diff(np.asarray(measured_mean(sampling, seen.image, seen.mask)), axis=1)
    mean = (weight * differs).sum(axis=1, keepdims=True)
    return np.sqrt((weight * (differs - mean) ** 2).sum(axis=1))


def _smooth(spread: np.ndarray) -> np.ndarray:
    """Average standard deviations (row,) over neighbouring rows, and raise those below the median to it.

    Where a frame is dark it also varies little, but far down the skirt of the pattern the picture is not that accurate.
    Rows in which nothing was measured hold 0 and do not count.
    """
    width = 9
    padded = np.pad(spread.astype(np.float64), width // 2, mode="edge")
    mean = np.convolve(padded, np.ones(width) / width, mode="valid")
    usual = np.median(mean[spread > 0]) if (spread > 0).any() else 0.0
    return np.maximum(mean, usual + 1e-4).astype(np.float32)


def relative_residual(costs: np.ndarray, masks: Sequence[np.ndarray | None]) -> np.ndarray:
    """RMS (frame,) of residuals from the frames' `costs` (frame,), which sum over measured pixels; 1 in the median."""
    mean = costs / [1.0 if mask is None else mask.mean() for mask in masks]
    return np.sqrt(mean / np.median(mean))
