"""Draw the frames of a data set: the image that a device would store, and its labels, objects and poses.

A jitted function computes them from a key and the frames' numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.random import fold_in
from jaxtyping import Array, Float, UInt8

from sonarjax.data.layout import Limits, draw_layout, join_layout, touched_beams
from sonarjax.engine import Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, is_number, is_whole, shown
from sonarjax.render import RenderQuality, Window
from sonarjax.render.window import render_objects
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel, observe, render_bounces, with_skirts
from sonarjax.sonar import Sonar

CHUNK = 16
"""Number of frames that one call of the compiled function makes. They are also written together, so that an
interrupted run loses all frames of an unfinished chunk."""
MOST_SCENES = 32
"""Upper limit of `FrameSettings.scenes`, the number of objects in a frame."""
SENSORS = ("nominal", "drawn", "wide")
"""Choices of the sensor model: `nominal` is one device for all frames (`SensorModel.nominal`). `drawn` and `wide` draw
a new device for each frame, with `SensorModel.draw` and `SensorModel.draw_wide`."""
ROOMS = (1, 2, 4, 16, 64)
"""Factors by which the capacity for triangles in a slice is multiplied. They are tried in this order until no triangle
of the frame is left out. Factor 1, the capacity for one object, suffices for most frames, because a slice rarely
crosses several objects."""
AGAIN = 4
"""Number of frames in a call that repeats frames with a larger capacity."""


@dataclass(frozen=True)
class FrameSettings:
    """Settings that all frames of a data set share; hashable, so that they can be static under `jax.jit`."""

    scenes: int = 1
    """Largest number of objects in a frame. The number is drawn uniformly from 1 to this."""
    sensor: str = "drawn"
    """One of `SENSORS`."""
    severity: float = 1.0
    """Severity of the sensor model [1]: 0 without noise, 1 as hard as the paper's frames."""
    quality: RenderQuality = RenderQuality()
    """How finely frames are rendered."""

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            SonarjaxError: A setting is outside its range.
        """
        if not (is_whole(self.scenes) and 1 <= self.scenes <= MOST_SCENES):
            raise SonarjaxError(f"scenes: expected a whole number from 1 to {MOST_SCENES}, got {shown(self.scenes)}")
        if self.sensor not in SENSORS:
            raise SonarjaxError(f"sensor: expected one of {', '.join(SENSORS)}, got {self.sensor!r}")
        if not (is_number(self.severity) and 0.0 <= self.severity <= 10.0):
            raise SonarjaxError(f"severity: expected a number from 0 to 10, got {shown(self.severity)}")
        check_kind(self.quality, RenderQuality, "quality")
        object.__setattr__(self, "scenes", int(self.scenes))  # numbers of Python, which can be written as JSON
        object.__setattr__(self, "severity", float(self.severity))


class Drawn(NamedTuple):
    """Frames and their contents. The first axis of every field is the frame."""

    image: UInt8[Any, "frame range beam"]
    """Image as a device stores it, 0 to 255."""
    labels: UInt8[Any, "frame range beam"]
    """0 background, 1 highlight, 2 shadow."""
    instances: UInt8[Any, "frame range beam"]
    """Number of the object that the highlight or shadow belongs to: 1 for the first object, 0 for background."""
    mesh: Any
    """Index of each object's mesh (frame, object)."""
    pose: Float[Any, "frame object 3"]
    """x [m], y [m] and yaw [rad] of each object."""
    there: Any
    """Whether the object exists (frame, object). Frames with fewer objects have unused entries."""
    sensor: Float[Any, "frame parameter"]
    """Parameters of the sensor model, in the order of `SensorModel`'s fields."""
    overflow: Any
    """Number of triangles that exceed the capacity (frame,), as in `SonarFrame`."""


def draw_chunk(
    meshes: Mesh, sonar: Sonar, limits: Limits, chunk: int, settings: FrameSettings, engine: Engine, *, key: np.ndarray
) -> Drawn:
    """Draw the CHUNK frames of a chunk, as NumPy arrays.

    A frame depends on `key` and its own number, not on the frames that are drawn together with it.

    Args:
        meshes: Meshes (mesh, ...) from `stack_meshes`.
        sonar: The sonar.
        limits: Where objects may stand.
        chunk: Number of the chunk; its first frame has number `chunk` · CHUNK.
        settings: How frames are made.
        engine: What runs the compiled function.
        key: Data of a JAX key.

    Raises:
        SonarjaxError: A slice crosses more triangles than the largest capacity holds.
    """
    columns = touched_beams(meshes, sonar, limits) if settings.scenes == 1 else None
    args = meshes, sonar, jnp.asarray(limits, jnp.float32), key

    def drawn(numbers: np.ndarray, room: int) -> Drawn:
        static = {"settings": settings, "room": room, "columns": columns}
        # JAX arrays are read-only; copy them, because frames may be replaced below.
        return Drawn(*(np.array(v) for v in engine.run(_draw_frames, *args, numbers, **static)))

    numbers = np.uint32(chunk * CHUNK) + np.arange(CHUNK, dtype=np.uint32)
    found = drawn(numbers, ROOMS[0])
    for room in ROOMS[1:]:
        # Only frames that overflow are drawn again, so that each frame gets the smallest capacity that suffices,
        # whatever the other frames of the chunk need.
        full = np.flatnonzero(found.overflow > 0)
        for start in range(0, len(full), AGAIN):
            places = full[start : start + AGAIN]
            again = drawn(np.resize(numbers[places], AGAIN), room)
            for kept, new in zip(found, again, strict=True):
                kept[places] = new[: len(places)]
    if (found.overflow > 0).any():
        raise SonarjaxError(
            f"data set: frames from {chunk * CHUNK} on: expected a simpler mesh: one slice crosses "
            f"{found.overflow.max()} triangles too many"
        )
    return found


@partial(jax.jit, static_argnames=("settings", "room", "columns"))
def _draw_frames(
    meshes: Mesh, sonar: Sonar, limits: Array, key: Array, numbers: Array, settings: FrameSettings, room: int,
    columns: int | None,
) -> tuple[Array, ...]:  # fmt: skip
    root = jax.random.wrap_key_data(key)
    at_once = None if jax.default_backend() == "cpu" else len(numbers)

    def one(number: Array) -> tuple[Array, ...]:
        return tuple(_draw_frame(meshes, sonar, Limits(*limits), settings, room, columns, key=fold_in(root, number)))

    return jax.lax.map(one, numbers, batch_size=at_once)


def _draw_frame(
    meshes: Mesh, sonar: Sonar, limits: Limits, settings: FrameSettings, room: int, columns: int | None, *,
    key: Array,
) -> Drawn:  # fmt: skip
    layout_key, model_key, noise_key = jax.random.split(key, 3)
    layout = draw_layout(meshes, sonar, limits, settings.scenes, key=layout_key)
    model = _draw_model(settings, key=model_key)
    mesh, objects = join_layout(meshes, layout, room)

    window = Window(0, 0, sonar.shape, columns)

    def reaching(how: tuple[Array, Array]) -> Any:
        aperture, apart = how
        wide = sonar.replace(elevation_aperture=aperture)
        return render_objects(mesh, objects, Pose(), wide, window, settings.quality, apart)

    # Labels are rendered with the sonar's own aperture, the image with a wider one. `jax.lax.map` does this one after
    # the other, so that the renderer is compiled once.
    apertures = jnp.stack([jnp.asarray(s.elevation_aperture, jnp.float32) for s in (sonar, with_skirts(sonar))])
    both, layers = jax.lax.map(reaching, (apertures, jnp.array([True, False])))
    frame, seen = (replace(jax.tree.map(lambda v, k=k: v[k], both), sonar=sonar) for k in (0, 1))
    bounces = render_bounces(mesh, Pose(), sonar, model)
    image = observe(seen, model, key=noise_key, bounces=bounces)
    labels = frame.labels()
    return Drawn(
        image=jnp.round(255 * image).astype(jnp.uint8),
        labels=labels,
        instances=_instances(labels, jax.tree.map(lambda v: v[0], layers)),
        mesh=layout.mesh,
        pose=jnp.stack([layout.pose.x, layout.pose.y, layout.pose.yaw], axis=1),
        there=layout.there,
        sensor=jnp.stack([jnp.asarray(v, jnp.float32) for v in jax.tree.leaves(model)]),
        overflow=jnp.maximum(both.overflow.max(), bounces.overflow),
    )


def _instances(labels: Array, layers: Any) -> Array:
    """Number, from 1 on, of the object with the largest share of each pixel's class (range, beam); 0 for background."""
    highlight, shadow = (jnp.argmax(v, axis=0).astype(jnp.uint8) + 1 for v in (layers.highlight, layers.shadow))
    return jnp.where(labels == 1, highlight, jnp.where(labels == 2, shadow, 0)).astype(jnp.uint8)


def _draw_model(settings: FrameSettings, *, key: Array) -> SensorModel:
    if settings.sensor == "nominal":
        return SensorModel.nominal(settings.severity)
    draw = SensorModel.draw if settings.sensor == "drawn" else SensorModel.draw_wide
    return draw(key=key, severity=settings.severity)
