"""`fit_size`: the extents of an object from a few frames of it (beyond the paper).

The joint search of `sonarjax.calibrate`, with the object's extents in place of the sonar's geometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.calibration import check_frames
from sonarjax.calibrate.detect import Prepared
from sonarjax.calibrate.fit import Job, fit_frames
from sonarjax.calibrate.parameters import SIZES, changed_mesh, prior_std
from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.refine.free import in_order
from sonarjax.render.region import image_azimuth
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


@dataclass(frozen=True)
class SizeEstimate:
    """What `fit_size` found."""

    mesh: Mesh
    """The mesh with the extents that the frames determine; the others are its own."""
    free: tuple[str, ...]
    """Names of the free extents, of `object_length`, `object_width` and `object_height` (x, y and z of the mesh)."""
    extent: np.ndarray
    """Extents of the fitted mesh along x, y and z [m] (3,)."""
    scale: np.ndarray
    """Each free extent over that of the mesh given (free,) [1]; 1 where undetermined."""
    covariance: np.ndarray
    """Covariance of the logarithms of `scale` (free, free), given frames and prior."""
    determined: dict[str, bool]
    """Whether the frames say more about an extent than its prior does: half its standard deviation or less."""
    singular_values: np.ndarray
    """Of the frames' information about the free extents, in units of their priors (free,), largest first."""
    poses: Pose
    """The object's pose in each frame (frame,)."""
    residual: np.ndarray
    """RMS of what the fit leaves of each frame (frame,), over what is usual in all."""
    converged: bool
    """Whether the last step was small."""

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each free extent, as a share of it [1]."""
        return dict(zip(self.free, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def fit_size(
    frames: Any,
    mesh: Mesh,
    sonar: Sonar,
    poses: Pose,
    *,
    free: Sequence[str] = tuple(SIZES),
    prior: Mapping[str, float] | None = None,
    masks: Any = None,
    engine: Engine = PLAIN,
    progress: Callable[[str], None] = lambda text: None,
) -> SizeEstimate:
    """How long, wide and high the object is that `frames` (frame, range, beam) show, of the shape of `mesh`.

    Minimises the robust squared difference between the frames and what the sonar would store of the object on a lit
    floor, jointly over the `free` extents, the device's look and each frame's yaw, x and y, by Levenberg–Marquardt with
    the poses eliminated (Triggs et al., Bundle Adjustment, 2000). Assumes a flat floor, a known sonar, an object that
    stands on the floor, and `poses` (frame,) that are right to a few centimetres and degrees, as a match with the mesh
    gives them. `prior` gives standard deviations of the extents' logarithms [1], 0.25 without: the mesh may be a
    quarter too small or too large. An extent that the frames do not determine keeps the mesh's, and is said to be
    undetermined: all frames from one side, or one frame alone, leave what is hidden open.

    `masks` (frame, range, beam) are true where pixels were measured; `progress` is told what is being done.

    Raises SonarjaxError for no frames, shapes that do not fit the sonar, frames that are all alike, values that are not
    finite, poses of another number or with the object out of view, and extents that do not exist.
    """
    names = in_order(free, SIZES)
    std = prior_std(names, prior, sonar)
    images, measured = check_frames(frames, masks, sonar)
    starts = starts_of(poses, len(images), sonar)
    prepared = [Prepared(image, mask, image) for image, mask in zip(images, measured, strict=True)]
    job = Job(prepared, mesh, sonar.replace(geometry_std=None), names, std, engine, progress)
    fit, known = fit_frames(job, prepared, starts, np.zeros(len(names)), coarse=False)
    change = fit.point.shared[: len(names)]
    fitted = mesh.with_vertices(changed_mesh(mesh, names, jnp.asarray(change, jnp.float32)).vertices)
    own = fit.point.own
    vertices = np.asarray(fitted.vertices)
    return SizeEstimate(
        mesh=fitted,
        free=names,
        extent=vertices.max(axis=0) - vertices.min(axis=0),
        scale=np.exp(change),
        covariance=known.covariance,
        determined=known.determined,
        singular_values=known.singular_values,
        poses=Pose(
            x=np.asarray(poses.x) + own[:, 1], y=np.asarray(poses.y) + own[:, 2], yaw=np.asarray(poses.yaw) + own[:, 0]
        ),
        residual=np.sqrt(fit.costs / np.median(fit.costs)),
        converged=fit.converged,
    )


def starts_of(poses: Pose, count: int, sonar: Sonar) -> list[Pose]:
    """The poses (frame,) one by one.

    Raises SonarjaxError unless there are `count`, each with the object in view.
    """
    if poses.shape != (count,):
        raise SonarjaxError(f"poses: expected one for each of the {count} frames, got shape {poses.shape}")
    starts = [jax.tree.map(lambda v, k=k: np.asarray(v)[k], poses) for k in range(count)]
    beams = np.asarray(sonar.azimuth)
    for number, pose in enumerate(starts):
        slant, azimuth = math.hypot(pose.x, pose.y, float(sonar.height)), image_azimuth(pose.x, pose.y, sonar)
        if not (sonar.range_min < slant < sonar.range_max and beams.min() < azimuth < beams.max()):
            place = f"x {float(pose.x):.3g} m, y {float(pose.y):.3g} m"
            raise SonarjaxError(f"poses[{number}]: expected the object in view, got {place}")
    return starts
