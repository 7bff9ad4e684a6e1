"""The six numbers of a pose that refinement can free: their order, units and largest steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import shown
from sonarjax.scene import Pose
from sonarjax.sensor.echoes import FLOOR_PATHS


class Number(NamedTuple):
    """One number of a pose."""

    trust: float
    """Largest step in one iteration [unit]."""
    displacement: float
    """Displacement for central differences [unit], longer than the roughness that pixels give the objective."""
    unit: str
    """rad or m."""


NUMBERS: dict[str, Number] = {
    "yaw": Number(0.12, 6e-3, "rad"),
    "x": Number(0.02, 1.5e-3, "m"),
    "y": Number(0.02, 1.5e-3, "m"),
    "z": Number(0.02, 1.5e-3, "m"),
    "roll": Number(0.12, 6e-3, "rad"),
    "pitch": Number(0.12, 6e-3, "rad"),
}
"""The numbers that may be free, in the order in which every result holds them."""
ON_FLOOR = ("yaw", "x", "y")
"""The numbers that are free for an object standing on the floor, as in `refine_yaw`."""
ALL = tuple(NUMBERS)
"""All six numbers."""
BOUNCES = (Number(0.2, 2e-2, "1"),) * len(FLOOR_PATHS)
"""The energies left of echoes by way of the floor (`FLOOR_PATHS`). They are fitted together with the pose, and follow
its numbers in a step."""


def check_free(free: Sequence[str]) -> tuple[str, ...]:
    """The names in the order of `NUMBERS`. Raises SonarjaxError for no name, an unknown or a repeated one."""
    return in_order(free, NUMBERS)


def in_order(free: Sequence[str], known: Iterable[str]) -> tuple[str, ...]:
    """The names of `free` in the order of the `known` ones.

    Raises:
        SonarjaxError: There are none, or a name is unknown or given twice.
    """
    if not isinstance(free, Iterable):
        raise SonarjaxError(f"free: expected names, got {shown(free)}")
    names, order = [free] if isinstance(free, str) else list(free), list(known)
    unknown = [name for name in names if name not in order]
    if unknown or not names or len(set(names)) < len(names):
        what = f"unknown {unknown[0]!r}" if unknown else f"got {names}"
        raise SonarjaxError(f"free: expected names from this list, each once: {', '.join(order)}; {what}")
    return tuple(name for name in order if name in names)


def trusts(free: Sequence[str]) -> tuple[float, ...]:
    """Largest step of each `free` number, and of the bounces' energies."""
    return *(NUMBERS[name].trust for name in free), *(bounce.trust for bounce in BOUNCES)


def displacements(free: Sequence[str]) -> tuple[float, ...]:
    """Displacements of central differences by each `free` number, and by the bounces' energies."""
    return *(NUMBERS[name].displacement for name in free), *(bounce.displacement for bounce in BOUNCES)


def wrapped(yaw: Any) -> Any:
    """Yaws [rad], NumPy's or JAX's in float32, in [0, 2π)."""
    once = np.float32(2 * np.pi)
    turned = yaw % once
    return turned * (turned < once)  # a tiny negative yaw is rounded up to 2π


def pose_at(start: Pose, step: Float[Array, "step"], free: Sequence[str]) -> Pose:
    """`start` changed by the first numbers of `step`, which are those of `free` [rad, m]."""
    return replace(start, **{name: getattr(start, name) + step[k] for k, name in enumerate(free)})
