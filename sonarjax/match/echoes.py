"""Echo templates: the views of a bank as a device would store them, to be matched with frames.

A semantic template fits a map. In a frame an object's faces are not equally bright, echoes by way of the floor lie in
its shadow, and all of it depends on how the device stores an echo. One law for all devices is enough to find the yaw
bin: one near the middle of those that refinement tries (`refine.template`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.engine import Engine
from sonarjax.render import RenderQuality, TemplateBank, WindowSize, place_window
from sonarjax.render.bank import quick
from sonarjax.render.simulate import one_by_one
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import EchoLaw, render_paths, stored_echo
from sonarjax.sensor.echoes import FLOOR_PATHS
from sonarjax.sonar import Sonar

GAIN_DB, NOISE, EXPONENT = 8.0, 0.1, 0.25
"""Gain [dB], noise and exponent of the echo law."""
BOUNCES = 0.25, 0.1
"""Energies left of the echoes that bounce on the floor on one way, and on both [1]."""
AT_ONCE = 9
"""Views that one call of the compiled function renders: a quarter of most banks."""
SMALLEST = 1e-6
"""Least difference from the floor's grey by which echoes are scaled [1]."""


def echo_templates(
    bank: TemplateBank, mesh: Mesh, sonar: Sonar, size: WindowSize, quality: RenderQuality, engine: Engine
) -> Float[np.ndarray, "yaw h w"]:
    """Render the views of a bank as echoes, in the same box.

    Args:
        bank: Semantic templates (yaw, h, w) of an object that stands on the floor.
        mesh: The object.
        sonar: The sonar for which the bank was rendered.
        size: Size of the window in which it was rendered.
        quality: How finely to render.
        engine: Runs the compiled functions.

    Returns:
        Grey values (yaw, h, w) from 0 to 1: 0.5 for the bare floor, and scaled by the largest difference from it.
    """
    yaws = np.asarray(bank.yaws)
    count = len(yaws)
    parts = np.resize(yaws, (-(-count // AT_ONCE), AT_ONCE))
    place = np.asarray(bank.x), np.asarray(bank.y)
    drawn = engine.map(
        lambda part: engine.run(_render_echoes, quick(mesh), sonar, part, *place, size=size, quality=quality), parts
    )
    top, left = (int(a) - int(b) for a, b in zip(np.asarray(bank.offset), drawn[0][1], strict=True))
    height, width = bank.templates.shape[1:]
    echoes = np.concatenate([np.asarray(views) for views, _ in drawn])[:count]
    echoes = echoes[:, top : top + height, left : left + width]
    return 0.5 + 0.5 * echoes / np.maximum(np.abs(echoes).max(), SMALLEST)


@partial(jax.jit, static_argnames=("size", "quality"))
def _render_echoes(
    mesh: Mesh, sonar: Sonar, yaws: Array, x: Array, y: Array, *, size: WindowSize, quality: RenderQuality
) -> tuple[Float[Array, "yaw range beam"], tuple[Array, Array]]:
    """Echoes in a window, less the floor's grey, and row and column of the window's first pixel."""
    window = place_window(size, mesh, sonar, x, y)
    law = EchoLaw(*(jnp.float32(v) for v in (10 ** (GAIN_DB / 10), NOISE, EXPONENT)))

    def one(yaw: Array) -> Array:
        layers = render_paths(mesh, Pose(x, y, yaw), sonar, window, quality, 1 + len(FLOOR_PATHS))
        echo = layers[0, 0] + jnp.einsum("v,vrb->rb", jnp.asarray(BOUNCES), layers[1:, 0])
        return stored_echo(echo, layers[0, 2], sonar, window, law)

    return one_by_one(one, yaws), (jnp.asarray(window.row), jnp.asarray(window.column))
