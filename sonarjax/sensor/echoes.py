"""An object's echo as a device stores it, without noise: direct, and by way of the floor.

Sound that bounces on the floor on both ways appears to come from the object's mirror image in the floor; sound that
bounces on one way only arrives between, from where walls meet the floor (the image method: Urick, 1983, ch. 5). A view
is what one of these paths shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.records import record
from sonarjax.render import RenderQuality, Window, floor_angle, render_echo
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor.multipath import bounce_mesh, without_floor
from sonarjax.sensor.propagation import range_middles
from sonarjax.sonar import Sonar

FLOOR_PATHS = 0.5, 1.0
"""Of echoes that bounce on the floor on one way, and on both: as `floor_path` of `sensor.SensorModel` [1]."""


@record
class EchoLaw:
    """How a device stores an echo: what decides its brightness relative to floor and shadow."""

    gain: Float[Array, "*batch"]
    """Ratio of the object's backscatter to the floor's [1]."""
    noise: Float[Array, "*batch"]
    """Ratio of the energy in a shadow to the floor's [1]."""
    exponent: Float[Array, "*batch"]
    """Power of energy that is stored [1]; a small power stands for a logarithm."""


def stored_echo(
    echo: Float[Array, "range beam"], shadow: Float[Array, "range beam"], sonar: Sonar, window: Window, law: EchoLaw
) -> Float[Array, "range beam"]:
    """Compute what a device stores of an object on bare floor, less the grey of the floor.

    Energies are relative to that of the floor, which fills `floor_angle` of elevation in a range bin. No source for the
    law: devices store amplitudes, energies or decibels, and a power comes near each of them.

    Args:
        echo: Elevation (range, beam) [rad] that first hits of the object fill, as in `render.EchoLayers`.
        shadow: Shadow's share of each pixel's floor (range, beam).
        sonar: Gives the height and the range bins.
        window: The part of the frame that the layers show.
        law: How the device stores an echo.

    Returns:
        Difference (range, beam) from the grey of the bare floor [1].
    """
    ranges = jax.lax.dynamic_slice(range_middles(sonar), (window.row,), window.shape[:1])
    energy = law.gain * echo / floor_angle(ranges, sonar)[:, None]
    return (energy + 1 - shadow + law.noise) ** law.exponent - (1 + law.noise) ** law.exponent


def render_paths(
    mesh: Mesh,
    pose: Pose,
    sonar: Sonar,
    window: Window,
    quality: RenderQuality,
    views: Any,
    floor_paths: Sequence[Any] = FLOOR_PATHS,
    reverse: bool = False,
) -> Float[Array, "view layer range beam"]:
    """Render echo, highlight and shadow (range, beam) of an object, and of its mirror images in the floor.

    Mirror images are those of the image method (Urick, 1983, ch. 5), as in `bounce_mesh`.

    Views are rendered one after the other, so that the renderer is compiled once. The mirror images' highlight and
    shadow are not rendered, and zero.

    Args:
        mesh: One mesh, not stacked.
        pose: One pose [m, rad].
        sonar: The sonar that looks.
        window: The part of the frame to render.
        quality: How finely to render.
        views: 1 for the object alone, whose smooth chains of facets then count as one (see `render_echo`). Mirror
            images beyond this number are left dark. It may be traced.
        floor_paths: One for each mirror image [1].
        reverse: Allow reverse-mode differentiation, at the cost of always rendering all views.

    Returns:
        Layers (view, layer, range, beam): the object, then one view for each path; layers as in `render.EchoLayers`.
    """
    seen_by = _mirror_images(mesh, pose, sonar, floor_paths)
    count = 1 + len(floor_paths)

    def seen(view: Any, shares: Any) -> Array:
        vertices, faces, lift, height, aperture = view
        placed = replace(mesh, vertices=vertices, faces=faces)
        lifted = sonar.replace(height=height, elevation_aperture=aperture)
        return jnp.stack(render_echo(placed, Pose(z=lift), lifted, window, quality, views > 1, shares))

    def add(k: Any, done: Array) -> Array:
        return done.at[k].set(seen(jax.tree.map(lambda v: v[k], seen_by), k == 0))

    if reverse:
        return jax.lax.map(lambda numbered: seen(*numbered), (seen_by, jnp.arange(count) == 0))
    return jax.lax.fori_loop(0, jnp.minimum(views, count), add, jnp.zeros((count, 3, *window.shape)))


def _mirror_images(mesh: Mesh, pose: Pose, sonar: Sonar, floor_paths: Sequence[Any]) -> tuple[Array, ...]:
    """The object as it stands, and its mirror images: vertices, faces, lift [m], sonar height [m] and aperture."""
    as_it_is = pose.to_ground(mesh.vertices), mesh.faces, 0.0, sonar.height, sonar.elevation_aperture

    def mirrored(path: Any) -> tuple[Any, ...]:
        image, lift, lifted = without_floor(bounce_mesh(mesh, pose, sonar, 0.0, path), sonar)
        return image.vertices, image.faces, lift.z, lifted.height, lifted.elevation_aperture

    views = as_it_is, *(mirrored(path) for path in floor_paths)
    return tuple(jnp.stack([jnp.asarray(v) for v in each]) for each in zip(*views, strict=True))
