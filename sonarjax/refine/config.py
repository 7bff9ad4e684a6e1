"""`RefineConfig`: how a pose is refined, as one frozen record of numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sonarjax.io.errors import SonarjaxError
from sonarjax.refine.free import ALL
from sonarjax.refine.template import VIEWS, Template
from sonarjax.render import RenderQuality

SLACK_M = 0.06
"""Room around the start inside the window that is rendered [m]."""


@dataclass(frozen=True)
class RefineConfig:
    """How `refine_pose` and `refine_yaw` search.

    Only `quality`, the number of blurs, and whether `polish` is 0 mean other compiled code.
    """

    bounds: tuple[float, float, float] = (math.radians(40.0), 0.15, 0.15)
    """Largest change of yaw [rad], x [m] and y [m] from the start."""
    lean_bounds: tuple[float, float, float] = (0.06, math.radians(15.0), math.radians(15.0))
    """Largest change of z [m], roll and pitch [rad], where `refine_pose` frees them."""
    blurs: tuple[float, ...] = (8.0, 2.0, 0.8)
    """Standard deviations of the blur in range bins, coarse to fine. Coarse blurs widen the basin of attraction."""
    iterations: int = 4
    """Most renders at each blur."""
    polish: int = 16
    """Most further renders at the last blur, to reach a stationary point of the objective, which the implicit
    derivative needs. With 0 there is no polishing, and the derivative is zero.
    """
    quality: RenderQuality = RenderQuality(sub_beams=1)
    """How finely the template is rendered."""
    sharpness: float = 10.0
    """How sharply pixels are assigned to one class, for images of labels (see `template.labelled`). With 0 the
    shares are kept, which fits a grey image, whose pixels mix classes.
    """
    margin: tuple[int, int] | None = None
    """Only the box of the start's template with this many (bins, beams) around it counts; None for the complete window.

    Use it for a grey image, whose floor is not an even background, with a start that is already good.
    """
    template: Template = "semantic"
    """The template that is fitted: `semantic`, `echo` or `either`.

    `echo` is for a frame as the device stored it. It shows shadow and floor, each facet as bright as the elevation that
    its echo collects, and the object's bounces on the floor, whose energies are also fitted (`sharpness` is not used
    then). `either` takes the template that fits the start better.
    """

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for an unknown template, or numbers that no search can have."""
        if self.template not in VIEWS:
            raise SonarjaxError(f"template: expected one of {', '.join(VIEWS)}, got {self.template!r}")
        if len(self.bounds) != 3 or not all(0 < v < math.inf for v in self.bounds):
            raise SonarjaxError(f"bounds: expected three positive numbers [rad, m, m], got {self.bounds}")
        if len(self.lean_bounds) != 3 or not all(0 < v < math.inf for v in self.lean_bounds):
            raise SonarjaxError(f"lean_bounds: expected three positive numbers [m, rad, rad], got {self.lean_bounds}")
        if not self.blurs or not all(0 < v < math.inf for v in self.blurs):
            raise SonarjaxError(f"blurs: expected positive numbers of range bins, got {self.blurs}")
        if self.iterations < 1 or self.polish < 0 or not 0 <= self.sharpness < math.inf:
            raise SonarjaxError(
                "RefineConfig: expected iterations of 1 or more, polish and sharpness of 0 or more, got "
                f"{self.iterations}, {self.polish} and {self.sharpness}"
            )

    def bound(self, name: str) -> float:
        """Look up the largest change of one number of the pose.

        Args:
            name: One of yaw, x, y, z, roll and pitch.

        Returns:
            The largest change from the start, in [m] for x, y and z and in [rad] for the angles.
        """
        return dict(zip(ALL, (*self.bounds, *self.lean_bounds), strict=True))[name]
