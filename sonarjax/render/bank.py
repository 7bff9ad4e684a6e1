"""The template bank: the object's semantic image at many yaws, cropped to one box (§2.1, §4.2, Fig. 7)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax._cores import SINGLE_CORE, on_all_cores
from sonarjax.io.errors import SonarjaxError
from sonarjax.render.frame import semantic_image
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS, image_azimuth, object_columns, place_window, window_shape
from sonarjax.render.window import Window, render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

VIEWS = 9  # rendered by one call of the compiled function
TOUCHED = 0.01  # a pixel belongs to the object when its semantic value is this far from the background's


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TemplateBank:
    """Templates of one object at one place, for a list of yaws."""

    templates: Float[Array, "yaw h w"]
    """Semantic images (yaw, range, beam), all cropped to the same box."""
    yaws: Float[Array, "yaw"]
    """Absolute yaw of each template at the bank's place [rad]."""
    offset: tuple[int, int] = field(default=(0, 0), metadata={"static": True})
    """Row and column of the box's first pixel in the frame."""
    x: float = field(default=0.0, metadata={"static": True})
    """Forward position of the object [m]."""
    y: float = field(default=0.0, metadata={"static": True})
    """Position to port of the object [m]."""
    tilt: float = field(default=0.0, metadata={"static": True})
    """Tilt of the sonar it was rendered for [rad]."""

    @property
    def bearing(self) -> float:
        """Bearing of the object from the sonar [rad]."""
        return float(np.arctan2(self.y, self.x))

    @property
    def ground_range(self) -> float:
        """Horizontal distance of the object from the sonar [m]."""
        return float(np.hypot(self.x, self.y))


def template_bank(
    mesh: Mesh,
    sonar: Sonar,
    yaws: Any,
    *,
    x: float,
    y: float = 0.0,
    sub_beams: int = 1,
    elevations: int = 64,
    margin: tuple[int, int] = (MARGIN_BINS, MARGIN_BEAMS),
    shape: tuple[int, int] | None = None,
    beams: int | None = None,
) -> TemplateBank:
    """Render the object at (x, y) [m] at each of `yaws` (yaw,) [rad], cropped to one box with a `margin` (bins, beams).

    Views are rendered one after another in a window around the object, so memory grows only with the templates;
    `shape` (range, beam) [pixels] sets the window's size and `beams` how many of them the object itself may touch, so
    that banks at several places share compiled code.
    Raises SonarjaxError when `yaws` is empty or not finite, or the object is outside the sonar's view.
    """
    yaws = np.atleast_1d(np.asarray(yaws, np.float32))
    if yaws.ndim != 1 or yaws.size == 0 or not np.isfinite(yaws).all():
        raise SonarjaxError(f"yaws: expected a non-empty list of finite angles [rad], got shape {yaws.shape}")
    shape = shape or window_shape(mesh, sonar, float(np.hypot(x, y)))
    row, column = (int(v) for v in _corner(mesh, sonar, x, y, shape))
    settings = (shape, beams or object_columns(mesh, sonar, float(np.hypot(x, y))), sub_beams, elevations)
    views = on_all_cores(lambda part: _render_views(mesh, sonar, part, x, y, (row, column), *settings), yaws, VIEWS)
    images = np.asarray(views)
    box = _touched_box(images)
    if box is None:
        raise SonarjaxError(f"template bank: an object at x {x:.2f} m, y {y:.2f} m is outside the sonar's view")
    first, last = box
    top, left = max(first[0] - margin[0], 0), max(first[1] - margin[1], 0)
    bottom, right = min(last[0] + margin[0], shape[0] - 1), min(last[1] + margin[1], shape[1] - 1)
    crop = jnp.asarray(images[:, top : bottom + 1, left : right + 1])
    return TemplateBank(crop, jnp.asarray(yaws), (row + top, column + left), float(x), float(y), float(sonar.tilt))


@partial(jax.jit, static_argnames="shape")
def _corner(mesh: Mesh, sonar: Sonar, x: Any, y: Any, shape: tuple[int, int]) -> tuple[Any, Any]:
    window = place_window(shape, mesh, sonar, x, y)
    return window.row, window.column


@partial(jax.jit, static_argnames=("shape", "beams", "sub_beams", "elevations"), compiler_options=SINGLE_CORE)
def _render_views(
    mesh: Mesh, sonar: Sonar, yaws: Any, x: Any, y: Any, corner: Any,
    shape: tuple[int, int], beams: int, sub_beams: int, elevations: int,
) -> Float[Array, "yaw range beam"]:  # fmt: skip
    window = Window(corner[0], corner[1], shape, beams)

    def one(yaw: Array) -> Array:
        return semantic_window(mesh, Pose(x, y, yaw), sonar, window, sub_beams, elevations)

    return jax.lax.map(one, jnp.asarray(yaws))


def semantic_window(
    mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, sub_beams: int, elevations: int
) -> Float[Array, "range beam"]:
    """The semantic image (range, beam) of one window of the frame; differentiable like `render`."""
    layers = render_window(mesh, pose, sonar, window, sub_beams, elevations)
    return semantic_image(layers.highlight, layers.shadow)


def _touched_box(images: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    touched = np.any(np.abs(images - 0.5) > TOUCHED, axis=0)
    if not touched.any():
        return None
    rows, columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
    return (int(rows[0]), int(columns[0])), (int(rows[-1]), int(columns[-1]))


def bank_place(bank: TemplateBank, sonar: Sonar) -> tuple[float, float]:
    """Slant range [m] of the floor under the object's origin and its image azimuth [rad]: what matching shifts."""
    return float(np.hypot(bank.ground_range, float(sonar.height))), float(_image_azimuth(bank.x, bank.y, sonar))


_image_azimuth = jax.jit(image_azimuth)
