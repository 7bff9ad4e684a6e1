"""Checks of what a joint fit is given: frames, masks and poses."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import numpy as np

from sonarjax.engine import Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, image_array, number_array, shown
from sonarjax.render.fits import check_single
from sonarjax.render.region import rolled_azimuth
from sonarjax.render.simulate import check_sonar_alone
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.limits import check_pose
from sonarjax.scene.standing import check_above_floor
from sonarjax.sonar import Sonar
from sonarjax.sonar.image import check_values


def check_kinds(mesh: Any, sonar: Any, engine: Any) -> None:
    """Raise a SonarjaxError unless these are one mesh, one sonar and an engine."""
    check_single(mesh, "mesh")
    check_kind(engine, Engine, "engine")
    check_sonar_alone(sonar)


def check_floor(mesh: Mesh, poses: Pose | None) -> None:
    """Raise a SonarjaxError if a mesh goes through the floor, and the poses (frame,) do not say so by a z of their own.

    Poses at which it leans are not looked at.
    """
    upright = np.ones(1, bool) if poses is None else (np.asarray(poses.roll) == 0) & (np.asarray(poses.pitch) == 0)
    z = np.zeros(1) if poses is None else np.asarray(poses.z)
    if (upright & (z == 0)).any():
        check_above_floor(mesh, "mesh")


def check_frames(frames: Any, masks: Any, sonar: Sonar) -> tuple[list[np.ndarray], list[np.ndarray | None]]:
    """Frames and masks (range, beam) as lists. Frames are 0 where not measured; a mask is None if everything was.

    Raises:
        SonarjaxError: As `calibrate`.
    """
    if isinstance(frames, str | os.PathLike) or not isinstance(frames, Iterable):
        raise SonarjaxError(f"frames: expected a sequence of images (range, beam), got {shown(frames)}")
    images = [np.asarray(image_array(image, f"frames[{k}]"), np.float32) for k, image in enumerate(frames)]
    if not images:
        raise SonarjaxError("frames: expected at least one frame")
    if isinstance(masks, str) or not isinstance(masks, Iterable | None):
        raise SonarjaxError(f"masks: expected a sequence of images (range, beam), got {shown(masks)}")
    given = [None] * len(images) if masks is None else list(masks)
    measured = [None if m is None else number_array(m, f"masks[{k}]").astype(bool) for k, m in enumerate(given)]
    if len(measured) != len(images):
        raise SonarjaxError(f"masks: expected one for each of the {len(images)} frames, got {len(measured)}")
    for number, (image, mask) in enumerate(zip(images, measured, strict=True)):
        for name, shape in (("frames", image.shape), ("masks", sonar.shape if mask is None else mask.shape)):
            if shape != sonar.shape:
                raise SonarjaxError(
                    f"{name}[{number}]: expected shape {sonar.shape} (range, beam) of the sonar, got {shape}"
                )
        if mask is not None and not mask.any():
            raise SonarjaxError(f"masks[{number}]: expected at least one pixel that was measured, all are False")
        check_values(image if mask is None else image[mask], f"frames[{number}]")
    if len(images) > 1 and all(np.array_equal(image, images[0]) for image in images):
        raise SonarjaxError(f"frames: expected different frames, all {len(images)} are the same")
    filled = [i if m is None else np.where(m, i, 0.0) for i, m in zip(images, measured, strict=True)]
    return [i.astype(np.float32) for i in filled], measured


def check_not_blank(images: Sequence[np.ndarray], measured: Sequence[np.ndarray | None]) -> None:
    """Raise a SonarjaxError if no frame (range, beam) shows anything: the fit would have nothing to go by."""
    if all(np.ptp(image if mask is None else image[mask]) == 0 for image, mask in zip(images, measured, strict=True)):
        raise SonarjaxError("frames: expected at least one that shows something, but each is of a single grey value")


def starts_of(poses: Pose, count: int, sonar: Sonar) -> list[Pose]:
    """Split the poses (frame,) into one for each frame.

    Raises:
        SonarjaxError: There are not `count` poses, one is not finite, or the object is out of view at one of them.
    """
    check_kind(poses, Pose, "poses")
    check_pose(poses)
    if poses.shape != (count,):
        raise SonarjaxError(f"poses: expected one for each of the {count} frames, got shape {poses.shape}")
    starts = [jax.tree.map(lambda v, k=k: np.asarray(v)[k], poses) for k in range(count)]
    edges = np.asarray(sonar.azimuth_edges)
    for number, pose in enumerate(starts):
        slant = math.hypot(pose.x, pose.y, float(sonar.height) - pose.z)
        azimuth = rolled_azimuth(pose.x, pose.y, pose.z, sonar, float(sonar.roll))
        if not (sonar.range_min < slant < sonar.range_max and edges[0] < azimuth < edges[-1]):
            place = f"x {float(pose.x):.3g} m, y {float(pose.y):.3g} m"
            raise SonarjaxError(f"poses[{number}]: expected the object in view, got {place}")
    return starts
