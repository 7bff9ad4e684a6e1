"""How much an uncertain geometry of the sonar (`geometry_std` of sonar.toml) adds to the error bar of a refined yaw."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.calibrate.parameters import INCIDENCE, INCIDENCE_DEG, PARAMETERS, changed_sonar
from sonarjax.engine import PLAIN, Engine
from sonarjax.refine import RefineConfig, refine_yaw
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


def stated_std(sonar: Sonar) -> dict[str, float]:
    """Return the standard deviations that a sonar states of its geometry.

    Args:
        sonar: The sonar; its `geometry_std` is read.

    Returns:
        Standard deviations [in the units of `PARAMETERS`] by name, without those that are 0; empty if the sonar states
        none.
    """
    if sonar.geometry_std is None:
        return {}
    return {name: float(std) for name, std in vars(sonar.geometry_std).items() if float(std) > 0}


def yaw_std_of_geometry(
    image: Any, mesh: Mesh, sonar: Sonar, pose: Pose, stated: dict[str, float], config: RefineConfig, *,
    mask: Any = None, window: WindowSize | None = None, engine: Engine = PLAIN,
) -> float:  # fmt: skip
    """Return the standard deviation of yaw that an uncertain geometry of the sonar causes.

    The yaw is refined again from `pose`: once with the sonar as it is, and with each stated number one standard
    deviation up and down. The root mean square of the two changes is the share of that number, so it also counts if yaw
    turns the same way for both. The shares are added in quadrature. An incidence limit counts only if the sonar has
    one. This assumes that the errors of the geometry are independent and the same in all frames. The derivative of
    `refine_yaw` would be faster. Refining again is safer, because an objective that is rough within a tenth of a degree
    does not disturb it. Source: Rosenblueth, Point estimates for probability moments, PNAS 72, 1975, who estimates a
    variance from two such points; here it is taken about the yaw of the unchanged sonar, not about the mean of the two.

    Args:
        image: The frame (range, beam).
        mesh: The target.
        sonar: The sonar.
        pose: The refined pose [m, rad].
        stated: Standard deviations [in the units of `PARAMETERS`] by name, from `stated_std`.
        config: How to refine; it must refine on the frame.
        mask: True where the frame was measured (range, beam); None for everywhere.
        window: Size of the window; None plans it.
        engine: Runs the compiled functions.

    Returns:
        Standard deviation of yaw [rad].
    """

    names = [name for name in PARAMETERS if name in stated and not (name == INCIDENCE and _has_no_limit(sonar))]
    if not names:
        return 0.0

    def solved(change: tuple[str, float]) -> float:
        name, by = change
        moved = _alike(changed_sonar(sonar, (name,), jnp.array([by])), sonar)
        return float(refine_yaw(image, mesh, moved, pose, mask=mask, config=config, window=window, engine=engine).yaw)

    changes = [(name, side * stated[name]) for name in names for side in (-1, 1)]
    unchanged, *yaws = engine.map(solved, [(names[0], 0.0), *changes])
    return math.hypot(*(math.remainder(yaw - unchanged, 2 * math.pi) for yaw in yaws)) / math.sqrt(2)


def _has_no_limit(sonar: Sonar) -> bool:
    return float(sonar.highlight_max_incidence) >= INCIDENCE_DEG[1]


def _alike(moved: Sonar, sonar: Sonar) -> Sonar:
    """`moved` with leaves of the same types as those of `sonar`, so that both share compiled code."""

    def like(new: Any, old: Any) -> Any:
        return np.asarray(new, old.dtype) if hasattr(old, "dtype") else float(new)

    return jax.tree.map(like, moved, sonar)
