"""`RefineConfig`: how a pose is refined, as one frozen record of numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, check_whole, is_number, positive_numbers, several, shown
from sonarjax.refine.free import ALL
from sonarjax.refine.template import VIEWS, Template
from sonarjax.render import RenderQuality

EVERYWHERE = 1 << 20
"""A margin that reaches beyond every frame [bins, beams]."""
SLACK_M = 0.06
"""Room around the start inside the window that is rendered [m]."""


@dataclass(frozen=True)
class RefineConfig:
    """How `refine_pose` and `refine_yaw` search.

    Only `quality`, the number of blurs, whether `polish` is 0, and the size of the window mean other compiled code. A
    planned window depends on the bounds.
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
        """Turn lists into tuples. Raise a SonarjaxError for an unknown template, or numbers that no search can have."""
        if not isinstance(self.template, str) or self.template not in VIEWS:
            raise SonarjaxError(f"template: expected one of {', '.join(VIEWS)}, got {self.template!r}")
        for name, expected, count in (
            ("bounds", "three positive numbers [rad, m, m]", 3),
            ("lean_bounds", "three positive numbers [m, rad, rad]", 3),
            ("blurs", "positive numbers of range bins", None),
        ):
            object.__setattr__(self, name, positive_numbers(getattr(self, name), expected, name, count))
        check_kind(self.quality, RenderQuality, "quality")
        check_whole(self.iterations, 1, "iterations")
        check_whole(self.polish, 0, "polish")
        if not (is_number(self.sharpness) and 0 <= self.sharpness < math.inf):
            raise SonarjaxError(f"sharpness: expected a number of 0 or more, got {shown(self.sharpness)}")
        if self.margin is not None:
            object.__setattr__(self, "margin", _checked_margin(self.margin))

    @property
    def box_margin(self) -> Int[np.ndarray, "2"]:
        """`margin` (2,) [bins, beams]; wider than any frame if it is None."""
        return np.full(2, EVERYWHERE, np.int32) if self.margin is None else np.array(self.margin, np.int32)

    def bound(self, name: str) -> float:
        """Look up the largest change of one number of the pose.

        Args:
            name: One of yaw, x, y, z, roll and pitch.

        Returns:
            The largest change from the start, in [m] for x, y and z and in [rad] for the angles.
        """
        return dict(zip(ALL, (*self.bounds, *self.lean_bounds), strict=True))[name]


def _checked_margin(margin: Any) -> tuple[int, int]:
    """The margin as a tuple. Raises a SonarjaxError unless it is two whole numbers of 0 or more."""
    given = several(margin)
    if given is None or len(given) != 2:
        wrong = shown(margin) if given is None else given
        raise SonarjaxError(f"margin: expected two whole numbers (bins, beams), got {wrong}")
    for k, number in enumerate(given):
        check_whole(number, 0, f"margin[{k}]")
    return int(given[0]), int(given[1])
