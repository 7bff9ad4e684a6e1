"""The template bank: the object's semantic map at many yaws, cropped to one box (§2.1, §4.2, Fig. 7)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import OutOfViewError, SonarjaxError
from sonarjax.io.given import check_kind, is_number, is_whole, number_array, shown
from sonarjax.records import record
from sonarjax.render.fits import check_single
from sonarjax.render.frame import BACKGROUND, RenderQuality
from sonarjax.render.region import (
    MARGIN_BEAMS,
    MARGIN_BINS,
    WindowSize,
    image_azimuth,
    leaning_room,
    place_window,
    plan_window,
)
from sonarjax.render.simulate import check_sonar_alone, one_by_one, with_enough_room
from sonarjax.render.visibility import EXACT_LIMIT
from sonarjax.render.window import render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.mesh import check_reflectivity
from sonarjax.sonar import Sonar

BANK_QUALITY = RenderQuality(sub_beams=1)
ROW_STEP = 32  # rows of a window are rounded up to multiples of this: a finer step than elsewhere, as every view pays
VIEWS, FEW_VIEWS = 18, 9  # templates that one call of the compiled function renders: half or a quarter of most banks
VMAPPED = 36  # the same on an accelerator, where they are rendered at once
ROUGH = 16  # with this many times more sharp edges than slabs may end at, few slabs would end at the right ones
TOUCHED = 0.01  # a pixel belongs to the object when its semantic value is this far from the background's


@record
class TemplateBank:
    """Templates of one object at one place, for a list of yaws."""

    templates: Float[Array, "*batch yaw h w"]
    """Semantic maps (yaw, range, beam), all cropped to the same box."""
    yaws: Float[Array, "*batch yaw"]
    """Absolute yaw of each template [rad], for an object at the bank's place."""
    offset: Int[Array, "*batch 2"]
    """Row and column of the box's first pixel in the frame."""
    x: Float[Array, "*batch"]
    """Forward position of the object [m]."""
    y: Float[Array, "*batch"]
    """Position to port of the object [m]."""
    tilt: Float[Array, "*batch"]
    """Tilt of the sonar for which the bank was rendered [rad]."""

    @property
    def bearing(self) -> Float[Array, "*batch"]:
        """Bearing of the object from the sonar [rad]."""
        return jnp.arctan2(self.y, self.x)

    @property
    def ground_range(self) -> Float[Array, "*batch"]:
        """Horizontal distance of the object from the sonar [m]."""
        return jnp.hypot(self.x, self.y)


def template_bank(
    mesh: Mesh,
    sonar: Sonar,
    yaws: Any,
    *,
    x: float,
    y: float = 0.0,
    z: Any = 0.0,
    roll: Any = 0.0,
    pitch: Any = 0.0,
    quality: RenderQuality = BANK_QUALITY,
    margin: tuple[int, int] = (MARGIN_BINS, MARGIN_BEAMS),
    size: WindowSize | None = None,
    engine: Engine = PLAIN,
) -> TemplateBank:
    """Render the object at one place for each yaw, cropped to one box.

    Views are rendered a few at a time in a window around the object, so memory grows only with the templates. This runs
    on the host and cannot be traced.

    Args:
        mesh: The object.
        sonar: The sonar that looks.
        yaws: Absolute yaws (yaw,) [rad].
        x: Forward position [m].
        y: Position to port [m].
        z: Height [m], one number or one for each yaw (yaw,).
        roll: Roll [rad], one number or one for each yaw (yaw,).
        pitch: Pitch [rad], one number or one for each yaw (yaw,).
        quality: How finely to render.
        margin: Range bins and beams (0 or more) around what the object touches at any yaw, as far as the frame goes.
        size: Size of the window to render. Banks at several places share compiled code if they share it. It must hold
            the object at this place (`WindowSize.holds`). None plans it for this place.
        engine: Runs the compiled functions.

    Returns:
        The bank, with templates (yaw, range, beam).

    Raises:
        SonarjaxError: An argument is of another kind, or a batch; `yaws` is empty; a number is not finite; z, roll,
            pitch or the mesh's reflectivity has another length; `margin` is negative; or `size` is too small.
        OutOfViewError: The object is outside the sonar's view.
    """
    _check_given(mesh, sonar, quality, margin, {"x": x, "y": y})
    check_kind(engine, Engine, "engine")
    if size is not None:
        check_kind(size, WindowSize, "size")
    check_reflectivity(mesh, "mesh")
    yaws = np.atleast_1d(number_array(yaws, "yaws")).astype(np.float32)
    if yaws.ndim != 1 or yaws.size == 0 or not np.isfinite(yaws).all():
        raise SonarjaxError(f"yaws: expected a non-empty list of finite angles [rad], got shape {yaws.shape}")
    attitudes = _attitudes(yaws, {"z": z, "roll": roll, "pitch": pitch})
    room = quick(leaning_room(mesh, attitudes[:, 1].max(), *np.abs(attitudes[:, 2:]).max(axis=0)))
    planned = plan_window(room, sonar, float(np.hypot(x, y)), row_step=ROW_STEP if size is None else 1)
    size = size or planned
    if not size.holds(planned):
        raise SonarjaxError(f"size: expected one that holds {planned}, what this place needs, got {size}")
    place = np.float32(x), np.float32(y)
    views = _all_views(room, sonar, attitudes, place, size, quality, engine)
    images, (row, column) = views.images, views.corner
    touched = _touched_box(images)
    if touched is None:
        raise OutOfViewError(f"template bank: an object at x {x:.2f} m, y {y:.2f} m is outside the sonar's view")
    box = _within_frame(touched, (row, column), margin, sonar)
    crop = _cropped(images, (row, column), box)
    offset = np.array([rows_or_columns.start for rows_or_columns in box], np.int32)
    # `device_put` compiles nothing; `jnp.asarray` would compile a copy for every shape.
    return TemplateBank(*(jax.device_put(v) for v in (crop, yaws, offset, *place, np.float32(sonar.tilt))))


def _check_given(mesh: Mesh, sonar: Sonar, quality: RenderQuality, margin: Any, place: dict[str, Any]) -> None:
    check_single(mesh, "mesh")
    check_sonar_alone(sonar)
    check_kind(quality, RenderQuality, "quality")
    if np.shape(margin) != (2,) or not all(is_whole(v) and v >= 0 for v in margin):
        raise SonarjaxError(f"margin: expected two whole numbers of 0 or more, got {shown(str(margin))}")
    for name, value in place.items():
        if not is_number(value) or not np.isfinite(value):
            raise SonarjaxError(f"{name}: expected a finite number of metres, got {shown(value)}")


def quick(mesh: Mesh) -> Mesh:
    """The mesh without slabs that end at its sharp edges, if it has too many of these and of triangles.

    Slabs at a few of thousands of edges make no view of a rough body exact, and a bank is never differentiated. It
    saves half the time.
    """
    rough = mesh.crossings > EXACT_LIMIT and mesh.crease.shape[-1] > ROUGH * mesh.events
    return replace(mesh, events=0) if rough else mesh


def _attitudes(yaws: np.ndarray, others: dict[str, Any]) -> np.ndarray:
    """Yaw, z, roll and pitch of each template (yaw, 4). Raises SonarjaxError for a wrong shape or non-finite number."""
    for name, value in others.items():
        if np.shape(value) not in ((), yaws.shape) or not np.isfinite(number_array(value, name)).all():
            raise SonarjaxError(f"{name}: expected a finite number or one for each of {len(yaws)} yaws")
    return np.stack([yaws, *(np.broadcast_to(np.asarray(v, np.float32), yaws.shape) for v in others.values())], axis=1)


class BankViews(NamedTuple):
    """All views of a bank, as the compiled function returns them or as arrays on the host."""

    images: Any
    """Semantic maps (yaw, range, beam) of one window."""
    corner: Any
    """Row and column of the window's first pixel."""
    overflow: Any
    """As in `SonarFrame`; the largest of all views."""


def _all_views(
    mesh: Mesh,
    sonar: Sonar,
    attitudes: np.ndarray,
    place: Any,
    size: WindowSize,
    quality: RenderQuality,
    engine: Engine,
) -> BankViews:
    """Render all views, a few at a time, so that banks of any length share compiled code. The last part is filled up by
    repeating the last view.
    """
    size_of_part = _views_at_once(len(attitudes), engine)
    parts = -(-len(attitudes) // size_of_part)
    filler = np.repeat(attitudes[-1:], parts * size_of_part - len(attitudes), axis=0)
    padded = np.concatenate([attitudes, filler]).reshape(parts, size_of_part, -1)

    def render_part(mesh: Mesh) -> BankViews:
        found = engine.map(
            lambda part: engine.run(_render_views, mesh, sonar, part, *place, size=size, quality=quality), padded
        )
        images = np.concatenate([np.asarray(part.images) for part in found])[: len(attitudes)]
        row, column = (int(v) for v in found[0].corner)
        return BankViews(images, (row, column), np.max([part.overflow for part in found]))

    return with_enough_room(render_part, mesh)


def _views_at_once(count: int, engine: Engine) -> int:
    """How many of `count` views one call renders: one of two numbers, as each is compiled anew.

    A call costs about as much as one view, so calls are long, unless threads would be left without any.
    """
    if jax.default_backend() != "cpu":
        return VMAPPED
    return VIEWS if count > FEW_VIEWS and engine.at_once <= 2 else FEW_VIEWS


@partial(jax.jit, static_argnames=("size", "quality"))
def _render_views(
    mesh: Mesh, sonar: Sonar, attitudes: Array, x: Any, y: Any, *, size: WindowSize, quality: RenderQuality
) -> BankViews:
    window = place_window(size, mesh, sonar, x, y)

    def one(attitude: Array) -> tuple[Array, Array]:
        frame = render_window(mesh, Pose(x, y, *attitude), sonar, window, quality)
        return frame.semantic(), frame.overflow

    images, overflow = one_by_one(one, jnp.asarray(attitudes))
    return BankViews(images, (window.row, window.column), overflow.max())


def _touched_box(images: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    touched = (images.max(axis=0) - BACKGROUND > TOUCHED) | (BACKGROUND - images.min(axis=0) > TOUCHED)
    if not touched.any():
        return None
    rows, columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
    return (int(rows[0]), int(columns[0])), (int(rows[-1]), int(columns[-1]))


def _within_frame(
    touched: tuple[tuple[int, int], tuple[int, int]], corner: tuple[int, int], margin: tuple[int, int], sonar: Sonar
) -> tuple[range, range]:
    """Rows and columns of the frame around the `touched` pixels of a window at `corner`, with a margin."""
    sides = zip(*touched, corner, margin, sonar.shape, strict=True)
    rows, columns = (
        range(max(start + first - more, 0), min(start + last + more + 1, size))
        for first, last, start, more, size in sides
    )
    return rows, columns


def _cropped(images: np.ndarray, corner: tuple[int, int], box: tuple[range, range]) -> np.ndarray:
    """Crop views (yaw, range, beam) of a window at `corner` to a box of the frame. What lies outside the window is
    background, because a window holds all that the object touches.
    """
    inside, missing = [], []
    for wanted, start, size in zip(box, corner, images.shape[1:], strict=True):
        first, stop = max(wanted.start, start), min(wanted.stop, start + size)
        inside.append(slice(first - start, stop - start))
        missing.append((first - wanted.start, wanted.stop - stop))
    return np.pad(images[:, *inside], [(0, 0), *missing], constant_values=BACKGROUND)


def bank_place(bank: TemplateBank, sonar: Sonar) -> tuple[float, float]:
    """Return where a bank's object is in the image: the two numbers that matching varies.

    Args:
        bank: The bank.
        sonar: The sonar for which it was rendered.

    Returns:
        Slant range [m] of the floor at the object's origin, and its image azimuth [rad].
    """
    return float(np.hypot(bank.ground_range, float(sonar.height))), float(_image_azimuth(bank.x, bank.y, sonar))


_image_azimuth = jax.jit(image_azimuth)
