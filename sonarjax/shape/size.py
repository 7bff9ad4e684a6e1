"""`fit_size`: the extents of an object from a few frames of it (beyond the paper).

This is the joint fit of `sonarjax.calibrate`, with the object's extents in place of the sonar's geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.detect import Prepared
from sonarjax.calibrate.fit import FINE, Job, fit_frames, relative_residual, with_nominal_look
from sonarjax.calibrate.inputs import check_floor, check_frames, check_kinds, check_not_blank, starts_of
from sonarjax.calibrate.parameters import SIZES, changed_mesh, prior_std, resting
from sonarjax.engine import PLAIN, Engine
from sonarjax.refine.free import in_order
from sonarjax.render.room import with_lean_room
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


@dataclass(frozen=True, eq=False)
class SizeEstimate:
    """What `fit_size` found."""

    mesh: Mesh
    """The mesh with the extents that the frames determine; the other extents are unchanged."""
    free: tuple[str, ...]
    """Names of the free extents: `object_length`, `object_width`, `object_height` (x, y and z of the mesh)."""
    extent: np.ndarray
    """Extents of the fitted mesh along x, y and z [m] (3,)."""
    scale: np.ndarray
    """Ratio of each free extent to that of the given mesh (free,) [1]; 1 if undetermined."""
    covariance: np.ndarray
    """Covariance of the logarithms of `scale` (free, free), given frames and prior.

    An extent that is not determined has the variance of its prior, and passes its error on to the others. With one or
    two frames all pixels are taken for independent, so that the covariance is much too small.
    """
    determined: dict[str, bool]
    """For each extent, whether the frames determine it: they halve the standard deviation of its prior or do better."""
    singular_values: np.ndarray
    """Singular values of the frames' information about the free extents, in units of their priors (free,),
    largest first.
    """
    poses: Pose
    """The object's pose in each frame (frame,); yaw is not wrapped to [0, 2π). Where it leans, z is that of the fitted
    mesh: its lowest point is as high as that of the given mesh was.
    """
    residual: np.ndarray
    """RMS of each frame's residuals (frame,) where it was measured, divided by the median over all frames."""
    converged: bool
    """True if the fit has settled: a further step would gain next to nothing."""

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each free extent, as a share of the extent [1]."""
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
    """Fit the length, width and height of an object of known shape to frames of it.

    Minimises the robust squared difference between the frames and what the sonar would store of the object on a lit
    floor, jointly over the free extents, the device's look and each frame's yaw, x and y, by Levenberg–Marquardt with
    the poses eliminated (Triggs et al., Bundle Adjustment, 2000). This assumes a flat floor, a known sonar and an
    object that stands on the floor. An extent that the frames do not determine keeps the mesh's value, and is reported
    as undetermined: a single frame, or frames all from one side, say nothing about what is hidden.

    Args:
        frames: Grey frames (frame, range, beam).
        mesh: The object's shape, in roughly its size; its z = 0 is the floor (`Mesh.standing`).
        sonar: The sonar.
        poses: Poses (frame,) that are right to a few centimetres and degrees, such as those from matching with the
            mesh.
        free: Names of the extents to fit, by default all three: `object_length`, `object_width`, `object_height`.
        prior: Standard deviations of the extents' logarithms [1], by name. Extents that
            are not given have 0.25, which allows for a mesh that is a quarter too small or too large.
        masks: True where pixels were measured (frame, range, beam); None, also for a single frame, means everywhere.
        engine: Runs the compiled functions.
        progress: Called with a text that says what is being done.

    Returns:
        The mesh with the fitted extents (3,) [m], how certain these are, and the object's pose in each frame [m, rad].

    Raises:
        SonarjaxError: There are no frames, their shapes do not fit the sonar, they are all the same or blank, values
            are not finite (also of poses), there is another number of poses or masks, the object is out of view or goes
            through the floor, an extent does not exist or is repeated, or a prior is no positive number or belongs
            to no free extent.
    """
    check_kinds(mesh, sonar, engine)
    names = in_order(free, SIZES)
    std = prior_std(names, prior, sonar)
    images, measured = check_frames(frames, masks, sonar)
    starts = starts_of(poses, len(images), sonar)
    check_floor(mesh, poses)
    check_not_blank(images, measured)
    prepared = [Prepared(image, mask, image) for image, mask in zip(images, measured, strict=True)]
    roomy = with_lean_room(mesh, poses, sonar)
    job = Job(prepared, roomy, sonar.replace(geometry_std=None), names, std, engine, progress)
    fit, known = fit_frames(job, prepared, starts, with_nominal_look(np.zeros(len(names))), (FINE,))
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
            x=np.asarray(poses.x) + own[:, 1], y=np.asarray(poses.y) + own[:, 2], yaw=np.asarray(poses.yaw) + own[:, 0],
            z=resting(poses, mesh, fitted).z, roll=poses.roll, pitch=poses.pitch,
        ),
        residual=relative_residual(fit.costs, measured),
        converged=fit.converged,
    )  # fmt: skip
