"""Which part of the image an object and its shadow can touch: sizes are fixed on the host, positions may be traced."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.render.frame import Window
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

MARGIN_BEAMS, MARGIN_BINS = 3, 12  # around what the object touches at any yaw; wider margins lower the correlation
# Window sizes are rounded up to multiples of these, so that windows of similar size share compiled code.
ROW_STEP, COLUMN_STEP, OBJECT_STEP = 64, 8, 4
MIN_SPACING = 1e-4  # least width of a single beam [rad]
TURNED = 1e-6  # sine of a turn beyond a quarter that is no rounding error
ROLLED_BEARINGS = 91  # bearings at which a rolled sonar's windows are measured: every 2 degrees


@dataclass(frozen=True)
class WindowSize:
    """Size of a window, planned on the host. Hashable, so that it can be a static argument under `jax.jit`."""

    shape: tuple[int, int]
    """Number of (range, beam) pixels."""
    object_columns: int | None = None
    """Most beams that the object itself can touch; None for all."""

    def __post_init__(self) -> None:
        """Turn a list into a tuple, which can be hashed."""
        object.__setattr__(self, "shape", tuple(self.shape))

    def holds(self, other: WindowSize) -> bool:
        """Tell whether a window of this size is large enough wherever one of another size is.

        Args:
            other: The other size.

        Returns:
            True if it is.
        """
        beams = self.object_columns is None or (other.object_columns or math.inf) <= self.object_columns
        return beams and all(mine >= needed for mine, needed in zip(self.shape, other.shape, strict=True))


def plan_window(
    mesh: Mesh, sonar: Sonar, ground_range: float, slack: float = 0.0, row_step: int = ROW_STEP
) -> WindowSize:
    """Plan the size of a window that holds an object and its shadow.

    This runs on the host and cannot be traced.

    Args:
        mesh: The object; holds concrete numbers.
        sonar: The sonar; holds concrete numbers.
        ground_range: Horizontal distance of the object [m].
        slack: How far the object may be from there [m].
        row_step: The window's rows are a multiple of this.

    Returns:
        The size, never more than the frame's.
    """
    shape = window_shape(mesh, sonar, ground_range, slack, row_step)
    return WindowSize(shape, object_columns(mesh, sonar, ground_range, slack))


def window_shape(
    mesh: Mesh, sonar: Sonar, ground_range: float, slack: float = 0.0, row_step: int = ROW_STEP
) -> tuple[int, int]:
    """Pixels (range, beam) that hold the object and its shadow at `ground_range` [m] and up to `slack` [m] around it.

    `sonar` must hold concrete numbers. Never more than the frame.
    """
    reach = float(mesh.radius) + slack
    near, far = _slant_extent(mesh, sonar, ground_range, slack)
    rows = math.ceil((far - near) / float(sonar.range_bin)) + 2 * MARGIN_BINS + 4
    columns = math.ceil(_azimuth_width(mesh, sonar, ground_range, reach) / _spacing(sonar)) + 2 * MARGIN_BEAMS + 2
    rows, columns = -(-rows // row_step) * row_step, -(-columns // COLUMN_STEP) * COLUMN_STEP
    return min(max(rows, row_step), sonar.n_ranges), min(columns, sonar.n_beams)


def object_columns(mesh: Mesh, sonar: Sonar, ground_range: float, slack: float = 0.0) -> int:
    """Most beams that the object itself can touch at `ground_range` [m] and up to `slack` [m] around it.

    `sonar` must hold concrete numbers.
    """
    width = _azimuth_width(mesh, sonar, ground_range, float(mesh.radius) + slack)
    columns = math.ceil(width / _spacing(sonar)) + 2
    return min(-(-columns // OBJECT_STEP) * OBJECT_STEP, sonar.n_beams)


def _spacing(sonar: Sonar) -> float:
    """Smallest angle [rad] between neighbouring beams."""
    azimuth = np.asarray(sonar.azimuth)
    return float(np.diff(azimuth).min()) if azimuth.size > 1 else max(float(sonar.beam_width), MIN_SPACING)


def _azimuth_width(mesh: Mesh, sonar: Sonar, ground_range: float, reach: float) -> float:
    """Width in azimuth [rad] of a window centred on `image_azimuth` that holds a cylinder of radius `reach` [m]."""
    # Without roll the cylinder is widest straight ahead. With roll it leans aside, at each bearing by another angle.
    roll = float(sonar.roll)
    bearings = (np.linspace(-math.pi / 2, math.pi / 2, ROLLED_BEARINGS) if roll else np.zeros(1))[:, None, None]
    around = np.linspace(0, 2 * math.pi, 65)
    x, y = ground_range * np.cos(bearings), ground_range * np.sin(bearings)
    heights = np.array([[0.0], [max(float(mesh.top), 0.0)]])
    rings = rolled_azimuth(x + reach * np.cos(around), y + reach * np.sin(around), heights, sonar, roll)
    aside = np.abs(rings - rolled_azimuth(x, y, 0.0, sonar, 0.0))  # (bearing, height, point)
    seen = _in_view(rings, sonar) if roll else np.ones(1, bool)
    return min(2 * float(aside[seen].max()), math.pi) if seen.any() else math.pi


def rolled_azimuth(x: Any, y: Any, z: Any, sonar: Sonar, roll: float) -> Any:
    """Azimuth [rad] of ground points x, y, z [m] in the frame of a sonar tilted, and rolled by `roll` [rad].

    On the host.
    """
    tilt, below = float(sonar.tilt), float(sonar.height) - z
    forward = math.cos(tilt) * x + math.sin(tilt) * below
    upward = math.sin(tilt) * x - math.cos(tilt) * below
    return np.arctan2(math.cos(roll) * y + math.sin(roll) * upward, forward)


def _in_view(azimuth: np.ndarray, sonar: Sonar) -> np.ndarray:
    """Which cylinders (bearing,) reach into the field of view, given the azimuths (bearing, height, point) of each."""
    edges = np.asarray(sonar.azimuth_edges)
    return (azimuth.max(axis=(1, 2)) > edges[0]) & (azimuth.min(axis=(1, 2)) < edges[-1])


def _slant_extent(mesh: Mesh, sonar: Sonar, ground_range: float, slack: float) -> tuple[float, float]:
    height, reach, top = float(sonar.height), float(mesh.radius) + slack, float(mesh.top)
    near_ground = max(ground_range - reach, 0.0)
    near = math.hypot(near_ground, max(height - top, 0.0))
    if top >= height * 0.95:
        return near, float(sonar.range_max)
    shadow_end = (ground_range + reach) * height / (height - max(top, 0.0))
    return near, min(math.hypot(shadow_end, height), float(sonar.range_max))


def place_window(size: WindowSize, mesh: Mesh, sonar: Sonar, x: Any, y: Any, slack: float = 0.0) -> Window:
    """Place a window of planned size around an object, shifted to lie inside the frame.

    Args:
        size: Size of the window, from `plan_window`.
        mesh: The object.
        sonar: The sonar.
        x, y: Ground position of the object [m], forward and to port; may be traced.
        slack: How far the object may be from there [m], as in `plan_window`.

    Returns:
        The window.
    """
    shape = size.shape
    x, y, height = (jnp.asarray(v, jnp.float32) for v in (x, y, sonar.height))
    ground = jnp.hypot(x, y)
    near = jnp.hypot(jnp.maximum(ground - mesh.radius - slack, 0.0), jnp.maximum(height - mesh.top, 0.0))
    row = jnp.floor((near - sonar.range_min) / sonar.range_bin).astype(jnp.int32) - 2 - MARGIN_BINS
    bearing = image_azimuth(x, y, sonar)
    column = jnp.searchsorted(jnp.asarray(sonar.azimuth), bearing).astype(jnp.int32) - shape[1] // 2
    row = jnp.clip(row, 0, sonar.n_ranges - shape[0])
    return Window(row, jnp.clip(column, 0, sonar.n_beams - shape[1]), shape, size.object_columns)


def leaning_room(mesh: Mesh, lift: Any, roll: Any, pitch: Any) -> Mesh:
    """The mesh with the radius and top it has when lifted by `lift` [m] and tilted by `roll` and `pitch` [rad] or less.

    Windows are sized by radius and top; the vertices stay as they are. For an upright object on the floor both are
    unchanged. Nothing is compiled unless a number is traced.
    """
    given = mesh.vertices, mesh.radius, mesh.top, lift, roll, pitch
    traced = any(isinstance(v, jax.core.Tracer) for v in given)
    array: Any = jnp if traced else np
    vertices, radius, top = (v if traced else np.asarray(v) for v in given[:3])
    # Roll and pitch together tilt the vertical of the mesh by arccos(cos roll · cos pitch).
    upright = array.cos(array.clip(roll, 0.0, math.pi / 2)) * array.cos(array.clip(pitch, 0.0, math.pi / 2))
    over = array.sqrt(array.maximum(1 - upright**2, 0.0))
    hanging = -vertices[..., 2].min(axis=-1)
    arm = array.maximum(array.maximum(top, 0.0), hanging)  # the farther end swings aside
    # Turned by more than a quarter, what hangs below the origin points upwards.
    turned = array.maximum(-array.cos(array.clip(roll, 0.0, math.pi)), -array.cos(array.clip(pitch, 0.0, math.pi)))
    top = array.where(turned > TURNED, array.maximum(top, hanging * turned), top)
    extent = radius + arm * over, top + radius * over + array.maximum(lift, 0.0)
    # `device_put` compiles nothing, unlike `jnp.asarray`.
    wide, high = (v if traced else jax.device_put(np.asarray(v, np.float32)) for v in extent)
    return replace(mesh, radius=wide, top=high)


def plan_window_at(mesh: Mesh, sonar: Sonar, poses: Sequence[Pose], slack: float) -> WindowSize:
    """One window size that holds an object at each of several poses, also where it is lifted or leans. On the host.

    Args:
        mesh: The object; holds concrete numbers.
        sonar: The sonar; holds concrete numbers.
        poses: Single poses [m, rad].
        slack: How far the object may be from them [m].

    Returns:
        The largest size over the poses, never more than the frame's.
    """
    roomy = [leaning_room(mesh, pose.z, abs(pose.roll), abs(pose.pitch)) for pose in poses]
    away = [float(np.hypot(pose.x, pose.y)) for pose in poses]
    shapes = [window_shape(one, sonar, far, slack) for one, far in zip(roomy, away, strict=True)]
    touched = [object_columns(one, sonar, far, slack) for one, far in zip(roomy, away, strict=True)]
    return WindowSize((max(rows for rows, _ in shapes), max(columns for _, columns in shapes)), max(touched))


def image_azimuth(x: Any, y: Any, sonar: Sonar) -> Any:
    """Return the azimuth of a floor point in the sonar frame, tilted but without roll.

    Args:
        x, y: Ground position of the point [m], forward and to port.
        sonar: The sonar.

    Returns:
        Azimuth [rad].
    """
    forward = jnp.cos(jnp.asarray(sonar.tilt)) * x + jnp.sin(jnp.asarray(sonar.tilt)) * sonar.height
    return jnp.arctan2(jnp.asarray(y, jnp.float32), forward)


def floor_point(slant_range: Any, azimuth: Any, sonar: Sonar) -> tuple[Any, Any]:
    """Return the floor point that is seen at a slant range and an image azimuth.

    Roll is ignored.

    Args:
        slant_range: Slant range of the point [m].
        azimuth: Image azimuth of the point [rad], as from `image_azimuth`.
        sonar: The sonar.

    Returns:
        Ground position x, y [m], forward and to port.
    """
    ground = jnp.sqrt(jnp.maximum(jnp.asarray(slant_range) ** 2 - jnp.asarray(sonar.height) ** 2, 1e-6))
    tan = jnp.tan(jnp.asarray(azimuth))
    ct, lift = jnp.cos(jnp.asarray(sonar.tilt)), jnp.sin(jnp.asarray(sonar.tilt)) * sonar.height
    # y = tan·(ct·x + lift) on the circle x² + y² = ground² is a quadratic in x; its forward root is the point seen.
    a, b, c = 1 + (tan * ct) ** 2, tan * tan * ct * lift, (tan * lift) ** 2 - ground**2
    x = (-b + jnp.sqrt(jnp.maximum(b * b - a * c, 0.0))) / a
    return x, tan * (ct * x + lift)
