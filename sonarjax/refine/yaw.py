"""`refine_yaw`: yaw and place of an object on the floor, the first case of `refine_pose`."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sonarjax.engine import PLAIN, Engine
from sonarjax.records import record
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.free import ON_FLOOR
from sonarjax.refine.pose import PoseEstimate, search_pose
from sonarjax.refine.template import Drawn
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


@record
class YawEstimate:
    """A refined hypothesis. Every field has the batch shape of the starts; none is ever NaN if the start is finite."""

    yaw: Float[Array, "*batch"]
    """Absolute yaw [rad], in [0, 2π)."""
    x: Float[Array, "*batch"]
    """Forward position [m]."""
    y: Float[Array, "*batch"]
    """Position to port [m]."""
    yaw_std: Float[Array, "*batch"]
    """Standard deviation of yaw [rad] from the curvature and the residuals of each beam, given the right basin.

    On labels of a render it is as large as the errors; errors that neighbouring beams share make it too small. Infinite
    if nothing could be compared.
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

    @property
    def pose(self) -> Pose:
        """The estimate as a `Pose` [m, rad] with z, roll and pitch of 0. Refinement itself keeps those of the start."""
        return Pose(self.x, self.y, self.yaw)


def refine_yaw(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    start: Pose,
    *,
    mask: Any = None,
    config: RefineConfig = RefineConfig(),
    window: WindowSize | None = None,
    engine: Engine = PLAIN,
) -> YawEstimate:
    """Refine yaw, x and y of an object on the floor by Levenberg–Marquardt on 1 − NCC of the rendered template.

    This is `refine_pose` with these three numbers free, with one simplification: a yaw that the frame does not
    determine is not put back to its start. Yaw, x and y have derivatives, as the pose of `refine_pose` has.

    Args:
        image: Semantic map or frame (range, beam), with batch axes as in `refine_pose`.
        mesh: The object.
        sonar: The sonar.
        start: Where to start [m, rad], as in `refine_pose`.
        mask: True where a pixel was measured, in the image's shape; None means everywhere.
        config: How to search.
        window: Size of the window to render, as in `refine_pose`.
        engine: Runs the compiled functions.

    Returns:
        The estimate, in the batch shape of `start`.

    Raises:
        SonarjaxError: An argument is of another kind, the shapes do not fit the sonar, or a measured pixel is not
            finite.
    """
    return refine_and_draw(image, mesh, sonar, start, mask, config, window, engine)[0]


def refine_and_draw(
    image: Any, mesh: Mesh, sonar: Sonar, start: Pose, mask: Any, config: RefineConfig, window: WindowSize | None,
    engine: Engine,
) -> tuple[YawEstimate, Drawn]:  # fmt: skip
    """As `refine_yaw`, together with the templates at the solutions."""
    found, drawn = search_pose(image, mesh, sonar, start, mask, config, window, engine, free=ON_FLOOR, hold=False)
    return _yaw_alone(found), drawn


def _yaw_alone(found: PoseEstimate) -> YawEstimate:
    return YawEstimate(
        yaw=found.pose.yaw, x=found.pose.x, y=found.pose.y, yaw_std=jnp.sqrt(found.covariance[..., 0, 0]),
        score=found.score, start_score=found.start_score, converged=found.converged, determined=found.determined,
    )  # fmt: skip
