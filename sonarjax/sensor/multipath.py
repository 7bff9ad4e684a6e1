"""Multipath: the object mirrored in the floor or the water surface, rendered by the same renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.render import RenderQuality, SonarFrame, Window
from sonarjax.render.simulate import single_scene
from sonarjax.render.window import render_afloat
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor.model import SensorModel
from sonarjax.sonar import Sonar

BOUNCE_QUALITY = RenderQuality(sub_beams=1, elevations=32)
WIDE_APERTURE = 2.4
"""Vertical aperture for rendering mirrored objects [rad]: their echoes reach the sonar head from steep angles."""


def bounce_points(points: Float[Array, "point 3"], sonar: Sonar, plane: Any, path: Any) -> Float[Array, "point 3"]:
    """Return where points appear to be when heard by way of a mirror in the plane z = `plane`.

    The direction is that of the mirror image. The range is (1 − path)·direct + path·image (the image method: Urick,
    Principles of Underwater Sound, 1983, ch. 5).

    Args:
        points: Points in the ground frame (point, 3) [m].
        sonar: Gives the height of the sonar head.
        plane: Height of the mirror [m].
        path: 1 for a bounce on both ways, 1/2 for a bounce on one way.

    Returns:
        Apparent points in the ground frame (point, 3) [m].
    """
    head = jnp.stack([jnp.zeros(()), jnp.zeros(()), jnp.asarray(sonar.height, jnp.float32)])
    direct = jnp.sqrt(jnp.square(points - head).sum(-1, keepdims=True))
    image = points * jnp.array([1.0, 1.0, -1.0]) + 2 * plane * jnp.array([0.0, 0.0, 1.0]) - head
    length = jnp.sqrt(jnp.square(image).sum(-1, keepdims=True))
    return head + image * (path + (1 - path) * direct / length)


def bounce_mesh(mesh: Mesh, pose: Pose, sonar: Sonar, plane: Any, path: Any) -> Mesh:
    """Mirror a mesh in the plane z = `plane`, as `bounce_points` does.

    Faces still look outwards. Faces that lie on the mirror are dropped, because no sound gets between. The image method
    (Urick, 1983, ch. 5).

    Args:
        mesh: A single mesh.
        pose: Its pose, a single one.
        sonar: Gives the height of the sonar head.
        plane: Height of the mirror [m].
        path: 1 for a bounce on both ways, 1/2 for a bounce on one way.

    Returns:
        The mirrored mesh, in the ground frame.
    """
    ground = pose.to_ground(mesh.vertices)
    on_plane = jnp.all(jnp.abs(ground[mesh.faces][..., 2] - plane) < 1e-3, axis=1)
    faces = jnp.where(on_plane[:, None], 0, mesh.faces[:, ::-1])
    return replace(mesh, vertices=bounce_points(ground, sonar, plane, path), faces=faces)


def render_bounces(
    mesh: Mesh | Sequence[Mesh],
    pose: Pose | Sequence[Pose],
    sonar: Sonar,
    model: SensorModel,
    *,
    quality: RenderQuality = BOUNCE_QUALITY,
) -> SonarFrame:
    """Render the echoes that arrive by way of floor and water surface.

    An object that stands on the mirror hides the face between; otherwise what the object hides of its own mirror image
    is ignored. The image method (Urick, 1983, ch. 5) with one bounce each; one loss for all angles is a simplification
    of ours.

    Args:
        mesh: One mesh, or a sequence of meshes that stand in the same scene.
        pose: One pose of the mesh [m, rad], or a sequence with one pose for each mesh.
        sonar: The sonar that looks.
        model: Gives the water depth, and path and remaining share of energy of each bounce.
        quality: How finely to render.

    Returns:
        A frame (range, beam). Its intensity is the echoes' energy times the model's bounce coefficients. Its highlight
        is the share of each pixel that the object's mirror images cover, the largest of them. It has no shadow and no
        floor.

    Raises:
        SonarjaxError: The numbers of meshes and poses differ, one of them is a batch, or a pose (unless traced) is not
            finite or absurdly far away.
    """
    mesh, pose = single_scene(mesh, pose)

    def echo(mirror: tuple[Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        plane, path, left = mirror
        mirrored = without_floor(bounce_mesh(mesh, pose, sonar, plane, path), sonar)
        seen = render_afloat(*mirrored, Window(0, 0, sonar.shape), quality)
        return left * seen.intensity, seen.highlight, seen.lit, seen.overflow

    def silence(mirror: tuple[Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        dark = jnp.zeros(sonar.shape)
        return dark, dark, dark > 0, jnp.zeros((), jnp.int32)

    floor = 0.0, model.floor_path, model.floor_bounce
    once = 0.0, 0.5, model.floor_bounce_once  # the path of a bounce on one way
    surface = model.water_depth, model.surface_path, model.surface_bounce
    ways = zip(floor, once, surface, strict=True)
    mirrors = tuple(jnp.stack([jnp.asarray(v, jnp.float32) for v in numbers]) for numbers in ways)
    # One mirror after the other, so that the renderer is compiled once and is skipped where nothing comes back.
    energy, share, lit, overflow = jax.lax.map(lambda m: jax.lax.cond(m[2] > 0, echo, silence, m), mirrors)
    return SonarFrame(energy.sum(0), share.max(0), jnp.zeros(sonar.shape), lit.any(0), overflow.max(), sonar)


def without_floor(mesh: Mesh, sonar: Sonar) -> tuple[Mesh, Pose, Sonar]:
    """Move a mesh of the ground frame and its sonar up together until the floor lies beyond the window; return what to
    render.
    """
    lift = 2.0 * jnp.asarray(sonar.range_max, jnp.float32)
    lifted = sonar.replace(height=sonar.height + lift, elevation_aperture=WIDE_APERTURE, floor=None)
    return mesh, Pose(z=lift), lifted
