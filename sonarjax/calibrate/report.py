"""A calibration for people to read: its text, and what a picture of it shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from sonarjax.calibrate.calibration import Calibration
from sonarjax.calibrate.parameters import INCIDENCE, PARAMETERS
from sonarjax.render import render
from sonarjax.scene import Mesh
from sonarjax.sonar import Sonar

UNITS = {"rad": ("°", math.degrees(1.0)), "deg": ("°", 1.0), "m": (" m", 1.0), "1": (" %", 100.0)}
"""How a unit is shown, and the factor on its numbers."""
SHOWN = 4
"""Most frames in a picture."""
LOOSE = 0.35
"""Least share of a number in an undetermined direction [1] for which the number is named."""


def describe_calibration(found: Calibration, nominal: Sonar, frames: Sequence[str]) -> str:
    """Describe a calibration in several lines of text.

    Each free number has a line, with its change and standard deviation, and its Cramér-Rao bound if that is larger; or
    with a note that it is not determined. If any is not, a line names the least determined combination. A line warns if
    the fit did not converge. Each frame has a line.

    Args:
        found: The calibration.
        nominal: The sonar that was calibrated.
        frames: Name of each frame.

    Returns:
        The text.
    """
    lines = [_line(found, nominal, k) for k in range(len(found.free))]
    if not all(found.determined.values()):
        named = [f"{share:+.2f} {name}" for name, share in found.weakest.items() if abs(share) >= LOOSE]
        lines.append(f"least determined combination, in units of the priors: {' '.join(named)}")
    if not found.converged:
        lines.append("the fit did not converge: its numbers may be wrong")
    for k, name in enumerate(frames):
        state = f"residual {found.residual[k]:.2f}" if found.used[k] else "left out"
        yaw = math.degrees(float(np.asarray(found.poses.yaw)[k]))
        lines.append(f"{name}: {state}, target with probability {found.probability[k]:.2f}, yaw {yaw:.1f}°")
    return "\n".join(lines)


def _line(found: Calibration, nominal: Sonar, k: int) -> str:
    name = found.free[k]
    unit, scale = UNITS[PARAMETERS[name].unit]
    change, std = scale * found.change[k], scale * math.sqrt(found.covariance[k, k])
    if not found.determined[name]:
        where = "which show no limit" if name == INCIDENCE and change > 0 else "left at its nominal value"
        return f"{name}: not determined by these frames, {where}"
    value = getattr(nominal, name, None)
    total = "" if value is None else f"{scale * float(value) + change:.4g}{unit}, "
    bound = scale * found.bound[name]
    larger = f" (Cramér-Rao bound {bound:.2g}{unit}: take this larger error bar)" if bound > std else ""
    return f"{name}: {total}changed by {change:+.3g}{unit} ± {std:.2g}{unit}{larger}"


def compare_templates(
    found: Calibration, images: Sequence[Any], mesh: Mesh, nominal: Sonar
) -> tuple[list[Any], list[Any], list[Any]]:
    """Render the target's semantic maps for the nominal and for the fitted sonar, at some of the frames that were used.

    Args:
        found: The calibration.
        images: The frames that were calibrated from, each (range, beam).
        mesh: The target.
        nominal: The sonar that was calibrated.

    Returns:
        At most `SHOWN` of the frames, their maps for the nominal sonar and those for the fitted one, all (range, beam).
    """
    which = np.flatnonzero(found.used)[:SHOWN]
    poses = [jax.tree.map(lambda v, k=k: np.asarray(v)[k], found.poses) for k in which]

    def drawn(sonar: Sonar) -> list[Any]:
        return [np.asarray(render(mesh, pose, sonar.replace(geometry_std=None)).semantic()) for pose in poses]

    return [images[k] for k in which], drawn(nominal), drawn(found.sonar)
