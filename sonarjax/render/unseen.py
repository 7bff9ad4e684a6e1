"""Why a rendered object is not to be seen: where it lies beside the sonar's range window, beams and aperture."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from sonarjax.render.frame import SonarFrame
from sonarjax.render.window import in_sonar_frame
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar


def why_unseen(frame: SonarFrame, mesh: Mesh, pose: Pose) -> str:
    """Say why no pixel of a frame is labelled highlight or shadow.

    Args:
        frame: The frame (range, beam), without a batch axis.
        mesh: The object that was rendered.
        pose: Its pose [m, rad].

    Returns:
        All reasons that can be told from the object's corners, in words.
    """
    if bool((np.asarray(frame.highlight) > 0).any() or (np.asarray(frame.shadow) > 0).any()):
        return "it is too small, it fills no pixel by half"
    scene = in_sonar_frame(mesh, pose, frame.sonar)
    corners = np.asarray(scene.vertices, np.float64)
    found = [reason for reason in (_range(corners, frame.sonar), _side(corners, frame.sonar)) if reason]
    if not _is_behind(corners):
        found += [reason for reason in (_height(corners, frame.sonar),) if reason]
    return "it is " + (" and ".join(found) or "outside the sonar's view, or too small for it")


def _is_behind(corners: Float[np.ndarray, "corner 3"]) -> bool:
    return bool((corners[:, 0] <= 0).all())


def _range(corners: Float[np.ndarray, "corner 3"], sonar: Sonar) -> str:
    ranges = np.linalg.norm(corners, axis=1)
    near, far = float(sonar.range_min), float(sonar.range_max)
    if ranges.max() < near:
        return f"nearer than the range window ({ranges.max():.3g} m at most, it begins at {near:.3g} m)"
    if ranges.min() > far:
        return f"farther than the range window ({ranges.min():.3g} m at least, it ends at {far:.3g} m)"
    return ""


def _side(corners: Float[np.ndarray, "corner 3"], sonar: Sonar) -> str:
    if _is_behind(corners):
        return "behind the sonar"
    edges = np.asarray(sonar.azimuth_edges, np.float64)
    azimuth = np.arctan2(corners[:, 1], corners[:, 0])
    if azimuth.min() > edges[-1]:
        return f"beside the field of view, to port ({math.degrees(azimuth.min()):.3g} deg at least)"
    if azimuth.max() < edges[0]:
        return f"beside the field of view, to starboard ({-math.degrees(azimuth.max()):.3g} deg at least)"
    return ""


def _height(corners: Float[np.ndarray, "corner 3"], sonar: Sonar) -> str:
    elevation = np.arctan2(corners[:, 2], np.hypot(corners[:, 0], corners[:, 1]))
    half = float(sonar.elevation_aperture) / 2
    if elevation.min() > half:
        return "above the aperture"
    return "below the aperture" if elevation.max() < -half else ""
