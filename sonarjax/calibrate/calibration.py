"""`calibrate`: the sonar's own geometry from frames of a known object (beyond the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.covariance import Certainty
from sonarjax.calibrate.detect import Prepared, best_height, detect
from sonarjax.calibrate.fit import FINE, Job, fit_frames, relative_residual, with_nominal_look
from sonarjax.calibrate.inputs import check_floor, check_frames, check_kinds, check_not_blank, starts_of
from sonarjax.calibrate.look import Look, sensor_of
from sonarjax.calibrate.parameters import INCIDENCE, INCIDENCE_DEG, changed_sonar, check_free, prior_std
from sonarjax.calibrate.solver import Fit
from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind
from sonarjax.match import SearchConfig
from sonarjax.refine.free import wrapped
from sonarjax.render.room import with_lean_room
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import DEFAULT_SEGMENTER, Segmenter, load_segmenter
from sonarjax.sensor import SensorModel
from sonarjax.sonar import GeometryStd, Sonar

HEIGHT_STEP = 0.1
"""A height that is known less well than this [m] is first searched for in such steps."""
SEARCHED = 6
"""Most frames that are used in the search for the height."""
LIKELY = 0.5
"""Least probability that the target is shown in a frame that is fitted."""
LEAST_SHARE, LEAST_FRAMES = 0.25, 3
"""At least this share and this number of the frames are fitted: the likeliest ones."""
WIDENING = 1.47
"""Factor on the standard deviations that the frames imply [1]. Devices differ in more ways than the fitted look. All
frames of one device share the error that this makes, so they do not disagree about it. Fitted to the errors on drawn
devices of another seed than those of the docs (`python -m experiments.self_calibration --seeds 1`).
"""
FEW_FRAMES = 3
"""With fewer frames than this, `calibrate` notes that its error bars know little of errors that pixels share."""
FIRST_FRAMES = 10
"""Most frames of the first fit, whose result only has to be good enough to search again."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What `calibrate` found."""

    sonar: Sonar
    """The nominal sonar, with the numbers that the frames determine replaced."""
    sensor: SensorModel
    """The nominal device, with the fitted object gain, noise, display law, skirt, pulse and beam width.

    `tvg_exponent` is the slope of the noise. The fitted model is another one than `SensorModel`, so these are the
    nearest values: good for comparison, not for simulation.
    """
    poses: Pose
    """The target's pose in each frame (frame,); for frames that were not used, the best guess."""
    free: tuple[str, ...]
    """Names of the free numbers."""
    change: np.ndarray
    """Their change from the nominal sonar (free,) [in the units of `PARAMETERS`]; 0 if undetermined, but
    for an incidence limit that the frames do not show: it is then 90°.
    """
    covariance: np.ndarray
    """Covariance of that change (free, free), given frames and prior.

    A number that is not determined has the variance of its prior, and passes its error on to the others. How much
    neighbouring pixels err together shows only in how frames differ. With one frame, and hardly less so with two, the
    covariance therefore takes all pixels for independent, and is much too small.
    """
    determined: dict[str, bool]
    """For each free number, whether the frames determine it: with all numbers free, they halve the standard deviation
    of its prior or do better, before it is widened by `WIDENING`. With one or two frames too much counts as determined.
    """
    singular_values: np.ndarray
    """Singular values of the frames' information about the free numbers, in units of their priors (free,),
    largest first.
    """
    weakest: dict[str, float]
    """The combination of free numbers, each in units of its prior, about which the frames say least."""
    bound: dict[str, float]
    """Cramér-Rao bound of each free number with its prior (van Trees, Detection, Estimation, and Modulation
    Theory, 1968, sec. 2.4): no estimator can have a smaller standard deviation, provided that the picture is
    right and the residuals are normal, as large and as correlated as they were found to be.
    """
    used: np.ndarray
    """Which frames (frame,) were fitted; the target was not found in the others."""
    probability: np.ndarray
    """Probability that each frame (frame,) shows the target."""
    residual: np.ndarray
    """RMS of each frame's residuals (frame,) where it was measured, divided by the median over all that were used; NaN
    if not used.
    """
    converged: bool
    """True if the fit has settled: a further step would gain next to nothing."""

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each free number [in the units of `PARAMETERS`]."""
        return dict(zip(self.free, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def calibrate(
    frames: Any,
    mesh: Mesh,
    sonar: Sonar,
    *,
    free: Sequence[str] = ("tilt", "height"),
    poses: Pose | None = None,
    prior: Mapping[str, float] | None = None,
    masks: Any = None,
    present: bool = False,
    segmenter: str | Segmenter = DEFAULT_SEGMENTER,
    search: SearchConfig = SearchConfig(),
    engine: Engine = PLAIN,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Fit numbers of the sonar (see `PARAMETERS`), together with the target's poses, to frames of a known target.

    Minimises the robust squared difference between the frames and what the sonar would store of the target on a lit
    floor (see `picture`), jointly over the free numbers, the device's look and each frame's pose, by
    Levenberg–Marquardt with the poses eliminated (Triggs et al., Bundle Adjustment, 2000). This assumes a flat floor,
    one sonar at rest, and a target that stands on the floor. Numbers that the frames do not determine keep their
    nominal values, and are reported as undetermined.

    Args:
        frames: Grey frames (frame, range, beam).
        mesh: The target; its z = 0 is the floor (`Mesh.standing`).
        sonar: The nominal sonar.
        free: Names of the numbers to fit, from `PARAMETERS`.
        poses: Known poses (frame,) [m, rad] from which to start. None means that the target is searched for in each
            frame, and that frames in which it is not found are left out.
        prior: Standard deviations [rad, deg, m or 1] of how well numbers of the nominal sonar are known, by name.
            Numbers that are not given have those of the sonar's `geometry_std`, else those of `PARAMETERS`.
        masks: True where pixels were measured (frame, range, beam); None, also for a single frame, means everywhere.
        present: The target is known to be in every frame, so all are fitted.
        segmenter: The segmenter, or its name.
        search: How the target is searched for.
        engine: Runs the compiled functions.
        progress: Called with a text that says what is being done, and with a note if fewer than `FEW_FRAMES` frames are
            fitted.

    Returns:
        The fitted sonar, device and poses, with how certain the free numbers are and which frames were used.

    Raises:
        SonarjaxError: There are no frames, their shapes do not fit the sonar, they are all the same or blank, values
            are not finite (also of poses), there is another number of poses or masks, the target is out of view at a
            given pose, the mesh goes through the floor, a free number does not exist or is repeated, a prior is
            not positive or belongs to no free number, `range_offset` is free and the window begins too near the sonar,
            there is no such segmenter, the sonar sees no floor on which the target can stand, the picture has no finite
            derivatives where the fit begins, or the target is found in none of the frames.
    """
    check_kinds(mesh, sonar, engine)
    check_kind(search, SearchConfig, "search")
    names = check_free(free)
    std = prior_std(names, prior, sonar)
    stated = sonar.geometry_std or GeometryStd()
    sonar = sonar.replace(geometry_std=None)
    images, measured = check_frames(frames, masks, sonar)
    starts = [] if poses is None else starts_of(poses, len(images), sonar)
    check_floor(mesh, poses)
    check_not_blank(images, measured)
    if poses is not None:
        prepared = [Prepared(image, mask, image) for image, mask in zip(images, measured, strict=True)]
        roomy = with_lean_room(mesh, poses, sonar)
        job = Job(prepared, roomy, sonar, names, std, engine, progress, WIDENING)
        fit, known = fit_frames(job, prepared, starts, with_nominal_look(np.zeros(len(names))))
        return _as_calibration(job, stated, fit, known, poses, np.ones(len(images)), np.ones(len(images), bool))
    made = segmenter if isinstance(segmenter, Segmenter) else load_segmenter(segmenter)
    progress("segmenting")
    prepared = [
        Prepared(image, mask, np.asarray(made.semantic(image, mask, engine)))
        for image, mask in zip(images, measured, strict=True)
    ]
    job = Job(prepared, mesh, sonar, names, std, engine, progress, WIDENING)
    begin, share = _first_guess(job, search), 1.0 if present else LEAST_SHARE

    def found_with(now: Sonar) -> tuple[Pose, np.ndarray]:
        progress("looking for the target")
        seen = detect(prepared, mesh, now, made, search, engine)
        poses = jax.tree.map(lambda *v: np.stack([np.asarray(x) for x in v]), *[one.pose for one in seen])
        return poses, np.array([one.probability for one in seen])

    at, probability = found_with(changed_sonar(sonar, names, jnp.asarray(begin)))
    some = _likeliest(probability, share) & (_rank(probability) < FIRST_FRAMES)
    first, _ = fit_frames(job, *_used_frames(job, at, some), with_nominal_look(begin))
    # Search again with the nearly right sonar.
    nearly = changed_sonar(sonar, names, jnp.asarray(first.point.shared[: len(names)], jnp.float32))
    at, probability = found_with(nearly)
    used = probability >= LIKELY if made.rule is not None and not present else _likeliest(probability, share)
    if not used.any():
        raise SonarjaxError(f"frames: the target was not found in any of the {len(images)} frames")
    fit, known = fit_frames(job, *_used_frames(job, at, used), first.point.shared, (FINE,))
    return _as_calibration(job, stated, fit, known, at, probability, used)


def _first_guess(job: Job, search: SearchConfig) -> np.ndarray:
    """Changes (free,) from which to start; the height is searched for if it is poorly known."""
    change = np.zeros(len(job.free))
    known = dict(zip(job.free, job.std, strict=True))
    if known.get("height", 0.0) <= HEIGHT_STEP:
        return change
    job.progress("looking for the height")
    reach, nominal = math.ceil(1.5 * known["height"] / HEIGHT_STEP), float(job.sonar.height)
    heights = nominal + HEIGHT_STEP * np.arange(-reach, reach + 1)
    heights = heights[heights > HEIGHT_STEP]
    some = [job.frames[k] for k in np.unique(np.linspace(0, len(job.frames) - 1, SEARCHED).astype(int))]
    change[job.free.index("height")] = best_height(some, job.mesh, job.sonar, heights, search, job.engine) - nominal
    return change


def _likeliest(probability: np.ndarray, share: float) -> np.ndarray:
    """Which frames (frame,) to fit while the sonar may be far off: the likely ones, and at least this `share`."""
    least = max(LEAST_FRAMES, math.ceil(share * len(probability)))
    return (probability >= LIKELY) | (_rank(probability) < least)


def _rank(probability: np.ndarray) -> np.ndarray:
    """How many frames (frame,) are likelier than each."""
    return np.argsort(np.argsort(-probability, kind="stable"))


def _used_frames(job: Job, poses: Pose, used: np.ndarray) -> tuple[list[Prepared], list[Pose]]:
    """The `used` frames (frame,) and their poses."""
    which = np.flatnonzero(used)
    at = [jax.tree.map(lambda v, k=k: np.float32(np.asarray(v)[k]), poses) for k in which]
    return [job.frames[k] for k in which], at


def _as_calibration(
    job: Job, stated: GeometryStd, fit: Fit, known: Certainty, poses: Pose, probability: np.ndarray, used: np.ndarray
) -> Calibration:
    """The result of a fit; `stated` is what was known of the nominal sonar, and still holds of what was not free."""
    count = len(job.free)
    change, look = _possible(job.sonar, job.free, fit.point.shared[:count]), Look(*fit.point.shared[count:])
    x, y, yaw = (np.array(np.asarray(v), np.float64) for v in (poses.x, poses.y, poses.yaw))
    for values, column in ((yaw, 0), (x, 1), (y, 2)):
        values[used] += fit.point.own[:, column]
    residual = np.full(len(used), np.nan)
    residual[used] = relative_residual(fit.costs, [job.frames[k].mask for k in np.flatnonzero(used)])
    _note_few_frames(int(used.sum()), job.progress)
    sonar = changed_sonar(job.sonar, job.free, jnp.asarray(change, jnp.float32))
    numbers = {f: float(getattr(sonar, f)) for f in FIELDS if np.ndim(getattr(sonar, f)) == 0}
    std = dict(zip(job.free, np.sqrt(np.diag(known.covariance)).tolist(), strict=True))
    return Calibration(
        sonar=sonar.replace(**numbers, geometry_std=replace(stated, **std)),
        sensor=sensor_of(look),
        poses=Pose(x, y, wrapped(yaw.astype(np.float32)), poses.z, poses.roll, poses.pitch),
        free=job.free,
        change=change,
        covariance=known.covariance,
        determined=known.determined,
        singular_values=known.singular_values,
        weakest=known.weakest,
        bound=dict(zip(job.free, known.bound.tolist(), strict=True)),
        used=used,
        probability=probability,
        residual=residual,
        converged=fit.converged,
    )  # fmt: skip


def _note_few_frames(count: int, progress: Callable[[str], None]) -> None:
    """Tell the user if so few frames were fitted that their differences say next to nothing about shared errors."""
    if count < FEW_FRAMES:
        frames = "1 frame was" if count == 1 else f"{count} frames were"
        progress(f"note: only {frames} fitted: the error bars know of independent pixel noise only and are too small")


FIELDS = ("tilt", "roll", "height", "elevation_aperture", "range_min", "range_max", "highlight_max_incidence")
"""Fields of the sonar that a calibration may replace by a single number."""


def _possible(sonar: Sonar, free: Sequence[str], change: np.ndarray) -> np.ndarray:
    """`change` (free,) with an incidence limit within `INCIDENCE_DEG`, as `changed_sonar` has it."""
    least, largest = (limit - float(sonar.highlight_max_incidence) for limit in INCIDENCE_DEG)
    limits = [name == INCIDENCE for name in free]
    return np.where(limits, np.clip(change, least, largest), change)
