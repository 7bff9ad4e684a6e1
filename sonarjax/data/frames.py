"""Frames of a data set as a jitted function of a key and their numbers: what a device stores, and what is in it."""

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
from sonarjax.render import RenderQuality, Window
from sonarjax.render.window import render_objects
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel, observe, render_bounces, with_skirts
from sonarjax.sonar import Sonar

CHUNK = 16
"""Frames of one call of the compiled function, which are also kept, or lost, together."""
MOST_SCENES = 32
"""Most objects in a frame."""
SENSORS = ("nominal", "drawn", "wide")
"""Whose frames: one device, `SensorModel.nominal`; a device for each frame, `SensorModel.draw`, or `draw_wide`."""
ROOMS = (1, 2, 4, 16, 64)
"""How much more room for triangles a frame is given, one after the other, until none is left out. Most frames need no
more than one object does: seldom does a slice cross several."""
AGAIN = 4
"""Frames of a call with more room."""


@dataclass(frozen=True)
class FrameSettings:
    """What is fixed about the frames of a data set; hashable, so that it can be static under `jax.jit`."""

    scenes: int = 1
    """Most objects in a frame; how many is drawn evenly from 1 on."""
    sensor: str = "drawn"
    """One of `SENSORS`."""
    severity: float = 1.0
    """Severity of the sensor model [1]: 0 without noise, 1 as hard as the paper's frames."""
    quality: RenderQuality = RenderQuality()
    """How finely frames are rendered."""

    def __post_init__(self) -> None:
        """Raises SonarjaxError for settings that cannot be."""
        if not 1 <= self.scenes <= MOST_SCENES:
            raise SonarjaxError(f"scenes: expected 1 to {MOST_SCENES} objects in a frame, got {self.scenes}")
        if self.sensor not in SENSORS:
            raise SonarjaxError(f"sensor: expected one of {', '.join(SENSORS)}, got {self.sensor!r}")
        if not 0.0 <= self.severity <= 10.0:
            raise SonarjaxError(f"severity: expected a number from 0 to 10, got {self.severity:g}")


class Drawn(NamedTuple):
    """Frames and what is in them; every field leads with the frame's axis."""

    image: UInt8[Any, "frame range beam"]
    """What a device stores, 0 to 255."""
    labels: UInt8[Any, "frame range beam"]
    """0 background, 1 highlight, 2 shadow."""
    instances: UInt8[Any, "frame range beam"]
    """Which object's highlight or shadow it is: 1 for the first object, 0 for background."""
    mesh: Any
    """Number of each object's mesh (frame, object)."""
    pose: Float[Any, "frame object 3"]
    """x [m], y [m] and yaw [rad] of each object."""
    there: Any
    """Whether there is such an object (frame, object)."""
    sensor: Float[Any, "frame parameter"]
    """The sensor model: `SensorModel`'s fields in their order."""
    overflow: Any
    """Triangles without room (frame,), as in `SonarFrame`."""


def draw_chunk(
    meshes: Mesh, sonar: Sonar, limits: Limits, chunk: int, settings: FrameSettings, engine: Engine, *, key: np.ndarray
) -> Drawn:
    """The frames `chunk` · CHUNK and on, as NumPy arrays; a frame is the same whatever is drawn beside it.

    `meshes` (mesh, ...) are those of `stack_meshes`, `key` is a key's data. Raises SonarjaxError when a slice crosses
    more triangles than there can be room for.
    """
    columns = touched_beams(meshes, sonar, limits) if settings.scenes == 1 else None
    args = meshes, sonar, jnp.asarray(limits, jnp.float32), key

    def drawn(numbers: np.ndarray, room: int) -> Drawn:
        static = {"settings": settings, "room": room, "columns": columns}
        # Copies, because arrays of JAX cannot be written to.
        return Drawn(*(np.array(v) for v in engine.run(_draw_frames, *args, numbers, **static)))

    numbers = np.uint32(chunk * CHUNK) + np.arange(CHUNK, dtype=np.uint32)
    found = drawn(numbers, ROOMS[0])
    for room in ROOMS[1:]:
        # A frame keeps the least room that is enough, however much its neighbours need.
        full = np.flatnonzero(found.overflow > 0)
        for start in range(0, len(full), AGAIN):
            places = full[start : start + AGAIN]
            again = drawn(np.resize(numbers[places], AGAIN), room)
            for kept, new in zip(found, again, strict=True):
                kept[places] = new[: len(places)]
    if (found.overflow > 0).any():
        raise SonarjaxError(
            f"data set: frames {chunk * CHUNK} and on: {found.overflow.max()} triangles of a slice have no room: "
            "expected a simpler mesh"
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

    # Labels in the sonar's own aperture, the image in a wider one: one after the other, so that the renderer is
    # compiled once.
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
    """The object with the largest share of each pixel's class (range, beam), from 1 on; 0 for background."""
    highlight, shadow = (jnp.argmax(v, axis=0).astype(jnp.uint8) + 1 for v in (layers.highlight, layers.shadow))
    return jnp.where(labels == 1, highlight, jnp.where(labels == 2, shadow, 0)).astype(jnp.uint8)


def _draw_model(settings: FrameSettings, *, key: Array) -> SensorModel:
    if settings.sensor == "nominal":
        return SensorModel.nominal(settings.severity)
    draw = SensorModel.draw if settings.sensor == "drawn" else SensorModel.draw_wide
    return draw(key=key, severity=settings.severity)
