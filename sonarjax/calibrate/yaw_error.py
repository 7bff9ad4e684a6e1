"""What an uncertain geometry of the sonar adds to a refined yaw's error bar: `geometry_std` of sonar.toml at work."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.parameters import PARAMETERS, changed_sonar
from sonarjax.engine import PLAIN, Engine
from sonarjax.refine import RefineConfig, refine_yaw
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


def stated_std(sonar: Sonar) -> dict[str, float]:
    """The standard deviations that `sonar.geometry_std` states [rad, m, 1], by name; those that are 0 are left out."""
    if sonar.geometry_std is None:
        return {}
    return {name: float(std) for name, std in vars(sonar.geometry_std).items() if float(std) > 0}


def yaw_std_of_geometry(
    image: Any, mesh: Mesh, sonar: Sonar, pose: Pose, stated: dict[str, float], config: RefineConfig, *,
    mask: Any = None, window: WindowSize | None = None, engine: Engine = PLAIN,
) -> float:  # fmt: skip
    """Standard deviation of yaw [rad] that comes from not knowing the sonar's geometry better than `stated`.

    The yaw is refined again from `pose` in the frame `image` (range, beam) with each stated number one standard
    deviation up and down. Half the difference is its share, and the shares add up in quadrature: the geometry's errors
    are taken to be independent, small enough for yaw to follow them linearly, and the same in all frames. `config`
    refines on the frame. Solving again is the slow way to the derivative of `refine_yaw`, and the safer one: it does
    not mind how rough the objective is over a tenth of a degree.
    """

    def solved(change: tuple[str, float]) -> float:
        name, by = change
        moved = _alike(changed_sonar(sonar, (name,), jnp.array([by])), sonar)
        return float(refine_yaw(image, mesh, moved, pose, mask=mask, config=config, window=window, engine=engine).yaw)

    names = [name for name in PARAMETERS if name in stated]
    yaws = engine.map(solved, [(name, side * stated[name]) for name in names for side in (-1, 1)])
    shares = [math.remainder(up - down, 2 * math.pi) / 2 for down, up in zip(yaws[::2], yaws[1::2], strict=True)]
    return math.hypot(*shares)


def _alike(moved: Sonar, sonar: Sonar) -> Sonar:
    """`moved` with leaves of the types that those of `sonar` have, so that both share compiled code."""

    def like(new: Any, old: Any) -> Any:
        return np.asarray(new, old.dtype) if hasattr(old, "dtype") else float(new)

    return jax.tree.map(like, moved, sonar)
